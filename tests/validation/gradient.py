"""I07: forward mode and reverse mode against central differences, through 100 steps."""

from __future__ import annotations

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from rows import Case, Row, across

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
        check = problem.check()
        where = (f"{across(particles)}, {STEPS} steps", "float64")
        rows = []
        for name in UNKNOWN:
            mine = [i for i, direction in enumerate(check.directions) if direction.startswith(name)]
            for mode in ("forward", "reverse"):
                error = np.max(np.abs(getattr(check, mode)[mine] / check.central[mine] - 1))
                rows.append(Row(f"|AD - FD| / |FD|, {mode}, {name}", float(error), 1e-6, *where))
        yield rows


CASES = [Case("I07", "Gradient check", gradient_check)]
