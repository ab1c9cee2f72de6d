"""S05, S06: vibrations of cantilevers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from reference import column, number
from rows import Case, Row, across, precision
from scipy.optimize import minimize_scalar

import jaxsph

SAVE_EVERY = 0.005  # s, as the reference series of CSM3; a peak between two samples is missed by less than 2e-4
TIP = (0.35, 0.0)


@dataclass(frozen=True)
class Oscillation:
    """Amplitude (max - min) / 2, that of the fundamental alone, mean (max + min) / 2 [m], and frequency [Hz]."""

    amplitude: float
    fundamental: float
    mean: float
    frequency: float


MODES = {"first": (1.0, 1.2), "second": (6.3, 6.8), "third": (16.8, 18.2), "fourth": (31.0, 36.0)}
"""Modes of CSM3, and between which frequencies [Hz] each is sought: they swing all at once, from rest."""


def mode_frequencies(times: np.ndarray, values: np.ndarray) -> dict[str, float]:
    """Frequencies [Hz] at which the spectrum of a series of CSM3 is largest, by mode; through a window of Hann."""
    weighted = (values - values.mean()) * np.hanning(len(values))

    def negated(frequency):
        return -abs(np.exp(-2j * np.pi * frequency * times) @ weighted)

    found = {}
    for mode, (low, high) in MODES.items():
        frequencies = np.arange(low, high, 0.01)  # a tenth of what ten seconds resolve
        near = frequencies[np.argmin([negated(frequency) for frequency in frequencies])]
        best: Any = minimize_scalar(negated, bounds=(near - 0.01, near + 0.01), method="bounded")
        found[mode] = float(best.x)
    return found


def freed_of_time_step(frequency: float, step: float = SAVE_EVERY) -> float:
    """The frequency [Hz] of which the trapezoidal rule with this step [s] makes the one given.

    From w dt / 2 = tan(w' dt / 2). The reference looks as if it was made so, with a step for each of its samples: its
    modes are slower than ours by what this says, all four of them, to some thousandths.
    """
    return float(np.tan(np.pi * frequency * step) / (np.pi * step))


def oscillation(times: np.ndarray, values: np.ndarray) -> Oscillation:
    """Extremes, and the frequency from the first to the last upward crossing of the mean, linearly interpolated.

    The fundamental is the sine of least squares beside a constant and the second harmonic, at its own best frequency:
    extremes over many periods also hold how higher modes happen to fall on them.

    Raises ValueError for a series with fewer than two such crossings.
    """
    high, low = float(values.max()), float(values.min())
    mean = 0.5 * (high + low)
    offset = values - mean
    before = np.flatnonzero((offset[:-1] < 0) & (offset[1:] >= 0))
    if len(before) < 2:
        raise ValueError(f"{len(before)} upward crossings of the mean within {times[-1]:g} s; two are needed")
    crossings = times[before] - offset[before] * np.diff(times)[before] / np.diff(offset)[before]
    frequency = float((len(before) - 1) / (crossings[-1] - crossings[0]))
    return Oscillation(0.5 * (high - low), fundamental(times, values, frequency), mean, frequency)


def fundamental(times: np.ndarray, values: np.ndarray, near: float) -> float:
    """Amplitude of the sine that fits a series best, its frequency within 2 % of `near` [Hz]."""

    def fit(frequency):
        waves = [wave(2 * np.pi * k * frequency * times) for k in (1, 2) for wave in (np.sin, np.cos)]
        columns = np.stack([np.ones_like(times), *waves], axis=1)
        weights = np.linalg.lstsq(columns, values)[0]
        return weights, float(np.sum((columns @ weights - values) ** 2))

    found: Any = minimize_scalar(lambda f: fit(f)[1], bounds=(0.98 * near, 1.02 * near), method="bounded")
    weights, _ = fit(found.x)
    return float(np.hypot(weights[1], weights[2]))


def tip_motion(scene: jaxsph.Scene, at, t_end: float, save_every: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) [s] and displacement (T, d) [m] of a point of the only structure.

    Runs in parts of a hundred saves that continue each other, so that a long run does not hold all its states.
    """
    saves, state = round(t_end / save_every), None
    times, motion = [], []
    step = jaxsph.stable_time_step(scene)
    while saves > 0:
        part = min(saves, 100)
        run = jaxsph.simulate(scene, part * save_every, save_every, state=state, time_step=step)
        state = run.final
        seen = slice(0 if not times else 1, None)
        times.append(np.asarray(run.times, float)[seen])
        motion.append(np.asarray(run.probe(scene.systems[0].name, at).displacement, float)[seen])
        saves -= part
    return np.concatenate(times), np.concatenate(motion)


def csm3_reference(name: str = "turek_csm3_timeseries") -> Oscillation:
    """A finite-element series of CSM3, by the same processing."""
    return oscillation(column(f"solid/{name}.csv", "t_s"), column(f"solid/{name}.csv", "uy_m"))


RISE = "rise of the highest point in 10 s / amplitude"


def rise(values: np.ndarray) -> float:
    """By how much the highest peak of a series is above the first, over its amplitude (max - min) / 2."""
    before, here, after = values[:-2], values[1:-1], values[2:]
    peaks = here[(here > before) & (here >= after) & (here > 0.5 * (values.max() + values.min()))]
    return float(peaks.max() - peaks[0]) / (0.5 * float(values.max() - values.min()))


def between_references() -> list[Row]:
    """How far two finite-element solutions agree, and how their peaks rise."""
    names = ("turek_csm3_timeseries", "csm3_fem_timeseries")
    first, second = (csm3_reference(name) for name in names)
    rows = []
    for name in ("amplitude", "fundamental", "frequency"):
        difference = abs(getattr(second, name) / getattr(first, name) - 1)
        rows.append(Row(f"relative difference of two finite-element series, {name}", difference, None, "-", "float64"))
    for name, source in zip(names, ("Turek and Hron", "own finite elements"), strict=True):
        rows.append(Row(RISE, rise(column(f"solid/{name}.csv", "uy_m")), None, source, "float64"))
    both = [csm3_modes(name) for name in names]
    for mode in MODES:
        difference, slow = abs(both[1][mode] / both[0][mode] - 1), 1 - both[0][mode] / freed_of_time_step(both[0][mode])
        rows.append(
            Row(f"relative difference of two finite-element series, {mode} mode", difference, None, "-", "float64")
        )
        rows.append(Row(f"how much slower by its time step, {mode} mode", slow, None, "Turek and Hron", "float64"))
    return rows


def csm3_modes(name: str = "turek_csm3_timeseries") -> dict[str, float]:
    """`mode_frequencies` of a finite-element series of CSM3, as it is."""
    return mode_frequencies(column(f"solid/{name}.csv", "t_s"), column(f"solid/{name}.csv", "uy_m"))


CSM3_LIMITS = {9: (0.02, 0.01)}  # asked of amplitude and frequency; 5 and 17 are for the order of convergence


def csm3(quick: bool) -> Iterator[list[Row]]:
    """The float64 runs give the order; float32 stands beside them."""
    expected, freed = csm3_reference(), {mode: freed_of_time_step(f) for mode, f in csm3_modes().items()}
    runs = [(particles, dtype) for dtype in (np.float64, np.float32) for particles in (5, 9, 17)]
    errors: dict[int, dict[str, float]] = {}
    solutions: dict[int, Oscillation] = {}
    for particles, dtype in [(5, np.float32)] if quick else runs:
        scene = jaxsph.scenes.turek_hron_beam(particles, dtype=dtype)
        times, motion = tip_motion(scene, TIP, 10.0, SAVE_EVERY)
        found = oscillation(times, motion[:, 1])
        error = {
            name: abs(getattr(found, name) / getattr(expected, name) - 1)
            for name in ("amplitude", "fundamental", "frequency", "mean")
        }
        here = mode_frequencies(times, motion[:, 1])
        modes = {mode: abs(here[mode] / freed[mode] - 1) for mode in MODES}
        limits, where = CSM3_LIMITS.get(particles, (None, None)), (across(particles), precision(dtype))
        yield [
            Row("relative error, amplitude of uy, (max - min) / 2", error["amplitude"], limits[0], *where),
            Row("relative error, amplitude of the fundamental of uy", error["fundamental"], limits[0], *where),
            Row("relative error, frequency of uy", error["frequency"], limits[1], *where),
            Row("relative error, mean of uy, (max + min) / 2", error["mean"], None, *where),
            Row(RISE, rise(motion[:, 1]), None, *where),
            *(
                Row(f"relative error, {mode} mode, reference freed of its time step", off, None, *where)
                for mode, off in modes.items()
            ),
        ]
        if dtype is np.float64:
            errors[particles], solutions[particles] = error | modes, found
            if len(errors) == 3:
                yield [*order(errors, solutions), *between_references()]


def order(errors: dict[int, dict[str, float]], solutions: dict[int, Oscillation]) -> list[Row]:
    """Whether errors fall from 5 to 9 to 17 across, the larger of the two ratios; and whether the solutions settle.

    A change by a quarter of the one before is second order, by a half first.
    """
    rows = []
    figures = {
        name: f"error of the {name} / that of the next coarser" for name in ("amplitude", "fundamental", "frequency")
    }
    freed = {mode: f"the same, {mode} mode, reference freed of its time step" for mode in MODES}
    for name, figure in (figures | freed).items():
        five, nine, seventeen = (errors[particles][name] for particles in (5, 9, 17))
        limit = None if name in ("third", "fourth") else 1.0  # a tenth of a millimeter and less: shown as they are
        rows.append(Row(figure, max(nine / five, seventeen / nine), limit, "5, 9, 17 across", "float64"))
    for name in figures:
        five, nine, seventeen = (getattr(solutions[particles], name) for particles in (5, 9, 17))
        figure = f"change of the {name} from 9 to 17 / that from 5 to 9"
        rows.append(Row(figure, abs((seventeen - nine) / (nine - five)), 0.5, "5, 9, 17 across", "float64"))
    return rows


def gray_plate(quick: bool) -> Iterator[list[Row]]:
    """Gray's plate started in its first bending mode, small (1/500 of the length): period against finite elements."""
    name = "solid/cantilever_periods_fem.csv"
    runs = [("0.02", 5, np.float64), ("0.02", 10, np.float64), ("0.02", 10, np.float32), ("0.01", 10, np.float64)]
    for thickness, particles, dtype in runs[:1] if quick else runs:
        expected = number(name, "T1_fem_face_clamped_s", h_m=thickness)
        length = number(name, "L_m", h_m=thickness)
        scene = jaxsph.scenes.cantilever(
            length,
            float(thickness),
            particles,
            density=number(name, "rho", h_m=thickness),
            youngs_modulus=number(name, "E_Pa", h_m=thickness),
            poisson_ratio=number(name, "nu", h_m=thickness),
            dtype=dtype,
        )
        speed = length / 500 * 2 * np.pi / expected
        velocity = np.zeros(scene.systems[0].particles.positions.shape)
        velocity[:, 1] = speed * first_mode(np.asarray(scene.systems[0].particles.positions)[:, 0] / length)
        scene = scene.replace({"beam.velocity": velocity})
        times, motion = tip_motion(scene, (length, 0.0), 3.5 * expected, expected / 100)
        error = abs(1 / (oscillation(times, motion[:, 1]).frequency * expected) - 1)
        # the limit is that of 10 across
        figure = f"relative error, first period, h = {float(thickness):g} m"
        yield [Row(figure, error, 0.03 if particles >= 10 else None, across(particles), precision(dtype))]


def first_mode(x):
    """First mode of a clamped bar (Euler-Bernoulli) at x / length: 1 at the tip, 0 behind the root."""
    k, x = 1.8751040687, np.clip(x, 0.0, None)
    ratio = (np.cosh(k) + np.cos(k)) / (np.sinh(k) + np.sin(k))
    shape = lambda s: np.cosh(k * s) - np.cos(k * s) - ratio * (np.sinh(k * s) - np.sin(k * s))  # noqa: E731
    return shape(x) / shape(1.0)


CASES = [
    Case("S05", "Turek-Hron beam, CSM3 (free motion, 10 s)", csm3),
    Case("S06", "Gray's plate", gray_plate),
]
