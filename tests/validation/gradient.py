"""I07, I08: forward mode and reverse mode against central differences, through 100 steps."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from rows import Case, Row, across

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from struck_plate import HEIGHT, MIDDLE, THICKNESS, struck_plate  # pyright: ignore[reportMissingImports]

import inverse
import jaxsph

STEPS = 100
PLACES = ((0.01, 0.0), (0.02, 0.01), (0.05, 0.0), (0.15, -0.01), (0.35, 0.0))  # where it is observed [m]

UNKNOWN = {
    "beam.youngs_modulus": inverse.log(1e6, 2e6, start=1.3e6, unit="Pa"),
    "beam.poisson_ratio": inverse.linear(0.3, 0.45, start=0.39),
    "beam.density": inverse.log(800, 1200, start=980.0, unit="kg/m^3"),
    "beam.velocity": inverse.linear([-1.0, -1.0], [1.0, 1.0], start=[0.2, -0.4], unit="m/s"),
}

COUPLED = {
    "plate.youngs_modulus": inverse.log(1.8e6, 2.2e6, start=2e6, unit="Pa"),
    "plate.poisson_ratio": inverse.linear(0.2, 0.4, start=0.3),
    "plate.density": inverse.log(1400, 1600, start=1500.0, unit="kg/m^3"),
    "water.viscosity": inverse.log(1.5, 2.5, start=2.0, unit="Pa s"),
    "water.density": inverse.log(900, 1100, start=1000.0, unit="kg/m^3"),
}


def gradient_check(quick: bool) -> Iterator[list[Row]]:
    """A beam that strikes its clamp: the wave passes the places near the root within the hundred steps."""
    for particles in (5,) if quick else (5, 9):
        scene = jaxsph.scenes.turek_hron_beam(particles, dtype=np.float64)
        stiffest = {"beam.youngs_modulus": 2e6, "beam.poisson_ratio": 0.45, "beam.density": 800.0}
        step = 0.9 * jaxsph.stable_time_step(scene.replace(stiffest))
        times = step * (STEPS // 5) * np.arange(1, 6)

        def observe(run):
            return jnp.concatenate([run.probe("beam", at).displacement for at in PLACES], axis=1)

        data = inverse.Observations(times, np.zeros((5, 2 * len(PLACES))), 1e-4)
        problem = inverse.Problem(scene, observe, data, UNKNOWN, time_step=step * (1 + 1e-6), save_every=times[0])
        yield rows_of(problem, f"{across(particles)}, {STEPS} steps")


def rows_of(problem: inverse.Problem, resolution: str) -> list[Row]:
    """Both modes against central differences, by unknown."""
    check, rows = problem.check(), []
    for name in problem.unknown:
        mine = [i for i, direction in enumerate(check.directions) if direction.startswith(name)]
        for mode in ("forward", "reverse"):
            error = np.max(np.abs(getattr(check, mode)[mine] / check.central[mine] - 1))
            rows.append(Row(f"|AD - FD| / |FD|, {mode}, {name}", float(error), 1e-6, resolution, "float64"))
    return rows


def coupled_check(quick: bool) -> Iterator[list[Row]]:
    """Water that strikes a plate, which bends and throws it back."""
    scene = struck_plate()
    step = 0.6 * jaxsph.stable_time_step(scene)
    times = step * (STEPS // 5) * np.arange(1, 6)

    def observe(run):
        plate, water = run.probe("plate", (MIDDLE, -THICKNESS)), run.probe("water", (MIDDLE, 0.5 * HEIGHT))
        # scales of their own: a deflection of a millimeter beside velocities of meters a second
        return jnp.concatenate([1e3 * plate.displacement, plate.velocity, water.velocity], axis=1)

    data = inverse.Observations(times, np.zeros((5, 6)), 1.0)
    problem = inverse.Problem(scene, observe, data, COUPLED, time_step=step * (1 + 1e-6), save_every=times[0])
    yield rows_of(problem, f"3 across, {STEPS} steps")


CASES = [
    Case("I07", "Gradient check", gradient_check),
    Case("I08", "Gradient check, water that strikes an elastic plate", coupled_check),
]
