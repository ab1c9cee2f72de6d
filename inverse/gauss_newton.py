"""Least squares by damped Gauss-Newton, with a Jacobian of tangents or of secants: the method for a few unknowns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from inverse.model import Evaluation, Model, RunFailed
from inverse.window import candidate_windows, choose_window, longer_window

STATISTICAL_TOLERANCE = 0.01  # steps below this fraction of the standard error change nothing
LEAST_GAIN = 1e-3  # actual over predicted reduction below which a step is refused
BETTER = 0.01  # by which part a run beside the end of a fit must be better for the fit to go on from there


def gauss_newton(
    model: Model,
    max_iterations: int,
    step_tolerance: float,
    record: Callable[..., None],
    evaluate: Callable[[np.ndarray], Evaluation] | None = None,
) -> tuple[Evaluation, bool, str]:
    """Minimize 0.5 sum r^2 over the bounds.

    Args:
        model: compiled residual and Jacobian.
        max_iterations: number of trial points.
        step_tolerance: largest entry of the step in z at which the fit has converged.
        record: called as record(evaluation, accepted, samples, note) after each trial.
        evaluate: residual and Jacobian at z; None takes tangents, `Model.evaluate`.

    Returns:
        The best evaluation, whether it converged, and a sentence that says why it stopped.

    """
    lower, upper = model.problem.bounds
    evaluate = evaluate or model.evaluate
    current = evaluate_start(model, evaluate)
    samples_all, unknowns = len(model.problem.data), len(current.z)
    candidates = candidate_windows(samples_all, unknowns, model.width)
    data = model.data / model.deviation
    largest_radius = np.sqrt(unknowns)  # a factor e in one logarithmic unknown
    radius, shortest, best = largest_radius, 0, current
    record(current, True, samples_all, "start")
    ended = ""
    for iteration in range(max_iterations):
        if ended:
            onward = better_beside(evaluate, current)
            if onward is None:
                return current, True, ended
            record(onward, True, samples_all, "a run beside the end was better")
            current = best = onward
            radius, shortest, ended = largest_radius, 0, ""
        floor = np.sqrt(model.precision)  # directions that the data see less of are rounding noise
        if iteration > max_iterations // 2:
            shortest = samples_all  # continuation had its chance
        samples, step = choose_window(current, data, model.width, candidates, shortest, lower, upper, radius, floor)
        rows = samples * model.width
        before = float(np.sum(current.residual[:rows] ** 2))
        after = float(np.sum((current.residual[:rows] + current.jacobian[:rows] @ step) ** 2))
        promised, length = before - after, float(np.max(np.abs(step), initial=0.0))
        noise = after / max(rows - unknowns, 1)
        if length <= step_tolerance or promised <= STATISTICAL_TOLERANCE**2 * noise:
            if samples < samples_all:  # this window is done: longer ones from here on
                shortest = longer_window(candidates, samples)
                radius = largest_radius
                continue
            if current.cost > best.cost * (1 + 1e-6):
                # continuation ended in a worse valley than one seen on the way
                current, shortest, radius = best, samples_all, largest_radius
                continue
            what = "step" if length <= step_tolerance else "step against its standard error"
            ended = f"converged: the next {what} is small ({length:.1e} internally)"
            continue
        try:
            trial = evaluate(np.clip(current.z + step, lower, upper))
        except RunFailed as failure:
            record(failed_evaluation(current.z + step), False, samples, str(failure))
            radius = 0.25 * float(np.linalg.norm(step))
            if radius < step_tolerance:
                return best, False, f"stopped: every step from here fails ({failure})"
            continue
        gain = (before - float(np.sum(trial.residual[:rows] ** 2))) / promised
        accepted = gain > LEAST_GAIN
        record(trial, accepted, samples, "")
        reach = float(np.linalg.norm(step))
        if gain < 0.25:
            radius = 0.25 * reach if gain < 0 else 0.5 * reach
        elif gain > 0.75:
            radius = min(max(radius, 2 * reach), largest_radius)
        if accepted:
            current = trial
            best = trial if trial.cost < best.cost else best
        elif length <= max(step_tolerance, np.sqrt(model.precision)) and samples == samples_all:
            # A minimum of a sum of squares can be located to the square root of its rounding error, not
            # better.
            current, ended = best, f"converged: rounding hides any gain within {length:.1e} internally"
    if ended:
        return current, True, ended
    return best, False, f"stopped after max_iterations = {max_iterations}; give it more, or a better start"


def better_beside(evaluate: Callable[[np.ndarray], Evaluation], found: Evaluation) -> Evaluation | None:
    """From where to go on: the best run that the secants at a fit's end were made of, if it is better than the end.

    A rough cost has many small valleys; runs a difference away see past the walls between them.
    """
    beside = found.beside
    if beside is None or beside.cost > (1 - BETTER) * found.cost:
        return None
    try:
        return evaluate(beside.z)
    except RunFailed:
        return None


def failed_evaluation(z: np.ndarray) -> Evaluation:
    """What the history records of a run that failed: an infinite cost."""
    return Evaluation(z, np.full(1, np.inf), np.empty((0, len(z))))


def evaluate_start(model: Model, evaluate: Callable[[np.ndarray], Evaluation]) -> Evaluation:
    """Evaluate at the starting values, or say why the simulator can't."""
    z = model.problem.start
    try:
        return evaluate(z)
    except RunFailed as failure:
        raise start_failed(model, z, failure) from failure


def start_failed(model: Model, z: np.ndarray, failure: RunFailed) -> RunFailed:
    values = ", ".join(
        f"{label} = {value:g}" for label, value in list(zip(model.labels, model.problem.vector(z), strict=True))[:5]
    )
    return RunFailed(
        f"the run at the starting values ({values}) failed: {model.explain(z, str(failure))}. "
        "Start where the simulator works, or narrow the bounds (they also set the time step)"
    )
