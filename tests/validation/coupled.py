"""X01 to X04: fluids and elastic plates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from reference import number, table
from rows import Case, Row, across, precision

import jaxsph

DEFLECTION = number("fsi/hydrostatic_plate_fem.csv", "w_fem_midplane_m", nu="0.3")
PEAKS, ONSETS = (0.0410, 0.0491), (0.148, 0.162)  # m, s: lowest and highest of six published codes


def column_on_plate(quick: bool) -> Iterator[list[Row]]:
    """Mean deflection of the middle over the second half of .5 s, about which the plate still swings."""
    errors = {}
    runs = ((5, np.float32, 0.10), (5, np.float64, 0.10), (7, np.float32, None), (11, np.float32, 0.05))
    for n, dtype, limit in runs:
        if quick and (n, dtype) != (5, np.float32):
            continue
        run = jaxsph.simulate(jaxsph.scenes.water_column_on_plate(n, dtype=dtype), 0.5, 0.0025)
        middle = np.asarray(run.probe("plate", (0.5, -0.025)).displacement[:, 1], float)
        late = np.asarray(run.times) >= 0.25
        error = abs(float(np.mean(middle[late])) / DEFLECTION - 1)
        errors[n, dtype] = error
        where = (across(n), precision(dtype))
        yield [
            Row("relative error of the mean deflection, .25 to .5 s", error, limit, *where),
            Row("standard deviation / mean of the deflection", float(np.std(middle[late])) / -DEFLECTION, None, *where),
        ]
    if not quick:
        for fine, coarse in ((7, 5), (11, 7), (11, 5)):
            ratio = errors[fine, np.float32] / errors[coarse, np.float32]
            yield [
                Row("error of the deflection / that of the coarser", ratio, 1.0, f"{coarse}, {fine} across", "float32")
            ]


def dam_break_on_plate(quick: bool) -> Iterator[list[Row]]:
    """When the tip begins to move, and how far it gets; how much of that is chance, or of the plate's particles.

    A sound speed higher by 1 % changes nothing but how the splash falls.
    """
    peaks = {}
    runs = ((15, 5, np.float32), (15, 5, np.float64), (30, 5, np.float32), (45, 7, np.float32), (60, 9, np.float32))
    runs = (*runs, (75, 11, np.float32))
    for n, over_thickness, dtype in runs[:1] if quick else runs:
        peak, onset = tip(jaxsph.scenes.dam_break_plate(n, over_thickness, dtype=dtype))
        peaks[n, dtype] = peak
        where = (f"a / dx = {n}, {across(over_thickness)}", precision(dtype))
        yield [
            Row("peak of the tip / the envelope's nearer end", outside(peak, PEAKS), 1.05, *where),
            Row("onset (5 mm) / the envelope's nearer end", outside(onset, ONSETS), 1.05, *where),
            Row("peak of the tip [m]", peak, None, *where),
            Row("onset of the tip (5 mm) [s]", onset, None, *where),
        ]
    if quick:
        return
    for three in ((15, 30, 60), (30, 45, 60), (45, 60, 75)):
        coarse, middle, fine = (peaks[n, np.float32] for n in three)
        ratio = abs(fine - middle) / abs(middle - coarse)
        places = ", ".join(str(n) for n in three)
        yield [Row("change of the peak / that of the coarser", ratio, 1.0, places, "float32")]
    for n, over_thickness, _ in (runs[0], runs[2], runs[3]):
        scene = jaxsph.scenes.dam_break_plate(n, over_thickness, dtype=np.float32)
        peak, _ = tip(scene.replace({"water.sound_speed": 1.01 * scene["water"].sound_speed}))
        change = abs(peak / peaks[n, np.float32] - 1)
        where = f"a / dx = {n}, {across(over_thickness)}"
        yield [Row("relative change of the peak by 1 % of the sound speed", change, None, where, "float32")]
    peak, _ = tip(jaxsph.scenes.dam_break_plate(60, 5, dtype=np.float32))
    yield [Row("peak of the tip [m]", peak, None, f"a / dx = 60, {across(5)}", "float32")]


def tip(scene: jaxsph.Scene) -> tuple[float, float]:
    """Largest displacement [m] of the tip of `dam_break_plate` in .4 s, and when it has passed 5 mm [s]."""
    run = jaxsph.simulate(scene, 0.4, 0.0025)
    displacement = np.asarray(run.probe("plate", (0.292, 0.08)).displacement[:, 0], float)
    return float(displacement.max()), float(run.times[int(np.argmax(displacement > 0.005))])


def outside(value: float, ends: tuple[float, float]) -> float:
    """How far a value is outside an interval, as a ratio: at most 1 inside."""
    return max(ends[0] / value, value / ends[1])


def gate(quick: bool) -> Iterator[list[Row]]:
    """Horizontal displacement of the gate's free end against the experiment, by moduli and Poisson ratios in use."""
    times, measured = series("Antoci2007_experiment")
    dtype = np.float32
    runs = ((40, 7.8e6, 0.47, 0.18), (40, 7.8e6, 0.4, 0.18), (40, 12e6, 0.4, None))
    runs = (*runs, (20, 7.8e6, 0.4, 0.18), (60, 7.8e6, 0.4, 0.18), (80, 7.8e6, 0.4, 0.18))
    for particles, modulus, ratio, limit in runs[:1] if quick else runs:
        scene = jaxsph.scenes.elastic_gate(particles, youngs_modulus=modulus, poisson_ratio=ratio, dtype=dtype)
        run = jaxsph.simulate(scene, 0.4, 0.005)
        end = np.asarray(run.probe("gate", (0.1025, 0.0)).displacement[:, 0], float)
        rms = misfit(times, measured, np.asarray(run.times, float), end)
        where = (f"{particles} over the width", precision(dtype))
        about = f"E = {modulus / 1e6:g} MPa, Poisson ratio {ratio:g}"
        yield [Row(f"rms of ux / its peak, {about}", rms, limit, *where)]
    yield [
        Row(f"rms of ux / its peak, {name}", misfit(times, measured, *series(name)), None, "published", "-")
        for name in ("Khayyer2018_ISPH-SPH", "Yang2012_SPH-FEM", "Ng2020_SPH-VCPM")
    ]


def series(name: str) -> np.ndarray:
    """Times [s] and horizontal displacements [m] (2, T) of the free end, measured or of other codes."""
    rows = [row for row in table("fsi/antoci_elastic_gate.csv") if row["dataset"] == name and row["component"] == "ux"]
    return np.array([(float(row["t_s"]), float(row["disp_m"])) for row in rows]).T


def misfit(times: np.ndarray, measured: np.ndarray, when: np.ndarray, simulated: np.ndarray) -> float:
    """Root mean square of the difference at the measured times over the largest that was measured."""
    difference = np.interp(times, when, simulated) - measured
    return float(np.sqrt(np.mean(difference**2)) / measured.max())


CASES = [
    Case("X01", "Water column on an elastic plate", column_on_plate),
    Case("X03", "Elastic gate (Antoci 2007)", gate),
    Case("X04", "Dam break on an elastic plate", dam_break_on_plate),
]
