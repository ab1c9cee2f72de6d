"""fit: the values of the unknowns that make the simulation match the measurement, and how sure they are."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

import numpy as np

from inverse.descent import adam, l_bfgs_b
from inverse.gauss_newton import gauss_newton
from inverse.model import Evaluation, Model, RunFailed
from inverse.problem import Problem
from inverse.report import Fit
from inverse.scan import scan
from inverse.uncertainty import Uncertainty, estimate

METHODS = ("gauss-newton", "secant", "l-bfgs-b", "adam")
DIFFERENCE = 0.2  # half the distance of the runs of a secant, in internal coordinates
JACOBIAN_LIMIT = 64  # unknowns up to which a reverse-mode fit still pays for one forward-mode Jacobian
POOR_FIT = 0.5  # misfit as a fraction of the signal from which a fit is called poor


def fit(
    problem: Problem,
    method: str = "gauss-newton",
    max_iterations: int | None = None,
    step_tolerance: float | None = None,
    cost_tolerance: float | None = None,
    learning_rate: float | None = None,
    windows: Sequence[float] | None = None,
    difference: float | None = None,
    progress: bool = False,
) -> Fit:
    """Minimize 0.5 sum(((model - data) / standard deviation)^2) over the bounds of the unknowns.

    Args:
        problem: data, unknowns, simulator.
        method: "gauss-newton" (few unknowns: forward-mode Jacobian, time window chosen from the data),
            "secant" (the same with slopes over a finite difference, 1 + 2 n runs each, and at the end the best of some
            12 n runs around: for violent runs, whose derivatives follow every splash and not the
            trend; `tangent_growth` tells),
            "l-bfgs-b" or "adam" (many unknowns: reverse-mode gradient).
        max_iterations: trial points; 40 for gauss-newton and secant, 200 per window for l-bfgs-b, 500 in all for adam.
        step_tolerance: gauss-newton, secant, adam: converged when no unknown moves more than this in its
            internal coordinate (log: relative change; linear: change in quarters of the range); 1e-5 by default,
            for secants a twentieth of the difference, which is also the last distance of the runs around.
        cost_tolerance: l-bfgs-b: converged when the cost falls by less than this fraction; 1e-10 by default.
        learning_rate: adam: first step in internal coordinates; 0.05 by default.
        windows: l-bfgs-b, adam: fractions of the record to fit one after the other, growing up to 1 (helps
            against local minima of oscillating data); (1.0,) by default. gauss-newton and secant choose their own.
        difference: secant: how far on either side the slope is taken, in internal coordinates; 0.2 by default.
        progress: print one line per run.

    Returns:
        Fit: values, standard errors, verdict, residuals, history, runs and seconds.

    Raises:
        ValueError: an unknown method, or an option that the method does not have.
        RunFailed: the simulator fails at the starting values; the reason is given.

    """
    if method not in METHODS:
        raise ValueError(f"method={method!r}; choose one of {', '.join(METHODS)}")
    _check_options(
        method,
        step_tolerance=step_tolerance,
        cost_tolerance=cost_tolerance,
        learning_rate=learning_rate,
        difference=difference,
        windows=windows,
    )
    if max_iterations is not None and max_iterations < 1:
        raise ValueError(f"max_iterations={max_iterations} must be at least 1")
    stages = _checked_windows((1.0,) if windows is None else windows)
    begin = time.perf_counter()
    model = Model(problem)
    history = History(model, progress)
    small = 1e-5 if step_tolerance is None else step_tolerance
    if method == "gauss-newton":
        best, converged, message = gauss_newton(model, max_iterations or 40, small, history.record)
    elif method == "secant":
        wide = DIFFERENCE if difference is None else difference
        small = 0.05 * wide if step_tolerance is None else step_tolerance
        evaluate = partial(model.secants, difference=wide)
        trend, converged, message = gauss_newton(model, max_iterations or 40, small, history.record, evaluate)
        best = scan(model, trend, wide / 2, small, history.record) if converged else trend
        if best is not trend:
            best = _with_slopes(evaluate, best, trend)
    elif method == "l-bfgs-b":
        tolerance = 1e-10 if cost_tolerance is None else cost_tolerance
        best, converged, message = l_bfgs_b(model, max_iterations or 200, tolerance, stages, history.record)
    else:
        rate = 0.05 if learning_rate is None else learning_rate
        best, converged, message = adam(model, max_iterations or 500, small, rate, stages, history.record)
    if progress:
        print(message)
    best, uncertainty, reason = _uncertainty(model, best)
    return result_of(
        model,
        method,
        best,
        converged,
        message,
        uncertainty,
        reason,
        history.entries,
        time.perf_counter() - begin,
    )


def _with_slopes(evaluate, best: Evaluation, trend: Evaluation) -> Evaluation:
    """The best run with secants around it, or those of the trend nearby where such a run fails."""
    try:
        return evaluate(best.z)
    except RunFailed:
        return Evaluation(best.z, best.residual, trend.jacobian)


class History:
    """One entry per trial, printed as it happens."""

    def __init__(self, model: Model, progress: bool) -> None:
        self.entries: list[dict] = []
        self._model, self._progress = model, progress
        self._begin = time.perf_counter()

    def record(self, evaluation: Evaluation, accepted: bool, samples: int, note: str) -> None:
        data = self._model.problem.data
        values = self._model.problem.vector(np.asarray(evaluation.z))
        self.entries.append(
            {
                "run": self._model.runs,
                "cost": evaluation.cost,
                "values": values.tolist(),
                "accepted": bool(accepted),
                "window": float(data.times[samples - 1]),
                "samples": int(samples),
                "note": note,
                "seconds": time.perf_counter() - self._begin,
            }
        )
        if self._progress:
            shown = ", ".join(
                f"{label} = {value:.6g}" for label, value in list(zip(self._model.labels, values, strict=True))[:4]
            )
            more = f", ... ({len(values)} unknowns)" if len(values) > 4 else ""
            fate = "accepted" if accepted else "refused"
            print(
                f"run {self._model.runs:3d}  cost {evaluation.cost:.4e}  {shown}{more}  "
                f"fitted up to {data.times[samples - 1]:.4g} s  {note or fate}  "
                f"{self.entries[-1]['seconds']:.1f} s",
                flush=True,
            )


def _uncertainty(model: Model, best: Evaluation) -> tuple[Evaluation, Uncertainty | None, str]:
    if best.jacobian.shape[0] == 0:
        count = best.jacobian.shape[1]
        if count > JACOBIAN_LIMIT:
            return (
                best,
                None,
                (
                    f"no standard errors: a Jacobian of {count} unknowns would take {count} forward-mode "
                    f"tangents (limit {JACOBIAN_LIMIT})"
                ),
            )
        try:
            best = model.evaluate(best.z)
        except RunFailed as failure:
            return best, None, f"no standard errors: the Jacobian at the optimum failed ({failure})"
    return best, estimate(model, best), ""


def result_of(
    model: Model,
    method: str,
    best: Evaluation,
    converged: bool,
    message: str,
    uncertainty: Uncertainty | None,
    reason: str,
    history: list[dict],
    seconds: float,
) -> Fit:
    """The Fit that says what a method found: `best`, and how it got there."""
    problem, data = model.problem, model.problem.data
    messages = list(uncertainty.messages) if uncertainty is not None else [reason]
    signal = data.values - np.mean(data.values, axis=0)
    misfit = (best.residual * model.deviation).reshape(data.values.shape)
    sensitivity = None
    if best.jacobian.shape[0]:
        sensitivity = best.jacobian * model.deviation[:, None] / problem.slopes(best.z)
    if np.sum(misfit**2) > POOR_FIT**2 * np.sum(signal**2) > 0:
        messages.append(
            f"poor fit: the misfit is {np.sqrt(np.sum(misfit**2) / np.sum(signal**2)):.2g} times the "
            "signal (rms); the model can't follow the data, or this is a local minimum: start elsewhere"
        )
    return Fit(
        method=method,
        labels=tuple(model.labels),
        units=tuple(problem.units),
        values={name: value[()] for name, value in problem.values(best.z).items()},
        vector=problem.vector(best.z),
        start=problem.vector(problem.start),
        bounds=(problem.vector(problem.bounds[0]), problem.vector(problem.bounds[1])),
        uncertainty=uncertainty,
        converged=converged,
        message=message,
        messages=tuple(messages),
        cost=best.cost,
        times=data.times,
        columns=data.columns,
        observed=data.values,
        simulated=data.values + misfit,
        standard_deviations=data.standard_deviations,
        residuals=best.residual.reshape(data.values.shape),
        sensitivity=sensitivity,
        history=history,
        simulation_runs=model.runs,
        tangent_runs=model.tangents,
        adjoint_runs=model.adjoints,
        seconds=seconds,
        compile_seconds=model.compile_seconds,
        run_seconds=model.run_seconds,
    )


def _check_options(method: str, **options) -> None:
    takes = {
        "gauss-newton": {"step_tolerance"},
        "secant": {"step_tolerance", "difference"},
        "l-bfgs-b": {"cost_tolerance", "windows"},
        "adam": {"step_tolerance", "learning_rate", "windows"},
    }
    for name, value in options.items():
        if value is None:
            continue
        if name not in takes[method]:
            users = ", ".join(other for other in METHODS if name in takes[other])
            raise ValueError(f"{name}={value} has no meaning for method={method!r}; it belongs to {users}")
        if name != "windows" and not value > 0:
            raise ValueError(f"{name}={value} must be > 0")


def _checked_windows(windows: Sequence[float]) -> tuple[float, ...]:
    stages = tuple(float(w) for w in windows)
    if not stages or stages[-1] != 1.0 or stages[0] <= 0 or np.any(np.diff(stages) <= 0):
        raise ValueError(
            f"windows={windows}: give growing fractions of the record that end with 1.0, such as (0.2, 0.5, 1.0)"
        )
    return stages
