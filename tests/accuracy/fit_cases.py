"""Calibrations: Young's modulus of the Turek-Hron beam and a viscosity, over resolutions, and from coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import calibrate_beam as beam  # pyright: ignore[reportMissingImports]
import calibrate_viscosity as flow  # pyright: ignore[reportMissingImports]
import numpy as np
from cases import Case

import inverse
import jaxsph
from jaxsph.accuracy import Results, Row

NOISE, SEEDS = 0.05, range(5)
LABELS = {
    "bias": "|relative bias of the value|",
    "spread": "relative spread with 5 % noise",
    "error": "relative error: bias and spread",
}


def beam_problem(resolution: float) -> inverse.Problem:
    """Of examples/calibrate_beam.py: from a factor 3 off; the resolution is thickness over spacing."""
    data = inverse.Observations.from_csv(beam.DATA, time="t_s", columns=["ux_m", "uy_m"], window=(0.01, 0.9), every=2)
    return inverse.Problem(
        jaxsph.scenes.turek_hron_beam(round(resolution) + 1, dtype=np.float32),
        observe=lambda run: run.probe("beam", at=beam.TIP).displacement,
        data=data,
        unknown={"beam.youngs_modulus": inverse.log(2e5, 6e6, start=3 * beam.TRUE_MODULUS, unit="Pa")},
    )


def channel_problem(resolution: float) -> inverse.Problem:
    """Of examples/calibrate_viscosity.py: a Poiseuille flow from rest, exact profiles, from a factor 2 off."""
    case = flow.channel(round(resolution), dtype=np.float32)
    data = inverse.Observations(case.times, case.series(), columns=flow.names(case))
    true = case.viscosity
    unknown = {flow.NAME: inverse.log(true / 3, true * 3, start=2 * true, unit="Pa s")}
    every = float(case.times[1] - case.times[0])
    return inverse.Problem(case.scene, case.observe, data, unknown, save_every=every)


def calibrated(
    title: str,
    problem_of: Callable[[float], inverse.Problem],
    truth: float,
    resolutions: Sequence[int],
    levels: Sequence[int],
    across: Callable[[float], int],
    order: float | None,
) -> Results:
    """Bias and spread over resolutions, and the finest answer from coarse ones (levels) beside the fit at the finest.

    At the finest level the data are fitted as they are only: it is what the others are measured by.
    """
    rows = []
    found = inverse.calibrations(problem_of, [r for r in resolutions if r != levels[-1]], truth, NOISE, SEEDS, True)
    found += inverse.calibrations(problem_of, levels[-1:], truth, NOISE, (), True)
    for one in found:
        spread = float(one.spread[0])
        rows.append(_row(one.fit, one.seconds, across(one.resolution), "fit", float(one.bias[0]), spread))
    fine = found[-1].fit
    quick = inverse.coarse_to_fine(problem_of, levels, order=order, tolerance=1e-4, progress=True)
    print(f"\n{quick}\n{quick.saving(fine)}\n", flush=True)
    compiled = sum(one.compile_seconds for one in quick.fits)
    values = (("coarse to fine", quick.fit.vector[0]), ("coarse to fine, extrapolated", quick.extrapolated[0]))
    for method, value in values:
        row = _row(quick.fit, quick.seconds - compiled, across(levels[-1]), method, float(value) / truth - 1, math.nan)
        rows.append(Row(row.settings, row.errors, row.seconds, compiled))
    return Results(tuple(rows), "particles", title)


def _row(fit, seconds, particles, method, bias, spread) -> Row:
    error = math.hypot(bias, 0.0 if math.isnan(spread) else spread)
    errors = {"bias": abs(bias), "spread": spread, "error": error}
    return Row({"particles": particles, "code": "jaxsph", "method": method}, errors, seconds, fit.compile_seconds)


def youngs_modulus(quick: bool) -> Results:
    resolutions, levels = ((2, 4), (2, 4)) if quick else ((2, 4, 6, 8), (2, 4, 8))
    title = "Young's modulus of the beam from its tip"
    return calibrated(title, beam_problem, beam.TRUE_MODULUS, resolutions, levels, lambda r: round(r) + 1, None)


def viscosity(quick: bool) -> Results:
    resolutions, levels = ((8, 10), (8, 10)) if quick else ((10, 14, 20, 28), (10, 14, 28))
    title = "Viscosity from the start of a Poiseuille flow"
    return calibrated(title, channel_problem, 1e-3, resolutions, levels, round, 2.0)


CASES = [
    Case("fit_youngs_modulus", "Calibration of E", LABELS, youngs_modulus, (0.02, 0.01)),
    Case("fit_viscosity", "Calibration of a viscosity", LABELS, viscosity, (0.02, 0.01)),
]
