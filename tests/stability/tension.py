"""H01 to H03: fluids under tension, where particles clump and tear, and jets that hit each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from rows import Case, Row, precision
from scipy.spatial import KDTree
from surfaces import largest_hole
from watch import rows_of, watch

import jaxsph
from jaxsph.geometry import box

HALF, DOUBLE = np.float32, np.float64


def vortices(quick: bool) -> Iterator[list[Row]]:
    """Taylor-Green at Re 1000, whose stagnation points tear at the particles, until a fifth of the energy is left.

    The last run lists no shifting: what the others owe to it.
    """
    reynolds, t_end = 1000.0, 10.0
    shifted, bare = None, [jaxsph.DensityDiffusion(0.1)]
    runs = [(25, HALF, shifted), (25, DOUBLE, shifted), (50, HALF, shifted), (25, HALF, bare)]
    for particles, dtype, effects in runs[:1] if quick else runs:
        scene = jaxsph.scenes.taylor_green(particles, reynolds=reynolds, effects=effects, dtype=dtype)
        watched = watch(scene, t_end, 50)
        name = f"{particles} x {particles}" + (", no shifting" if effects is bare else "")
        where = (name, precision(dtype))
        rows = rows_of(watched, where, energy=0.25)
        if effects is bare:  # shown, not asked for
            rows = [replace(row, limit=None) for row in rows]
        place = np.asarray(watched.run["water"]["position"][-1], float) % 1.0
        apart = KDTree(place, boxsize=1.0).query(place, k=2)[0][:, 1]
        exact = np.exp(-2 * 8 * np.pi**2 * float(watched.run.times[-1]) / reynolds)
        speed = np.asarray(watched.run["water"]["velocity"][-1], float)
        kept = float(np.mean(np.sum(speed**2, axis=1)) / 0.5 / exact)
        closest = float(1 / (particles * apart.min()))
        rows += [
            Row("spacing / distance of the closest pair, at the end", closest, None, *where),
            Row("|kinetic energy / exact - 1|, at the end", abs(kept - 1), None, *where),
        ]
        yield rows


def patch(quick: bool) -> Iterator[list[Row]]:
    """The rotating square, whose middle is under tension, until its arms are as long as it was wide."""
    runs = [(20, HALF), (20, DOUBLE), (40, HALF)]
    for particles, dtype in runs[:1] if quick else runs:
        scene = jaxsph.scenes.rotating_square(particles, dtype=dtype)
        watched = watch(scene, 4.0, 40)
        where = (f"{particles} x {particles}", precision(dtype))
        rows = rows_of(watched, where, energy=1000 / 12)
        holes = [
            largest_hole(np.asarray(place, float), 1 / particles) for place in watched.run["water"]["position"][::5]
        ]
        yield [*rows, Row("largest hole inside / spacing", max(holes), 2.0, *where)]


JET_SPEED, JET_WIDTH, JET_LENGTH = 1.0, 0.25, 1.0


def two_jets(across: int, dtype, mach: float = 0.02) -> jaxsph.Scene:
    """Two blocks of water that hit each other head on, each with the same speed.

    The first contact compresses by the Mach number, as along a bar: it has to be below the limit of the density.
    """
    spacing = JET_WIDTH / across
    size = (JET_LENGTH, JET_WIDTH)
    left, right = (box((x, -0.5 * JET_WIDTH), size, spacing, dtype=dtype) for x in (-JET_LENGTH, 0.0))
    water = jaxsph.Fluid(
        "water",
        left | right,
        density=1000.0,
        sound_speed=JET_SPEED / mach,
        velocity=lambda x: np.stack([-JET_SPEED * np.sign(x[:, 0]), 0 * x[:, 0]], axis=1),
    )
    effects = [jaxsph.DeltaDiffusion(0.1), jaxsph.ArtificialViscosity(0.02)]
    return jaxsph.Scene(
        water, effects=effects, smoothing_length=2 * spacing, domain=jaxsph.Domain((-4.0, -4.0), (4.0, 4.0))
    )


def jets(quick: bool) -> Iterator[list[Row]]:
    """Jets that hit each other head on, until all of them has turned aside: density, energy, momentum."""
    size = 1000 * JET_LENGTH * JET_WIDTH * JET_SPEED**2  # kinetic energy of both
    for across, dtype in [(10, HALF)] if quick else [(10, HALF), (10, DOUBLE)]:
        scene = two_jets(across, dtype)
        mass = scene["water"].mass()
        watched = watch(
            scene,
            1.5,
            60,
            {"momentum": lambda s, mass=mass: jnp.sum(mass * s.systems["water"]["velocity"].T, axis=1)},
        )
        where = (f"{across} across a jet", precision(dtype))
        momentum = np.linalg.norm(watched.seen["momentum"], axis=1).max() / (2 * size / JET_SPEED)
        # opposite forces cancel to the rounding of some thousand steps
        limit = 1e-4 if dtype is HALF else 1e-12
        yield [*rows_of(watched, where, energy=size), Row("|momentum| / (mass U)", float(momentum), limit, *where)]


CASES = [
    Case("H01", "Taylor-Green vortex, Re 1000, to t = 10 L/U", vortices),
    Case("H02", "Rotating square, under tension, to w t = 4", patch),
    Case("H03", "Impinging jets, U / c = .02", jets),
]
