"""S10: a plane p-wave, driven by a moving wall."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from reference import table
from rows import Case, Row, precision

import jaxsph

STRAIN = 1e-3  # of the wave: speed of the wall over the wave's; small, so that the law is linear
RISE = 0.1  # duration of the wall's start over the time L / c


def bar_wave(quick: bool) -> Iterator[list[Row]]:
    """A block as wide as long: on its middle line the strain is uniaxial until the sides' waves arrive (12 % later)."""
    for case in table("solid/bar_wave.csv")[:1]:
        length, speed, arrival = float(case["L"]), float(case["c_p"]), float(case["arrival_time"])
        rise = RISE * arrival
        wall_speed = STRAIN * speed

        def motion(t, positions, rise=rise, wall_speed=wall_speed):
            # speed (1 - cos(pi t / rise)) / 2 up to t = rise, then constant; at half of it at t = rise / 2
            s = jnp.clip(t / rise, 0.0, 1.0)
            moved = wall_speed * (rise * 0.5 * (s - jnp.sin(jnp.pi * s) / jnp.pi) + jnp.maximum(t - rise, 0.0))
            return jnp.zeros_like(positions).at[:, 0].set(moved)

        for cells, dtype in ((50, np.float64),) if quick else ((50, np.float64), (100, np.float64), (100, np.float32)):
            spacing = length / cells
            block = jaxsph.box(
                (-3 * spacing, -length / 2), (length + 3 * spacing, length), spacing, on_surface=True, dtype=dtype
            )
            structure = jaxsph.Structure(
                "block",
                block,
                density=float(case["rho"]),
                youngs_modulus=float(case["E"]),
                poisson_ratio=float(case["nu"]),
                clamped=lambda x, spacing=spacing: x[:, 0] < 0.01 * spacing,
                motion=motion,
            )
            scene = jaxsph.Scene(structure, effects=[jaxsph.PenaltyForce(0.05)])
            run = jaxsph.simulate(scene, 1.2 * arrival, arrival / 200)
            at_end = passing(run, length, wall_speed) - rise / 2  # a free end moves at twice the speed of the wall
            between = passing(run, 0.75 * length, wall_speed / 2) - passing(run, 0.25 * length, wall_speed / 2)
            where = (f"{cells} over length", precision(dtype))
            limit = 0.02 if cells >= 100 else None  # 50 are for the order: the ends shift the wave by spacings
            yield [
                Row("relative error, arrival at the end", abs(at_end / arrival - 1), limit, *where),
                Row("relative error, time from L/4 to 3L/4", abs(between / (0.5 * arrival) - 1), 0.02, *where),
                Row("relative error, stress / wall speed", impedance_error(scene, run, case), 0.02, *where),
            ]


def passing(run, x: float, speed: float) -> float:
    """When the middle line at x [m] first moves faster than a speed [m/s], linearly interpolated [s]."""
    times = np.asarray(run.times, float)
    seen = np.asarray(run.probe("block", (x, 0.0)).velocity, float)[:, 0]
    after = int(np.argmax(seen > speed))
    part = (speed - seen[after - 1]) / (seen[after] - seen[after - 1])
    return float(times[after - 1] + part * (times[after] - times[after - 1]))


def impedance_error(scene, run, case) -> float:
    """Relative error of stress over wall speed, at a quarter of the length when the front is beyond the half."""
    when = int(np.argmin(np.abs(np.asarray(run.times) - 0.6 * float(case["arrival_time"]))))
    state = jax.tree.map(lambda leaf: leaf[when], run.states)
    positions = np.asarray(scene["block"].particles.positions)
    length, spacing = float(case["L"]), scene["block"].particles.spacing
    near = (np.abs(positions[:, 0] - 0.25 * length) < 2.5 * spacing) & (np.abs(positions[:, 1]) < 2.5 * spacing)
    stress = -float(np.mean(np.asarray(jaxsph.observe.stresses(scene, state, "block")["cauchy"])[near, 0, 0]))
    wall_speed = STRAIN * float(case["c_p"])
    return abs(stress / wall_speed / float(case["impedance_Pa_per_mps"]) - 1)


CASES = [Case("S10", "Plane p-wave in a block", bar_wave)]
