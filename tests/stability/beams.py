"""H08, H09, H12, H13: beams with modes that cost no energy, nearly incompressible, thin, and for a long time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from motion import SAVE_EVERY, TIP, csm3_reference, oscillation
from rows import Case, Row, across, precision
from watch import Watched, of_structure, rows_of, structure_rows, watch

import jaxsph

HALF, DOUBLE = np.float32, np.float64
LENGTH, THICKNESS, GRAVITY, DENSITY, MODULUS = 0.35, 0.02, 2.0, 1000.0, 1.4e6  # of Turek and Hron's beam


def beam(particles: int, dtype, *, poisson_ratio: float = 0.4, penalty: float = 0.05) -> jaxsph.Scene:
    """Turek and Hron's beam with a flat root."""
    return jaxsph.scenes.cantilever(
        LENGTH,
        THICKNESS,
        particles,
        density=DENSITY,
        youngs_modulus=MODULUS,
        poisson_ratio=poisson_ratio,
        gravity=(0.0, -GRAVITY),
        penalty=penalty,
        dtype=dtype,
    )


def beam_rows(scene, watched: Watched, where: tuple[str, str]) -> list[Row]:
    """What every beam has to keep; the unit of its energy is the largest kinetic one."""
    rows = rows_of(watched, where, energy=float(watched.seen["kinetic"].max()))
    return rows + structure_rows(watched, scene, "beam", where)


def penalties(quick: bool) -> Iterator[list[Row]]:
    """The beam falls into its swing, with no, little and much penalty force, for five periods."""
    runs = [(5, HALF, c) for c in (0.0, 0.01, 0.1)] + [(5, DOUBLE, c) for c in (0.0, 0.01, 0.1)] + [(9, HALF, 0.0)]
    for particles, dtype, penalty in runs[:1] if quick else runs:
        scene = beam(particles, dtype, penalty=penalty)
        watched = watch(scene, 4.5, 90, of_structure(scene, "beam"))
        yield beam_rows(scene, watched, (f"{across(particles)}, penalty {penalty:g}", precision(dtype)))


def incompressible(quick: bool) -> Iterator[list[Row]]:
    """Poisson ratios at which elements of low order lock: two periods, and the deflection about which it swings."""
    runs = [(5, dtype, ratio) for dtype in (HALF, DOUBLE) for ratio in (0.45, 0.49, 0.499)]
    for particles, dtype, ratio in runs[:1] if quick else runs:
        scene = beam(particles, dtype, poisson_ratio=ratio)
        watched = watch(scene, 2.0, 80, of_structure(scene, "beam"))
        where = (f"{across(particles)}, {ratio:g}", precision(dtype))
        rows = beam_rows(scene, watched, where)
        tip = np.asarray(watched.run.probe("beam", TIP).displacement, float)[:, 1]
        # w L^4 / (8 E I), plane strain: a small deflection, of which the beam's own is 1 % less
        theory = DENSITY * GRAVITY * LENGTH**4 * (1 - ratio**2) * 12 / (8 * MODULUS * THICKNESS**2)
        middle = -0.5 * (tip.max() + tip.min())
        yield [*rows, Row("|mean deflection / beam theory - 1|", abs(float(middle) / theory - 1), None, *where)]


def three_across(quick: bool) -> Iterator[list[Row]]:
    """CSM3 with three particles over the thickness, ten seconds."""
    expected = csm3_reference()
    for dtype in (HALF,) if quick else (HALF, DOUBLE):
        scene = jaxsph.scenes.turek_hron_beam(3, dtype=dtype)
        watched = watch(scene, 10.0, round(10 / SAVE_EVERY / 4), of_structure(scene, "beam"))
        where = (across(3), precision(dtype))
        rows = beam_rows(scene, watched, where)
        tip = np.asarray(watched.run.probe("beam", TIP).displacement, float)[:, 1]
        found = oscillation(np.asarray(watched.run.times, float), tip)
        yield [
            *rows,
            Row("relative error, frequency of uy", abs(found.frequency / expected.frequency - 1), None, *where),
            Row("relative error, amplitude of uy", abs(found.amplitude / expected.amplitude - 1), None, *where),
        ]


def hundred_seconds(quick: bool) -> Iterator[list[Row]]:
    """CSM3 for 100 s, 110 periods: its energy, and the amplitude of the last ten seconds beside that of the first."""
    for particles, dtype in [(3, HALF)] if quick else [(5, HALF), (5, DOUBLE)]:
        scene = jaxsph.scenes.turek_hron_beam(particles, dtype=dtype)
        watched = watch(scene, 100.0, 2000, of_structure(scene, "beam"))
        where = (across(particles), precision(dtype))
        energy, size = watched.seen["energy"], watched.seen["kinetic"].max()
        tip = np.asarray(watched.run.probe("beam", TIP).displacement, float)[:, 1]
        first, last = np.ptp(tip[:200]), np.ptp(tip[-200:])
        drift = float(np.max(np.abs(energy - energy[0])) / size)
        yield [
            *rows_of(watched, where, energy=None),
            Row("largest |energy - that of the start| / largest kinetic", drift, 0.02, *where),
            *structure_rows(watched, scene, "beam", where),
            Row("|amplitude of the last 10 s / that of the first - 1|", abs(float(last / first) - 1), None, *where),
        ]


CASES = [
    Case("H08", "Modes without energy, penalty 0, .01, .1", penalties),
    Case("H09", "Beam, Poisson ratio .45, .49, .499", incompressible),
    Case("H12a", "CSM3 with 3 particles across", three_across),
    Case("H13", "CSM3 for 100 s", hundred_seconds),
]
