"""A fine answer from coarse fits: fit coarse, extrapolate, correct and confirm on the fine model.

The series of a fine model differs from that of a coarse one, their derivatives hardly. So the coarse Jacobian turns
what is left of the misfit in a fine run into a step (space mapping: J. W. Bandler et al. (1994), IEEE Trans. Microw.
Theory Tech. 42, 2536). A fine run without derivatives costs a third of one with; a start that is extrapolated from
two coarse fits leaves little for it to correct.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import brentq

from inverse.fit import History, fit, result_of
from inverse.model import Evaluation, Model, RunFailed
from inverse.problem import Problem
from inverse.report import Fit
from inverse.uncertainty import estimate

SHRINK = 0.5  # of successive corrections; coarse derivatives that do worse are not those of the fine model


@dataclasses.dataclass(frozen=True, eq=False)
class CoarseToFine:
    """What `coarse_to_fine` found. Vectors (n,) follow `fit.labels`.

    Attributes:
        fit: of the finest resolution; its derivatives, and so its standard errors, are those of the one before it
            (or its own, if `corrected` is False).
        resolutions, fits: of all, from coarse to fine.
        order: of convergence, with which was extrapolated.
        predicted: values at the finest resolution, before it was run.
        extrapolated: values at infinite resolution, from the two finest.
        corrected: whether corrections with the coarse derivatives converged; else the fine model was fitted as usual.
        seconds: of everything.

    """

    fit: Fit
    resolutions: tuple[float, ...]
    fits: tuple[Fit, ...]
    order: float
    predicted: np.ndarray
    extrapolated: np.ndarray
    corrected: bool
    seconds: float

    def __getitem__(self, name: str):
        return self.fit[name]

    def saving(self, fine: Fit) -> str:
        """A sentence on the time, beside a fit of the finest model alone."""
        apart = np.max(np.abs(self.fit.vector / fine.vector - 1))
        return (
            f"{self.seconds:.1f} s instead of {fine.seconds:.1f} s ({fine.seconds / self.seconds:.1f} times as fast; "
            f"running alone {_running(self.fits):.1f} s instead of {fine.run_seconds:.1f} s), values {apart:.1e} apart"
        )

    def __str__(self) -> str:
        labels = self.fit.labels[:4]
        width = max(12, *(len(label) for label in labels))
        lines = [f"{'resolution':>10}  " + "  ".join(f"{label:>{width}}" for label in labels) + "   runs    time"]

        def row(name, vector, rest=""):
            return f"{name:>10}  " + "  ".join(f"{value:>{width}.6g}" for value in vector[:4]) + rest

        for resolution, one in zip(self.resolutions, self.fits, strict=True):
            if one is self.fit:
                lines.append(row("predicted", self.predicted))
            lines.append(row(f"{resolution:g}", one.vector, f"  {one.simulation_runs:5d}  {one.seconds:6.1f} s"))
        lines.append(row("infinite", self.extrapolated, f"   extrapolated with order {self.order:.2g}"))
        how = "corrected by coarse derivatives" if self.corrected else "coarse derivatives did not do: fitted as usual"
        lines.append(f"{self.fit.message}; {how}; {self.seconds:.1f} s in all")
        return "\n".join(lines + [f"! {message}" for message in self.fit.messages])

    __repr__ = __str__


def coarse_to_fine(
    problem_of: Callable[[float], Problem],
    resolutions: Sequence[float | int],
    order: float | int | None = None,
    tolerance: float = 1e-4,
    width: float = 0.2,
    max_corrections: int = 5,
    progress: bool = False,
) -> CoarseToFine:
    """The fit at the finest of some resolutions, for less than it costs.

    The coarsest is fitted from its start, the next ones from what was found, within bounds that are `width` around it.
    The finest is not fitted: its values are extrapolated, and corrected by plain runs until a correction is small.

    Args:
        problem_of: resolution -> Problem, with the same data and unknowns at each.
        resolutions: numbers that grow like 1 / spacing, at least two.
        order: of convergence in them; None takes that of three coarse fits, 1 with fewer.
        tolerance: largest correction in the internal coordinate (log: relative) at which the fine answer stands.
        width: of the bounds around a coarse value, see `Problem.narrowed`.
        max_corrections: before the finest model is fitted as usual, from where the corrections came to.
        progress: print a line for each run.

    Raises:
        ValueError: fewer than two resolutions, or not growing; problems that differ in data or unknowns.
        RunFailed: a coarse fit fails.

    """
    levels = tuple(float(r) for r in resolutions)
    if len(levels) < 2 or np.any(np.diff(levels) <= 0) or levels[0] <= 0:
        raise ValueError(f"resolutions = {tuple(resolutions)}: give two or more that grow, such as (4, 8, 16)")
    if order is not None and not order > 0:
        raise ValueError(f"order = {order} must be > 0")
    begin = time.perf_counter()
    fits: list[Fit] = []
    for resolution in resolutions[:-1]:
        problem = problem_of(resolution)
        if progress:
            print(f"resolution {resolution}", flush=True)
        if fits:
            _check_alike(fits[-1], problem)
        fits.append(_near(problem, fits[-1].vector, width, progress) if fits else fit(problem, progress=progress))
    given = order
    order = _order(levels[:-1], [one.vector for one in fits]) if given is None else given
    predicted = fits[-1].vector
    if len(fits) > 1:
        predicted = extrapolate(levels[-3:-1], fits[-2].vector, fits[-1].vector, order, levels[-1])
    problem = problem_of(resolutions[-1])
    _check_alike(fits[-1], problem)
    if progress:
        print(f"resolution {resolutions[-1]}, predicted", flush=True)
    found, corrected = _corrected(problem, predicted, width, fits[-1], tolerance, max_corrections, progress)
    fits.append(found)
    if given is None:
        order = _order(levels, [one.vector for one in fits])
    limit = extrapolate(levels[-2:], fits[-2].vector, fits[-1].vector, order, math.inf)
    seconds = time.perf_counter() - begin
    return CoarseToFine(found, levels, tuple(fits), order, predicted, limit, corrected, seconds)


def extrapolate(resolutions, coarse, fine, order: float, to: float) -> np.ndarray:
    """Values (n,) at a resolution, if they go as v + c resolution^-order through those at two."""
    a, b = (float(r) ** -order for r in resolutions)
    return fine + (fine - coarse) * (float(to) ** -order - b) / (b - a)


def _order(levels, vectors) -> float:
    """Of convergence from the last three, 1 if there are fewer, or if they do not go as a power."""
    if len(vectors) < 3:
        return 1.0
    n = levels[-3:]
    a, b, c = vectors[-3:]
    coarse, fine = np.linalg.norm(b / a - 1), np.linalg.norm(c / b - 1)
    share = lambda p: (n[1] ** -p - n[2] ** -p) / (n[0] ** -p - n[1] ** -p) * coarse - fine  # noqa: E731
    if share(0.2) * share(6.0) > 0:
        return 1.0
    return float(brentq(share, 0.2, 6.0))  # type: ignore[arg-type]


def _near(problem: Problem, vector: np.ndarray, width: float, progress: bool) -> Fit:
    """A fit from values that are known within a width; without it if they are not."""
    found = fit(problem.narrowed(vector, width), progress=progress)
    if found.uncertainty is not None and any(found.uncertainty.at_bound):
        return fit(problem.started_at(found.vector), progress=progress)
    return found


def _corrected(
    whole: Problem, predicted: np.ndarray, width: float, coarse: Fit, tolerance: float, most: int, progress: bool
) -> tuple[Fit, bool]:
    """The fine fit by plain runs and the coarse derivatives, and whether that converged."""
    begin = time.perf_counter()
    problem = whole.narrowed(predicted, width)
    model = Model(problem)
    history = History(model, progress)
    lower, upper = problem.bounds
    z, last, samples = problem.start, math.inf, len(problem.data)
    for _ in range(most):
        jacobian = coarse.sensitivity * problem.slopes(z) / model.deviation[:, None]
        try:
            best = Evaluation(z, model.residual(z), jacobian)
        except RunFailed:
            break
        history.record(best, True, samples, "correction")
        step = np.clip(z - np.linalg.lstsq(jacobian, best.residual, rcond=None)[0], lower, upper) - z
        length = float(np.max(np.abs(step)))
        if length <= tolerance:
            uncertainty = estimate(model, best)
            message = f"confirmed: the next correction is small ({length:.1e} internally)"
            seconds = time.perf_counter() - begin
            found = result_of(model, "coarse-to-fine", best, True, message, uncertainty, "", history.entries, seconds)
            return found, True
        if length > SHRINK * last or np.any((z + step <= lower) | (z + step >= upper)):
            break
        z, last = z + step, length
    found = _near(whole, problem.vector(z), width, progress)
    return dataclasses.replace(
        found, seconds=time.perf_counter() - begin, simulation_runs=found.simulation_runs + model.runs
    ), False


def _check_alike(before: Fit, problem: Problem) -> None:
    if tuple(problem.labels) != before.labels or problem.data.values.shape != before.observed.shape:
        raise ValueError(
            f"problem_of gives unknowns {tuple(problem.labels)} with data {problem.data.values.shape} at one "
            f"resolution, {before.labels} with {before.observed.shape} at another; both must be the same"
        )
    if before.sensitivity is None:
        raise ValueError("coarse_to_fine needs derivatives of the series: a problem with a few unknowns")


def _running(fits: Sequence[Fit]) -> float:
    return sum(one.run_seconds for one in fits)
