"""The last steps on a rough cost: runs on either side of the best one, first far and evenly, then closer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from inverse.gauss_newton import BETTER
from inverse.model import Evaluation, Model, RunFailed

EACH_SIDE = 5  # runs of the first look


def scan(model: Model, found: Evaluation, reach: float, smallest: float, record: Callable[..., None]) -> Evaluation:
    """The best of the runs along each unknown: five on either side of an end, then one, closer and closer.

    Where splashes make valleys, the slopes of the trend end at the rim of one of them. Runs at finite distances see
    over the walls between. With many unknowns it is a search along the axes, not of a volume.

    Args:
        model: compiled residual.
        found: where to look around.
        reach: how far the first runs go, in internal coordinates.
        smallest: last distance.
        record: called as record(evaluation, accepted, samples, note) for the best run of each look.

    Returns:
        The best evaluation, `found` itself or one without a Jacobian.
    """
    lower, upper = model.problem.bounds
    none = np.empty((0, len(found.z)))

    def look(best: Evaluation, ways: list[np.ndarray]) -> Evaluation:
        tried = []
        for z in (best.z + way for way in ways):
            if np.all((z >= lower) & (z <= upper)):
                try:
                    tried.append(Evaluation(z, model.residual(z), none))
                except RunFailed:
                    continue  # one of many places, and not a better one
        nearest = min(tried, key=lambda one: one.cost, default=None)
        if nearest is None:
            return best
        better = nearest.cost < (1 - BETTER) * best.cost
        note = f"best of {len(tried)} beside" + ("" if better else ": not better")
        record(nearest, better, len(model.problem.data), note)
        return nearest if better else best

    step, best, axes = reach / EACH_SIDE, found, np.eye(len(found.z))
    for axis in axes:
        best = look(best, [k * step * axis for k in range(-EACH_SIDE, EACH_SIDE + 1) if k != 0])
    while step > smallest * (1 + 1e-9):
        step = max(0.5 * step, smallest)
        for axis in axes:
            best = look(best, [-step * axis, step * axis])
    return best
