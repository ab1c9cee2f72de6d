"""H04 to H06: water that strikes its tank for a long time, and water that has to stay still."""

from __future__ import annotations

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from rows import Case, Row, precision
from watch import depth_beyond, fastest, outside, rows_of, watch

import jaxsph
from jaxsph.scenes.tank_flow import GRAVITY, column_in_tank

HALF, DOUBLE = np.float32, np.float64
FAR = 1e9  # the open top
USUAL = [jaxsph.DeltaDiffusion(0.1), jaxsph.ArtificialViscosity(0.02)]  # the default of these scenes
REPELLED = ", WallRepulsion"
NEAR = ", WallRepulsion from .6"
KINDS = {
    "": USUAL,
    REPELLED: [*USUAL, jaxsph.WallRepulsion()],
    NEAR: [*USUAL, jaxsph.WallRepulsion(8.0, distance=0.6)],
}
TANK = (1.0, 0.4)  # length of the shaken tank, depth of its water [m]


class Shake:
    """Displacement of a tank along x, amplitude (1 - cos w t)."""

    def __init__(self, amplitude: float, frequency: float):
        self.amplitude, self.frequency = amplitude, frequency

    def __call__(self, time, positions):
        way = self.amplitude * (1 - jnp.cos(self.frequency * time))
        return jnp.zeros_like(positions).at[:, 0].set(way)


def shaken(particles: int, dtype, effects=None) -> tuple[jaxsph.Scene, Shake]:
    """A tank of 1 m with .4 m of water, shaken at its first natural frequency with 5 % of its length."""
    length, depth = TANK
    k = np.pi / length
    shake = Shake(0.05 * length, float(np.sqrt(GRAVITY * k * np.tanh(k * depth))))
    scene = column_in_tank(
        (length, depth),
        (length, 5 * depth),
        depth / particles,
        sound_speed=30 * np.sqrt(GRAVITY * depth),
        motion=shake,
        effects=effects,
        dtype=dtype,
    )
    return scene, shake


def sloshing(quick: bool) -> Iterator[list[Row]]:
    """Ten periods; as the scene is, and repelled."""
    (length, depth), particles = TANK, 12
    runs = [(kind, dtype) for kind in KINDS for dtype in (HALF, DOUBLE)]
    for kind, dtype in runs[:1] if quick else runs:
        scene, shake = shaken(particles, dtype, KINDS[kind])
        shift = lambda time, shake=shake: shake(time, jnp.zeros((1, 2)))[0]  # noqa: E731
        measures = {"depth": depth_beyond("water", (0.0, 0.0), (length, FAR), shift)}
        watched = watch(scene, 10 * 2 * np.pi / shake.frequency, 100, measures)
        where = (f"{particles} over the depth{kind}", precision(dtype))
        yield [*rows_of(watched, where, energy=None), *outside(watched, depth / particles, where)]


def dam(quick: bool) -> Iterator[list[Row]]:
    """Buchner's dam break, long after it struck the far wall and fell back on itself; as the scene is, and repelled."""
    height, width, length = 0.6, 1.2, 3.2196
    unit = np.sqrt(height / GRAVITY)
    runs = [(kind, n, dtype) for kind in KINDS for n in (12, 20) for dtype in (HALF, DOUBLE)]
    for kind, particles, dtype in runs[:1] if quick else runs:
        scene = jaxsph.scenes.dam_break(
            particles, height=height, width=width, tank_length=length, effects=KINDS[kind], dtype=dtype
        )
        spacing = height / particles
        inside = round(length / spacing) * spacing
        measures = {"depth": depth_beyond("water", (0.0, 0.0), (inside, FAR))}
        watched = watch(scene, 20 * unit, 100, measures)
        # what it loses until it lies level
        size = 1000 * GRAVITY * width * height * 0.5 * (height - width * height / inside)
        where = (f"H / dx = {particles}{kind}", precision(dtype))
        rows = rows_of(watched, where, energy=size)
        yield [*rows, *outside(watched, spacing, where)]


def still(quick: bool) -> Iterator[list[Row]]:
    """Water that stands for 50 sqrt(H / g); the largest speed of its second half, when the start has died out."""
    height = 0.9
    unit, speed = np.sqrt(height / GRAVITY), np.sqrt(GRAVITY * height)
    runs = [(10, HALF, ""), (10, DOUBLE, ""), (20, HALF, ""), (20, DOUBLE, ""), (10, DOUBLE, REPELLED)]
    for particles, dtype, kind in runs[:1] if quick else runs:
        scene = jaxsph.scenes.still_water(particles, height=height, effects=KINDS[kind], dtype=dtype)
        inside = round(1.0 / (height / particles)) * height / particles
        measures = {"speed": fastest("water"), "depth": depth_beyond("water", (0.0, 0.0), (inside, FAR))}
        watched = watch(scene, 50 * unit, 100, measures)
        where = (f"{particles} over the depth{kind}", precision(dtype))
        rows = rows_of(watched, where, energy=1000 * GRAVITY * inside * height**2 / 2)
        moving = watched.seen["speed"] / speed
        yield [
            *rows,
            Row("largest speed / sqrt(gH), at all times", moving.max(), None, *where),
            Row("largest speed / sqrt(gH), 25 to 50 sqrt(H/g)", moving[50:].max(), 0.005, *where),
            *outside(watched, height / particles, where),
        ]


CASES = [
    Case("H04", "Sloshing at resonance, 10 periods", sloshing),
    Case("H05", "Dam break to t = 20 sqrt(H/g)", dam),
    Case("H06", "Still water for 50 sqrt(H/g)", still),
]
