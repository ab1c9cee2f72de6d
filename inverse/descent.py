"""Least squares by reverse-mode gradients: L-BFGS-B and Adam, the methods for many unknowns."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.optimize

from inverse.gauss_newton import failed_evaluation, start_failed
from inverse.model import Evaluation, Model, RunFailed

# cost reported for a failed run, in units of the starting cost: finite, so that a line search backs off
REFUSED = 1e3


class Objective:
    """Cost and gradient over the first `samples` of the record, remembering the best point seen."""

    def __init__(self, model: Model, record: Callable[..., None]) -> None:
        self.model, self._record = model, record
        self.best: Evaluation | None = None
        self._best_cost = np.inf
        self._first_cost = np.nan

    def begin_window(self, fraction: float) -> None:
        self.samples = max(1, int(np.ceil(fraction * len(self.model.problem.data))))
        # Later samples are switched off by weights: the compiled gradient stays the same.
        self._weights = (np.arange(len(self.model.data)) < self.samples * self.model.width).astype(float)
        self._best_cost = np.inf

    def __call__(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost and gradient at z; raises RunFailed."""
        cost, gradient, residual = self.model.cost_and_gradient(z, self._weights)
        better = cost < self._best_cost
        evaluation = Evaluation(np.array(z), residual, np.empty((0, len(z))))
        if better:
            self.best, self._best_cost = evaluation, cost
        self._record(evaluation, better, self.samples, "")
        return cost, gradient

    def start(self, z: np.ndarray) -> None:
        """Evaluate the starting values, or say why the simulator can't."""
        try:
            self._first_cost, _ = self(z)
        except RunFailed as failure:
            raise start_failed(self.model, z, failure) from failure

    def guarded(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost and gradient; a failed run counts as a very bad one."""
        try:
            return self(z)
        except RunFailed as failure:
            self._record(failed_evaluation(z), False, self.samples, str(failure))
            return REFUSED * max(self._first_cost, 1.0), np.zeros_like(z)


def l_bfgs_b(
    model: Model,
    max_iterations: int,
    cost_tolerance: float,
    windows: Sequence[float],
    record: Callable[..., None],
) -> tuple[Evaluation, bool, str]:
    """SciPy's L-BFGS-B (Byrd et al. 1995, doi:10.1137/0916069), one pass per window."""
    objective, z = Objective(model, record), model.problem.start
    lower, upper = model.problem.bounds
    result = None
    for fraction in windows:
        objective.begin_window(fraction)
        if result is None:
            objective.start(z)
        result = scipy.optimize.minimize(
            _without_repeats(objective.guarded),
            z,
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(lower, upper, strict=True)),
            # gtol is absolute and says nothing about an unscaled sum of squares: the relative one decides
            options={"maxiter": max_iterations, "ftol": cost_tolerance, "gtol": 1e-12, "maxcor": 20},
        )
        z = np.asarray(result.x) if objective.best is None else objective.best.z
    assert result is not None and objective.best is not None
    stopped = result.nit >= max_iterations
    message = f"stopped after max_iterations = {max_iterations}" if stopped else f"L-BFGS-B: {result.message}"
    return objective.best, bool(result.success) and not stopped, message


def adam(
    model: Model,
    max_iterations: int,
    step_tolerance: float,
    learning_rate: float,
    windows: Sequence[float],
    record: Callable[..., None],
) -> tuple[Evaluation, bool, str]:
    """Adam (Kingma & Ba 2015, arXiv:1412.6980) projected on the bounds, its rate decaying along a cosine.

    After a failed run the iterate goes back to the best point and the rate is halved.
    """
    objective, z = Objective(model, record), model.problem.start
    lower, upper = model.problem.bounds
    per_window = max(1, max_iterations // len(windows))
    undecayed, started = np.inf, False
    for fraction in windows:
        objective.begin_window(fraction)
        if not started:
            objective.start(z)
            started = True
        first, second, factor = np.zeros_like(z), np.zeros_like(z), 1.0
        for iteration in range(1, per_window + 1):
            try:
                _, gradient = objective(z)
            except RunFailed as failure:
                record(failed_evaluation(z), False, objective.samples, str(failure))
                factor *= 0.5
                assert objective.best is not None
                z, first = objective.best.z, np.zeros_like(z)
                continue
            first = 0.9 * first + 0.1 * gradient
            second = 0.999 * second + 0.001 * gradient**2
            rate = factor * learning_rate * 0.5 * (1 + np.cos(np.pi * (iteration - 1) / per_window))
            size = np.sqrt(second / (1 - 0.999**iteration))
            step = -rate * (first / (1 - 0.9**iteration)) / np.where(size > 0, size, 1.0)
            moved = np.clip(z + step, lower, upper)
            # what the step would be at the full rate: the decayed one is small at the end wherever it stands
            undecayed = float(np.max(np.abs(np.clip(z + step * learning_rate / rate, lower, upper) - z)))
            z = moved
            if undecayed <= step_tolerance:
                break
    assert objective.best is not None
    converged = undecayed <= step_tolerance
    message = (
        f"converged: the last step is small ({undecayed:.1e} in internal coordinates)"
        if converged
        else f"stopped after {model.runs} runs, the last step {undecayed:.1e} internally at the full learning rate; "
        "give it more iterations or another learning rate"
    )
    return objective.best, converged, message


def _without_repeats(function):
    """SciPy asks again for the point where a window began: don't simulate twice."""
    last: dict[bytes, tuple[float, np.ndarray]] = {}

    def call(z: np.ndarray) -> tuple[float, np.ndarray]:
        key = z.tobytes()
        if key not in last:
            last.clear()
            last[key] = function(z)
        return last[key]

    return call
