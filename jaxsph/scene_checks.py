"""What a scene may be made of. All raise ValueError, which says what is wrong and what to do."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxsph.effects import (
    AcousticDamper,
    BodyForce,
    Contact,
    Damping,
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
from jaxsph.rigid_body import RigidBody
from jaxsph.structure import Structure
from jaxsph.walls import Wall, WallContinuity, WallSummation

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
        raise ValueError(f"all systems of a scene need one dimension and one precision, not {dimensions}, {kinds}")


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
    kinds = [type(effect) for effect in effects if not isinstance(effect, BodyForce)]
    if len(set(kinds)) != len(kinds):
        raise ValueError(f"an effect can be listed once: {[kind.__name__ for kind in kinds]}")


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
    """That no fluid starts within a wall, a solid or another fluid. Of known positions; periods are not counted."""
    from scipy.spatial import KDTree

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
