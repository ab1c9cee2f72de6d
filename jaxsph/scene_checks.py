"""What a scene may be made of. All raise ValueError, which says what is wrong and what to do."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxsph.effects import (
    AcousticDamper,
    BodyForce,
    Contact,
    Damping,
    DeltaDiffusion,
    DensityDiffusion,
    FlowEffect,
    KelvinVoigt,
    KernelGradientCorrection,
    PenaltyForce,
    ShepardFilter,
    Shifting,
    TensileControl,
    WallRepulsion,
)
from jaxsph.fluid import Fluid
from jaxsph.pytree import is_concrete
from jaxsph.rigid_body import RigidBody
from jaxsph.structure import Structure
from jaxsph.walls import Wall, WallContinuity, WallSummation

LEAST_SMOOTHING = 0.85
"""Of a spacing: with less a particle has but its nearest neighbors, and a divergence of 1 comes out as .8 and less."""

SMALLEST, LARGEST = 1e-31, 1e31
"""Of V^2 rho c^2 in float32, whose numbers end at 1e-38 and 3e38: between them seven digits below and above."""

OVERLAP, AMONG = 0.45, 0.8
"""Of the smaller spacing: a fluid's particle that is so close to one of something else, or to 2^d of them, is in it."""


def check_systems(systems) -> None:
    """That systems have names, a dimension and a precision that go together."""
    for system in systems:
        if not isinstance(system, (Structure, RigidBody, Fluid, Wall)):
            raise ValueError(
                f"a scene is made of fluids, walls, structures and rigid bodies, not of {type(system).__name__}"
            )
    if not systems:
        raise ValueError("a scene needs at least one system of particles")
    names = [system.name for system in systems]
    if len(set(names)) != len(names):
        raise ValueError(f"two systems have the same name: {names}")
    taken = {"gravity", "smoothing_length", "density", "kernel", "domain"} & set(names)
    if taken:
        raise ValueError(f"a system is called {sorted(taken)[0]!r}, which names a number of the scene; rename it")
    dimensions, kinds = {s.dimension for s in systems}, {str(s.dtype) for s in systems}
    if len(dimensions) > 1 or len(kinds) > 1:
        found = ", ".join(f"{s.name!r} in {s.dimension}D, {s.dtype}" for s in systems)
        raise ValueError(
            f"all systems of a scene need one dimension and one precision, not {found}; make their particles with one "
            "dtype="
        )


def check_effects(effects, systems) -> None:
    """That every effect has something to act on, and none contradicts another."""
    for effect in effects:
        if not isinstance(effect, (PenaltyForce, Damping, KelvinVoigt, Contact, FlowEffect, ShepardFilter, Shifting)):
            raise ValueError(f"{effect!r} is not an effect; see jaxsph.effects for those that are")
        wanted: Any = Structure if isinstance(effect, (PenaltyForce, KelvinVoigt)) else Fluid
        if isinstance(effect, (Contact, Damping)):
            wanted = (Structure, RigidBody)
        if not any(isinstance(system, wanted) for system in systems) and not isinstance(effect, BodyForce):
            raise ValueError(
                f"{type(effect).__name__} acts on a {_names(wanted)}, and the scene has none; leave it out"
            )
        if isinstance(effect, WallRepulsion):
            met = (Wall, Structure, RigidBody) if effect.solids else Wall
            if not any(isinstance(system, met) for system in systems):
                raise ValueError(f"WallRepulsion acts at a {_names(met)}, and the scene has none; leave it out")
    moving = [type(effect).__name__ for effect in effects if isinstance(effect, Shifting)]
    if len(set(moving)) > 1:
        raise ValueError(f"a scene has at most one effect that moves particles off their paths, not {moving}")
    if any(isinstance(effect, KernelGradientCorrection) for effect in effects):
        if not any(isinstance(effect, Shifting) and not effect.free_surface for effect in effects):
            raise ValueError(
                "KernelGradientCorrection is for flows that fill their domain, and leaves it to shifting to keep "
                "particles apart: list ParticleShifting() without a free surface or TransportVelocity() too"
            )
        if any(isinstance(effect, TensileControl) for effect in effects):
            raise ValueError("KernelGradientCorrection and TensileControl both take p_b - p_a; leave one of them out")
    if sum(isinstance(effect, (DensityDiffusion, DeltaDiffusion)) for effect in effects) > 1:
        raise ValueError("DensityDiffusion and DeltaDiffusion are two forms of one effect; leave one of them out")
    kinds = [type(effect) for effect in effects if not isinstance(effect, BodyForce)]
    if len(set(kinds)) != len(kinds):
        raise ValueError(f"an effect can be listed once: {[kind.__name__ for kind in kinds]}")


def check_fluids(flows, smoothing_length) -> None:
    """That one smoothing length and one law of viscosity serve all fluids, and float32 holds the products of a pair."""
    for fluid in flows:
        spacing, h = fluid.particles.spacing, smoothing_length
        if is_concrete(h) and not h > LEAST_SMOOTHING * spacing:
            raise ValueError(
                f"smoothing_length = {float(h):.4g} m is {float(h) / spacing:.3g} spacings of {fluid.name!r}, whose "
                f"sums would miss most neighbors (limit {LEAST_SMOOTHING}, usual 1.5); pass a larger one, or make "
                "fluids of one spacing"
            )
        if fluid.dtype == np.float32 and is_concrete(fluid.density, fluid.sound_speed):
            product = spacing ** (2 * fluid.dimension) * float(fluid.density) * float(fluid.sound_speed) ** 2
            if not SMALLEST < product < LARGEST:
                raise ValueError(
                    f"forces of pairs of {fluid.name!r} are of the order of {product:.1e}, V^2 rho c^2 in SI units, of "
                    f"which float32 loses digits (it holds them from {SMALLEST:g} to {LARGEST:g}); make the particles "
                    "with dtype=float64, or measure lengths in another unit"
                )
    laws = {type(fluid.viscosity_law).__name__ for fluid in flows if fluid.viscosity is not None}
    if len(laws) > 1:
        raise ValueError(f"viscous fluids of a scene need one law of viscosity, or forces are not opposite, not {laws}")


def _names(kinds) -> str:
    return " or ".join(kind.__name__ for kind in (kinds if isinstance(kinds, tuple) else (kinds,)))


def check_meetings(systems, effects, flows) -> None:
    """That walls have something to meet: without fluids they are there for solids to touch."""
    contact = next((effect for effect in effects if isinstance(effect, Contact)), None)
    walls = [system for system in systems if isinstance(system, Wall)]
    if contact is None:
        if walls and not flows:
            raise ValueError("a scene with walls needs a fluid, or a solid and Contact(); `clamped` holds a structure")
        return
    if len(systems) - len(flows) < 2:
        raise ValueError("Contact acts between two solids or a solid and a wall, and the scene has one; leave it out")
    if contact.modulus is None and not flows and not any(isinstance(system, Structure) for system in systems):
        raise ValueError("Contact of rigid bodies without a fluid needs its modulus [Pa], such as Contact(modulus=1e6)")
    for system in systems:
        model = getattr(system, "pressure", None)
        if not flows and isinstance(model, (WallContinuity, WallSummation)):
            raise ValueError(f"{type(model).__name__} of {system.name!r} needs a fluid, and the scene has none")


def check_density(density, systems, effects) -> None:
    """That effects and models of walls find the density or pressure that they need."""
    kind = type(density).__name__
    for effect in effects:
        if density.evolved != "density_deviation" and isinstance(effect, ShepardFilter):
            raise ValueError(f"ShepardFilter smooths a density that {kind} does not evolve; leave it out")
        if density.evolved != "density_deviation" and isinstance(effect, AcousticDamper):
            raise ValueError(f"AcousticDamper needs the rate of a density that {kind} does not evolve; leave it out")
        if density.evolved != "density_deviation" and getattr(effect, "density_flux", None) is not None:
            raise ValueError(f"{type(effect).__name__} smooths a density that {kind} does not evolve; leave it out")
    flows = [system for system in systems if isinstance(system, Fluid)]
    for system in systems:
        model = getattr(system, "pressure", None)
        if not flows or isinstance(system, Fluid) or not isinstance(model, (WallContinuity, WallSummation)):
            continue
        name = f"{type(model).__name__} of {system.name!r}"
        if density.evolved == "pressure":
            raise ValueError(
                f"{name} takes its pressure from an equation of state, which {kind} does not have; take "
                "AdamiExtrapolation()"
            )
        if isinstance(model, WallContinuity) and density.evolved != "density_deviation":
            raise ValueError(
                f"{name} follows the density's rate, which {kind} does not calculate; take WallSummation() or "
                "AdamiExtrapolation()"
            )
        if len(flows) > 1:
            raise ValueError(
                f"{name} has the rest density and sound speed of one fluid, and the scene has {len(flows)}; take "
                "AdamiExtrapolation()"
            )


def check_apart(scene) -> None:
    """That no fluid starts within a wall, a solid, another fluid, or its own image. Of known positions."""
    from scipy.spatial import KDTree

    if scene.domain is not None and any(scene.domain.periodic):
        _check_seam(scene)
    for number, fluid in enumerate(scene.fluids):
        here = np.asarray(fluid.particles.positions)
        for other in (*scene.fluids[number + 1 :], *scene.boundaries):
            spacing, several = min(fluid.particles.spacing, other.particles.spacing), 2**scene.dimension
            there = np.asarray(other.particles.positions)
            low, high = here.min(axis=0) - spacing, here.max(axis=0) + spacing
            around = np.all((there >= low) & (there <= high), axis=1)
            if not around.any():
                continue
            distance, _ = KDTree(there[around]).query(here, k=several, distance_upper_bound=AMONG * spacing)
            inside = np.flatnonzero((distance[:, 0] < OVERLAP * spacing) | np.isfinite(distance[:, -1]))
            if len(inside):
                place = ", ".join(f"{x:.6g}" for x in here[inside[0]])
                raise ValueError(
                    f"{len(inside)} particles of {fluid.name!r} start in {other.name!r}, the first at ({place}) m, "
                    f"{distance[inside[0], 0]:.3g} m from one of its particles (limit {OVERLAP * spacing:.3g} m, from "
                    f"{several} of them {AMONG * spacing:.3g} m); move it, make it smaller, or cut it out"
                )


def _check_seam(scene) -> None:
    """That no two particles of a fluid are at one place because the period is shorter than the fluid."""
    from scipy.spatial import KDTree

    for fluid in scene.fluids:
        here = np.asarray(fluid.particles.positions, np.float64)
        wrapped, period = scene.domain.for_tree(here)
        pairs = KDTree(wrapped, boxsize=period).query_pairs(OVERLAP * fluid.particles.spacing, output_type="ndarray")
        apart = np.linalg.norm(here[pairs[:, 0]] - here[pairs[:, 1]], axis=1) > 2 * OVERLAP * fluid.particles.spacing
        if apart.any():
            a, b = pairs[np.argmax(apart)]
            raise ValueError(
                f"{int(apart.sum())} pairs of particles of {fluid.name!r} are at one place through the period of "
                f"{[length for length in period.tolist() if length]} m, the first {a} and {b}; make the domain as long "
                "as what fills it"
            )
