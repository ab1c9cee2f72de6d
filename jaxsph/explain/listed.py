"""Which effects are on, and why; and which of them could be left out."""

from __future__ import annotations

import math

from jaxsph.effects import (
    AcousticDamper,
    ArtificialViscosity,
    Contact,
    Damping,
    DeltaDiffusion,
    DensityDiffusion,
    KelvinVoigt,
    PenaltyForce,
    ShepardFilter,
    Shifting,
    TensileControl,
    WallRepulsion,
)
from jaxsph.explain import finding
from jaxsph.explain.facts import Facts
from jaxsph.explain.finding import Finding
from jaxsph.walls import Wall

SMALL = 1e-3
"""A relative error below which an effect counts as one that could be left out."""


WAVE = (2 * math.pi) ** 2
"""exp(-nu k^2 t) with k = 2 pi / L, after t = L / U."""


def listed(facts: Facts) -> list[Finding]:
    """What is on: what the systems, the density and the effects of a scene bring along."""
    scene, found = facts.scene, []
    for fluid in scene.fluids:
        if fluid.viscosity is not None:
            why = f"{fluid.name} has a viscosity of {float(fluid.viscosity):.3g} Pa s"
            found.append(Finding(f"{type(fluid.viscosity_law).__name__} of {fluid.name}", why))
    if scene.fluids:
        found.append(_density(facts))
    for wall in scene.boundaries:
        found += _of_wall(facts, wall)
    if any(scene.gravity):
        along = "" if facts.gravity or not scene.fluids else ", along a periodic direction: it drives the flow"
        found.append(Finding("gravity", f"given{along}"))
    for structure in scene.structures:
        found.append(Finding(f"{type(structure.law).__name__} of {structure.name}", "the elastic law of the structure"))
        if structure.motion is not None:
            found.append(Finding(f"motion of {structure.name}", "its clamped particles follow it"))
    return found + [_effect(facts, effect) for effect in scene.effects]


def _density(facts):
    density, equation = facts.scene.density, type(facts.scene.fluids[0].state_equation).__name__
    name = f"{type(density).__name__} with {equation}"
    why = "the density is a sum over particles" if density.summed else "the density follows from its rate"
    if facts.speed is None:
        return Finding(name, why)
    return Finding(
        name, why, facts.mach**2, "compressibility Ma^2 in place of an incompressible fluid", finding.COMPRESSIBLE
    )


def _of_wall(facts, wall):
    found = [Finding(f"{type(wall.pressure).__name__} of {wall.name}", "fluid is held off by a pressure")]
    if getattr(wall.pressure, "clip", False):
        found.append(Finding(f"clipping of {wall.name}", "the wall does not pull, so that fluid comes off it"))
    if wall.no_slip and facts.viscosity:
        found.append(Finding(f"no slip of {wall.name}", f"the viscous layer is {_layer(facts)}"))
    if isinstance(wall, Wall) and wall.motion is not None:
        found.append(Finding(f"motion of {wall.name}", "prescribed"))
    if isinstance(wall, Wall) and wall.velocity is not None:
        found.append(Finding(f"velocity of {wall.name}", "its surface slides"))
    if getattr(wall, "thickness", None) is not None:
        found.append(Finding(f"thickness of {wall.name}", f"fluid meets {wall.thickness:.3g} m as if it were thick"))
    return found


def _effect(facts, effect):
    name, h = type(effect).__name__, 0.0 if not facts.scene.fluids else facts.smoothing_length
    speed, length = facts.speed or math.inf, facts.length
    if isinstance(effect, ArtificialViscosity):
        share = facts.numerical_viscosity / (speed * length)
        why = f"takes noise out of the velocity; acts like nu' = {facts.numerical_viscosity:.3g} m^2/s"
        return Finding(name, why, share, "nu' / (U L), what it dissipates in L / U", f"{finding.MONAGHAN}, section 8.1")
    if isinstance(effect, (DensityDiffusion, DeltaDiffusion)):
        exact = isinstance(effect, DeltaDiffusion)
        strength = float(effect.coefficient) * h * facts.sound_speed / (speed * length)
        strength *= (h / length) ** 2 if exact else 1.0
        share = strength * facts.mach**2
        formula = "delta h c / (U L) Ma^2" + (" (h / L)^2, since linear profiles are left alone" if exact else "")
        source = finding.DELTA if exact else finding.DIFFUSION
        return Finding(name, "takes noise out of the pressure", share, f"{formula}, of the density in L / U", source)
    if isinstance(effect, ShepardFilter):
        return Finding(name, f"smooths the density every {effect.every} steps")
    if isinstance(effect, Shifting):
        return Finding(name, "keeps particles evenly spread, on which every sum relies", source=finding.DISORDER)
    if isinstance(effect, TensileControl):
        return Finding(name, "keeps particles under negative pressure from clumping", source=finding.TENSILE)
    if isinstance(effect, AcousticDamper):
        return Finding(name, "damps the sound that an impact leaves, which water has hardly any of")
    if isinstance(effect, WallRepulsion):
        into = "walls and solids" if effect.solids else "walls"
        return Finding(name, f"keeps sheets of fluid thinner than a spacing from sinking into {into}")
    if isinstance(effect, PenaltyForce):
        return Finding(name, "resists displacements that alternate from particle to particle", source=finding.PENALTY)
    if isinstance(effect, Contact):
        return Finding(name, "keeps solids from passing through each other and through walls")
    if isinstance(effect, Damping):
        return Finding(name, "brings structures to rest; a static state is exact, the motion towards it is not")
    if isinstance(effect, KelvinVoigt):
        return Finding(name, "damps vibrations of structures, the more the faster they are")
    return Finding(name, "listed")


def spare(facts: Facts) -> list[Finding]:
    """What of it could be left out, and what error that would make."""
    scene, found = facts.scene, []
    if not scene.fluids or facts.speed is None:
        return found
    dx, kinds = scene.spacing, [type(effect).__name__ for effect in scene.effects]
    sticking = [wall for wall in scene.boundaries if wall.no_slip and facts.viscosity]
    thin = facts.layer < 0.5 * dx
    for wall in sticking if thin else ():
        why = f"the viscous layer is {_layer(facts)}, which particles cannot show"
        error = facts.layer / facts.length
        found.append(Finding(f"no slip of {wall.name}", why, error, "L / sqrt(Re) / L of the flow", finding.LAYER))
    lost = WAVE / facts.reynolds if facts.viscosity else 0.0
    if facts.viscosity and lost < SMALL and (thin or not sticking):
        why = f"Re = {facts.reynolds:.3g}"
        if facts.numerical_viscosity > facts.viscosity:
            why += f", and artificial viscosity is {facts.numerical_viscosity / facts.viscosity:.2g} times as large"
        formula = "(2 pi)^2 / Re, the speed that a shear wave as long as L loses in L / U"
        found.append(Finding("viscosity", why, lost, formula, finding.LAYER))
    if facts.numerical_viscosity and facts.viscosity > 2 * facts.numerical_viscosity:
        share = facts.numerical_viscosity / facts.viscosity
        why = "the viscosity of the fluid does more; without it the fluid is less viscous"
        found.append(Finding("ArtificialViscosity", why, share, "nu' / nu of the viscosity", finding.MONAGHAN))
    if facts.gravity:
        share = facts.gravity * facts.length / facts.speed**2
        if share < SMALL:
            found.append(Finding("gravity", "inertia is all", share, "1 / Fr^2 of the inertia"))
    if "ShepardFilter" in kinds and {"DensityDiffusion", "DeltaDiffusion"} & set(kinds):
        found.append(Finding("ShepardFilter", "diffusion smooths the density already, at every step"))
    if "TensileControl" in kinds and facts.gravity and facts.lowest_pressure >= 0 and not facts.viscosity:
        why = "under gravity, from a start without tension, its force is zero wherever the pressure is not negative"
        found.append(Finding("TensileControl", why, source=finding.TENSILE))
    return found


def _layer(facts):
    return f"{facts.layer:.3g} m or {facts.layer / facts.scene.spacing:.2g} spacings thick"
