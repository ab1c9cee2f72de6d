"""What `scene.explain()` estimates, beside runs with and without what it speaks of.

It promises orders of magnitude: an estimate counts as kept if the run shows no more than ten times and no less than a
tenth of it. The viscosity that an artificial one acts like is a formula of the scheme, and has to hold by a quarter.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from flows import fields_at
from rows import Case, Row, precision

import jaxsph

ORDER, FORMULA = 10.0, 1.25
DTYPE = np.float32


def either_way(found: float, expected: float) -> float:
    """How many times one is the other, whichever is larger."""
    return max(found / expected, expected / found) if found > 0 and expected > 0 else float("inf")


def rows(what: str, found: float, expected: float, limit: float, where: str) -> list[Row]:
    """What was found, what was estimated, and how far they are apart."""
    return [
        Row(f"{what}: run", found, None, where, precision(DTYPE)),
        Row(f"{what}: estimate", expected, None, where, precision(DTYPE)),
        Row(f"{what}: one over the other", either_way(found, expected), limit, where, precision(DTYPE)),
    ]


def error_of(findings, start: str) -> float:
    """The error that a finding whose name begins so estimates."""
    return next(float(finding.error) for finding in findings if finding.effect.startswith(start))


def decay(run) -> float:
    """Viscosity [m^2/s] that the kinetic energy of a vortex of a period of 1 m shows between t = .2 and the end."""
    times, energy = np.asarray(run.times, float), np.sum(np.asarray(run["water"]["velocity"], float) ** 2, axis=(1, 2))
    late = times > 0.19
    return float(-np.polyfit(times[late], np.log(energy[late]), 1)[0] / (16 * np.pi**2))


def vortex(particles: int, viscosity: float, alpha: float):
    """A decaying vortex, U = L = 1, with a viscosity [m^2/s], with an artificial one, or with both."""
    effects = [jaxsph.DensityDiffusion(0.1), jaxsph.ParticleShifting(1.0)]
    effects += [jaxsph.ArtificialViscosity(alpha)] if alpha else []
    scene = jaxsph.scenes.taylor_green(particles, reynolds=1 / viscosity, effects=effects, disorder=0.2, dtype=DTYPE)
    return scene, jaxsph.simulate(scene, 1.0, 0.05)


def vortices(quick: bool) -> Iterator[list[Row]]:
    """What an artificial viscosity acts like, how much the density changes, and what a small viscosity does."""
    particles = 25 if quick else 50
    where = f"vortex, {particles} x {particles}"
    _, plain = vortex(particles, 0.01, 0.0)
    scene, both = vortex(particles, 0.01, 0.1)
    artificial = 1.0 / scene.explain(speed=1.0, length=1.0).numbers["Re of artificial viscosity"].value
    yield rows("artificial viscosity [m^2/s]", decay(both) - decay(plain), artificial, FORMULA, where)
    deviation = float(np.max(np.abs(np.asarray(plain["water"]["density_deviation"], float))))
    density = error_of(scene.explain().on, "ContinuityDensity")
    yield rows("change of the density", deviation / scene["water"].density, density, ORDER, where)
    # Slow enough to be left out, by its own estimate: how much slower is the vortex after L / U?
    reynolds, times = 50_000.0, 100.0
    scene, thinner = vortex(particles, 1 / reynolds, 0.0)
    _, thin = vortex(particles, times / reynolds, 0.0)  # at once it would drown in what the scheme itself takes
    spared = error_of(scene.explain().spare, "viscosity")
    speeds = [np.sqrt(np.mean(fields_at(run, "water", -1)[1] ** 2)) for run in (thin, thinner)]
    slower = float(np.log(speeds[1] / speeds[0])) / (times - 1)
    yield rows("speed without viscosity, Re 50,000, from Re 500", slower, spared, ORDER, where)


def dam_break(quick: bool) -> Iterator[list[Row]]:
    """The fastest water until it meets the far wall, and what an artificial viscosity takes from its energy."""
    particles, height = (12, 0.6) if quick else (40, 0.6)
    where, unit, energies = f"dam break, H / dx = {particles}", np.sqrt(height / 9.81), []
    for alpha in (0.02, 0.2):
        effects = [jaxsph.DeltaDiffusion(0.1), jaxsph.ArtificialViscosity(alpha)]
        scene = jaxsph.scenes.dam_break(particles, height=height, effects=effects, dtype=DTYPE)
        run = jaxsph.simulate(scene, 2.0 * unit, 0.1 * unit)
        explained = scene.explain()
        speed = float(explained.facts.speed or 0.0)
        if not energies:
            fastest = float(np.max(np.linalg.norm(np.asarray(run["water"]["velocity"], float), axis=-1)))
            yield rows("fastest water [m/s]", fastest, speed, ORDER, where)
            deviation = np.max(np.abs(np.asarray(run["water"]["density_deviation"], float)))
            density = error_of(explained.on, "ContinuityDensity")
            yield rows("change of the density", float(deviation) / scene["water"].density, density, ORDER, where)
        # In L / U from the moment at which water falls.
        index = int(np.argmin(np.abs(np.asarray(run.times, float) - height / speed)))
        position, velocity = fields_at(run, "water", index)
        mechanical = np.mean(0.5 * np.sum(velocity**2, axis=1) + 9.81 * position[:, 1])
        energies.append((mechanical / (9.81 * height), error_of(explained.on, "ArtificialViscosity")))
    taken, shares = (abs(energies[0][k] - energies[1][k]) for k in (0, 1))
    yield rows("energy that artificial viscosity takes / (g H)", float(taken), float(shares), ORDER, where)


def explained(quick: bool) -> Iterator[list[Row]]:
    yield from vortices(quick)
    yield from dam_break(quick)


CASES = [Case("explain", "Estimates of scene.explain(), beside runs", explained)]
