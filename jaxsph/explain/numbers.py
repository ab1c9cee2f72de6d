"""The dimensionless numbers of a scene."""

from __future__ import annotations

import math

import numpy as np

from jaxsph.explain.arrangement import support
from jaxsph.explain.facts import Facts
from jaxsph.explain.finding import Number


def numbers_of(facts: Facts, structure_steps: dict[str, float] | None = None) -> dict[str, Number]:
    """By name, in the order in which they are shown; those for which the scene lacks something are left out.

    Args:
        facts: of the scene.
        structure_steps: by structure the largest stable step [s], if computed; else about spacing / p-wave speed.
    """
    scene, found = facts.scene, []
    if scene.fluids:
        found += _of_flow(facts) if facts.speed else []
        found += _of_resolution(facts)
    for name, count in facts.across.items():
        if count:
            formula = "smallest extent of what is free, over the spacing, + 1"
            found.append(Number(f"particles across {name}", count, formula))
    return {number.name: number for number in [*found, *_between(facts, structure_steps or {})]}


def _of_flow(facts):
    speed, length, c = facts.speed, facts.length, facts.sound_speed
    found = []
    if facts.viscosity:
        found.append(Number("Re", facts.reynolds, "U L / nu", "inertia over viscosity"))
    if facts.numerical_viscosity:
        numerical = speed * length / facts.numerical_viscosity
        found.append(Number("Re of artificial viscosity", numerical, "U L / nu', nu' = alpha h c / (4 (d + 2))"))
    found.append(Number("Ma", facts.mach, "U / c", f"the density changes by about Ma^2 = {100 * facts.mach**2:.2g} %"))
    if facts.gravity:
        found.append(Number("Fr", speed / math.sqrt(facts.gravity * length), "U / sqrt(g L)", "inertia over gravity"))
        share = facts.gravity * length / c**2
        found.append(Number("compression by weight", share, "g L / c^2", "relative density between top and bottom"))
    if facts.surface_tension:
        tension = facts.surface_tension
        weber = facts.density * speed**2 * length / tension
        found.append(Number("We", weber, "rho U^2 L / sigma", "inertia over surface tension"))
        if facts.gravity:
            bond = facts.density * facts.gravity * length**2 / tension
            found.append(Number("Bo", bond, "rho g L^2 / sigma", "weight over surface tension"))
    return found


def _of_resolution(facts):
    scene, dx = facts.scene, facts.scene.spacing
    mean, most = facts.neighbors
    found = [
        Number("particles per length", facts.length / dx, "L / dx"),
        Number("smoothing length in spacings", facts.smoothing_length / dx, "h / dx"),
        Number("neighbors", mean, f"mean within {support(scene) / dx:.3g} spacings", f"at most {most}"),
    ]
    if facts.viscosity and facts.speed:
        found.append(Number("Re of a spacing", facts.speed * dx / facts.viscosity, "U dx / nu"))
        found.append(Number("viscous layer in spacings", facts.layer / dx, "L / sqrt(Re) / dx, at most L / dx"))
    return found


def _between(facts, structure_steps):
    scene, found = facts.scene, []
    if len(scene.fluids) > 1:
        densities = [float(fluid.density) for fluid in scene.fluids]
        found.append(Number("density ratio of fluids", max(densities) / min(densities), "rho_1 / rho_2"))
    for structure in scene.structures if scene.fluids else ():
        name, density = structure.name, float(np.mean(np.asarray(structure.density)))
        found.append(Number(f"density ratio of {name}", density / facts.density, "rho_s / rho_f"))
        step = structure_steps.get(name, facts.steps[name])
        fluid = min(facts.steps[fluid.name] for fluid in scene.fluids)
        found.append(Number(f"time-step ratio of {name}", step / fluid, "stable step of the structure / of the fluid"))
    return found
