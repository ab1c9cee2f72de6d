"""What a scene calls for and does not have."""

from __future__ import annotations

from jaxsph.effects import (
    DeltaDiffusion,
    DensityDiffusion,
    FlowEffect,
    PenaltyForce,
    ShepardFilter,
    Shifting,
    TensileControl,
)
from jaxsph.explain import finding
from jaxsph.explain.arrangement import support
from jaxsph.explain.facts import Facts
from jaxsph.explain.finding import Finding

MACH = 0.1
ROUNDING = 1.01  # of numbers that stand exactly at a limit
THIN = 10
"""Particles across a structure up to which modes without energy matter for its bending."""

NEIGHBORS = {2: (12, 80), 3: (40, 400)}
"""In 2D and 3D: fewer make the sums inexact, more cost time and smooth the flow."""


def missing(facts: Facts) -> list[Finding]:
    """Effects, particles or sound speed that the scene calls for and does not have, each with its cure."""
    found = _of_structures(facts)
    if facts.scene.fluids:
        found += [*_speeds(facts), *_walls(facts), *_noise(facts), *_tension(facts), *_sums(facts), *_surface(facts)]
    return found


def _speeds(facts):
    if facts.speed is None or facts.mach <= MACH * ROUNDING:
        return []
    speed, least = f"{facts.speed:.3g} m/s ({facts.speed_from})", 10 * facts.speed
    why = f"Ma = {facts.mach:.3g} at U = {speed}; take at least {least:.3g} m/s"
    return [Finding("sound speed", why, facts.mach**2, "Ma^2 of the density", finding.COMPRESSIBLE)]


def _walls(facts):
    scene, found, dx = facts.scene, [], facts.scene.spacing
    for wall in scene.boundaries:
        name, resolved = wall.name, facts.viscosity and facts.speed and facts.layer > 2 * dx
        if resolved and not wall.no_slip:
            share = min(facts.layer / facts.length, 1.0)
            why = f"Re = {facts.reynolds:.3g}: the viscous layer is {facts.layer / dx:.2g} spacings thick; no_slip=True"
            found.append(Finding(f"no slip of {name}", why, share, "L / sqrt(Re) / L of the flow", finding.LAYER))
        if name in facts.layers:
            have, needed = facts.layers[name]
            if have < needed:
                why = f"{have:.0f} where fluid touches it, the support radius reaches {needed}; take {needed}"
                share = 1 - have / needed
                found.append(
                    Finding(f"layers of {name}", why, share, "share of the wall's side that is empty", finding.WALLS)
                )
        if name in facts.across:
            found += _thin(facts, wall)
            continue
        if hasattr(wall.pressure, "clip") and facts.fall > dx and facts.is_open and not wall.pressure.clip:
            why = "fluid that falls comes off walls, which would pull it back; pressure=...(clip=True)"
            found.append(Finding(f"clipping of {name}", why, source=finding.WALLS))
        if getattr(wall.pressure, "clip", False) and not facts.is_open:
            why = "a domain without a free surface has negative pressures, which the wall takes as zero; clip=False"
            found.append(Finding(f"negative pressure of {name}", why, source=finding.WALLS))
    return found


def _thin(facts, structure):
    thickness, reach = facts.across[structure.name] * structure.particles.spacing, support(facts.scene)
    if structure.thickness is not None or thickness >= reach * (1 - 1e-6) or not thickness:
        return []
    why = f"{structure.name} is {thickness:.3g} m thick, less than the support radius of {reach:.3g} m; thickness=..."
    share = 1 - thickness / reach
    return [Finding(f"thickness of {structure.name}", why, share, "share of the structure's side that is empty")]


def _noise(facts):
    scene, c = facts.scene, facts.sound_speed
    if scene.density.evolved != "density_deviation":
        return []
    smooth = scene.effect(DensityDiffusion) or scene.effect(DeltaDiffusion)
    if facts.gravity and smooth is None and scene.effect(ShepardFilter) is None:
        why = "under gravity noise of the pressure grows without it; " + (
            "DeltaDiffusion(0.1)" if facts.is_open else "DensityDiffusion(0.1)"
        )
        noise = (facts.speed or 0.0) * c / (facts.gravity * facts.length)
        worst = f"at worst the noise is rho c U, {noise:.2g} times rho g L"
        return [Finding("density diffusion", why, estimate=worst, source=finding.DELTA)]
    if facts.gravity and facts.is_open and isinstance(smooth, DensityDiffusion):
        rate = float(smooth.coefficient) * facts.smoothing_length * c / facts.length**1.5 / facts.gravity**0.5
        why = "DensityDiffusion levels the weight of the water at its surface; DeltaDiffusion does not"
        return [
            Finding(
                "DeltaDiffusion",
                why,
                min(rate, 1.0),
                "delta h c / sqrt(g L^3) of the weight in sqrt(L / g)",
                finding.DELTA,
            )
        ]
    damped = any(effect.force is not None for effect in scene.effects if isinstance(effect, FlowEffect))
    if smooth is None and not facts.viscosity and not damped and scene.effect(ShepardFilter) is None:
        why = "nothing takes noise out of velocity or pressure; ArtificialViscosity(0.02) or DeltaDiffusion(0.1)"
        return [Finding("dissipation", why, source=finding.MONAGHAN)]
    return []


def _tension(facts):
    scene, speed = facts.scene, facts.speed or 0.0
    tension = -facts.lowest_pressure > 0.05 * facts.density * speed**2 and facts.lowest_pressure < 0
    lifted = any(float(fluid.state_equation.background_pressure) < 0 for fluid in scene.fluids)
    found = []
    if not facts.is_open and scene.effect(Shifting) is None and not lifted and (tension or facts.reynolds > 10):
        why = "a full domain has negative pressures, where particles clump and tear; ParticleShifting(U)"
        if facts.speed is not None:
            found.append(Finding("ParticleShifting", why, source=f"{finding.TENSILE}; {finding.SHIFTING}"))
    if facts.is_open and tension and scene.effect(TensileControl) is None and not lifted:
        why = f"the pressure of the start reaches {facts.lowest_pressure:.3g} Pa: particles clump; TensileControl()"
        found.append(Finding("TensileControl", why, source=finding.TENSILE))
    return found


def _sums(facts):
    scene, found = facts.scene, []
    mean, (fewest, most) = facts.neighbors[0], NEIGHBORS[scene.dimension]
    in_spacings = facts.smoothing_length / scene.spacing
    if mean < fewest:
        why = (
            f"{mean:.3g} on average, at least {fewest} are needed; a smoothing length above {in_spacings:.3g} spacings"
        )
        found.append(Finding("neighbors", why, source=finding.DISORDER))
    if mean > most:
        why = f"{mean:.3g} on average, more than {most} cost time and smooth the flow; a shorter smoothing length"
        share = (facts.smoothing_length / facts.length) ** 2
        found.append(Finding("spacing", why, share, "(h / L)^2, the kernel's own error", finding.MONAGHAN))
    per_length = facts.length / scene.spacing
    if per_length < 5 / ROUNDING:
        why = f"{per_length:.2g} particles over L = {facts.length:.3g} m ({facts.length_from}); at least 5"
        share = min((facts.smoothing_length / facts.length) ** 2, 1.0)
        found.append(Finding("resolution", why, share, "(h / L)^2, the kernel's own error", finding.MONAGHAN))
    return found


def _surface(facts):
    if not facts.surface_tension or not facts.is_open or not facts.speed:
        return []
    forces = facts.density * max(facts.speed**2 * facts.length, facts.gravity * facts.length**2)
    share = facts.surface_tension / forces
    if share < 0.01:
        return []
    why = f"sigma = {facts.surface_tension:.3g} N/m is not small beside inertia and weight; no effect has it yet"
    return [Finding("surface tension", why, share, "1 / max(We, Bo) of the forces")]


def _of_structures(facts):
    scene, found = facts.scene, []
    for structure in scene.structures:
        count = facts.across[structure.name]
        if 0 < count < 3:
            why = f"{count} across {structure.name}; at least 3, the bending of fewer is that of the kernel"
            found.append(Finding(f"particles across {structure.name}", why, source=finding.PENALTY))
        if 0 < count <= THIN and scene.effect(PenaltyForce) is None:
            enough = 1.0 if scene.fluids else 0.05  # of what water strikes, and of what swings
            why = f"{count} particles across {structure.name}: those that alternate cost no energy"
            why += f"; PenaltyForce({enough})"
            found.append(Finding("PenaltyForce", why, source=finding.PENALTY))
    return found
