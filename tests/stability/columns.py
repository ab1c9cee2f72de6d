"""H10: a column in 3D that is pulled to four times its length, and one that is twisted by a whole turn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from rows import Case, Row, precision
from watch import of_structure, rise, rows_of, structure_rows, watch

import jaxsph
from jaxsph.geometry import box

HALF, DOUBLE = np.float32, np.float64
WIDTH, LENGTH, RAMP = 1.0, 3.0, 1.0  # m, m, s: a wave of shear takes .15 s along the column
DENSITY, MODULUS, RATIO = 1000.0, 1e6, 0.3
SMALLER = 0.6  # of the default step, which is that of the reference configuration
STRONG, USUAL = 20.0, 0.05  # coefficients of the penalty force
RUNS = ((HALF, 1.0, STRONG), (DOUBLE, 1.0, STRONG), (HALF, SMALLER, 3.0), (HALF, SMALLER, USUAL))
"""Precision, share of the default step, coefficient of the penalty force."""


class Grip:
    """Displacement of the clamped ends: the upper one goes up by `pull` lengths and turns by `turns` within RAMP."""

    def __init__(self, pull: float, turns: float):
        self.pull, self.turns = pull, turns

    def __call__(self, time, positions):
        s = jnp.clip(time / RAMP, 0.0, 1.0)
        share = s * s * s * (10 - 15 * s + 6 * s * s)
        angle = 2 * jnp.pi * self.turns * share
        x, y = positions[:, 0] - WIDTH / 2, positions[:, 1] - WIDTH / 2
        turned = jnp.stack([x * jnp.cos(angle) - y * jnp.sin(angle) - x, x * jnp.sin(angle) + y * jnp.cos(angle) - y])
        up = jnp.full_like(x, self.pull * LENGTH * share)
        return jnp.where(positions[:, 2:] > LENGTH / 2, jnp.stack([*turned, up], axis=1), 0.0)


def gripped(particles: int, dtype, pull: float, turns: float, penalty: float = USUAL) -> jaxsph.Scene:
    """A column of 1 m x 1 m x 3 m, neo-Hookean, without damping, held by its end faces."""
    spacing = WIDTH / (particles - 1)
    body = box((0, 0, 0), (WIDTH, WIDTH, LENGTH), spacing, on_surface=True, dtype=dtype)
    column = jaxsph.Structure(
        "column",
        body,
        density=DENSITY,
        youngs_modulus=MODULUS,
        poisson_ratio=RATIO,
        clamped=lambda x: (x[:, 2] < 0.01 * spacing) | (x[:, 2] > LENGTH - 0.01 * spacing),
        motion=Grip(pull, turns),
        law=jaxsph.NeoHookean(),
    )
    return jaxsph.Scene(column, effects=[jaxsph.PenaltyForce(penalty)])


def deformed(pull: float, turns: float, quick: bool, particles: int = 5, runs: Sequence = RUNS) -> Iterator[list[Row]]:
    """Half a second after the ramp: what the energy does while nothing moves the grips.

    Judged with a strong penalty force; with the usual one of bending beams it is shown.
    """
    saves = 30
    for dtype, share, penalty in runs[:1] if quick else runs:
        scene = gripped(particles, dtype, pull, turns, penalty)
        step = share * jaxsph.stable_time_step(scene)
        watched = watch(scene, 1.5 * RAMP, saves, of_structure(scene, "column"), time_step=step)
        where = (f"{particles} x {particles}, {share:g} of the step, penalty {penalty:g}", precision(dtype))
        held = watched.seen["energy"][saves * 2 // 3 + 1 :]
        gain = rise(held) / held[0] if len(held) else np.nan
        yield [
            *rows_of(watched, where, energy=None),
            Row("largest rise of the energy while held / energy", gain, 1e-3, *where),
            *structure_rows(watched, scene, "column", where),
            *[Row("energy while held [MJ]", float(value) / 1e6, None, *where) for value in held[:1]],
        ]


def stretched(quick: bool) -> Iterator[list[Row]]:
    return deformed(3.0, 0.0, quick)


def twisted(quick: bool) -> Iterator[list[Row]]:
    return deformed(0.0, 1.0, quick)


def twisted_finer(quick: bool) -> Iterator[list[Row]]:
    return deformed(0.0, 1.0, quick, particles=9, runs=RUNS[:1])


def half_twisted(quick: bool) -> Iterator[list[Row]]:
    return deformed(0.0, 0.5, quick, runs=RUNS[:1])


CASES = [
    Case("H10a", "Column in 3D stretched by 300 %", stretched),
    Case("H10b", "Column in 3D twisted by 360 degrees", twisted),
    Case("H10c", "Column in 3D twisted by 180 degrees", half_twisted),
    Case("H10d", "Column in 3D twisted by 360 degrees, finer", twisted_finer),
]
