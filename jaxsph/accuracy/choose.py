"""The settings to take: the cheapest that are accurate enough, the most accurate that are cheap enough."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxsph.accuracy.results import COSTS, Number, Results, Row, Value

if TYPE_CHECKING:
    from jaxsph.accuracy.study import Study


@dataclass(frozen=True)
class Choice:
    """Settings to take, and why.

    Attributes:
        settings: {name: value}.
        error: the largest of this run and of all finer ones, as in `Results.reliable`.
        row: of the run.
    """

    settings: dict[str, Value]
    error: float
    row: Row

    def __str__(self) -> str:
        about = ", ".join(f"{name} {value}" for name, value in self.settings.items() if value is not None)
        return f"{about}: error {self.error:.3g} in {self.row.seconds:.3g} s, {self.row.steps} steps"


def cheapest(study: Study | Results, tolerance: Number, *, error: str | None = None, cost: str = "seconds") -> Choice:
    """The settings of least cost whose error is at most `tolerance`, and that of all finer runs too.

    Args:
        study: or its results.
        tolerance: of the error.
        error: which one; None is the first.
        cost: "seconds", "steps", "particle_steps" or "memory".

    Raises ValueError if no run is accurate enough, naming the best one.
    """
    results, errors, costs = _looked_up(study, error, cost)
    if not tolerance > 0:
        raise ValueError(f"tolerance = {tolerance} must be positive")
    holds = np.flatnonzero((errors <= tolerance) & np.isfinite(costs))
    if not len(holds):
        index = int(np.nanargmin(errors))
        raise ValueError(
            f"no run has an error of {tolerance:.3g} or less; the best is {errors[index]:.3g} with "
            f"{results.rows[index].settings}: refine, or ask accuracy.recommend, which extrapolates"
        )
    return _choice(results, errors, holds[np.lexsort((errors[holds], costs[holds]))[0]])


def best(study: Study | Results, seconds: Number, *, error: str | None = None, cost: str = "seconds") -> Choice:
    """The settings of least error whose run takes at most `seconds`.

    Args:
        study: or its results.
        seconds: that there are; of another cost, its number.
        error: which one; None is the first.
        cost: "seconds", "steps", "particle_steps" or "memory".

    Raises ValueError if no run is that cheap, naming the cheapest.
    """
    results, errors, costs = _looked_up(study, error, cost)
    holds = np.flatnonzero((costs <= seconds) & np.isfinite(errors))
    if not len(holds):
        index = int(np.nanargmin(np.where(np.isfinite(errors), costs, np.nan)))
        raise ValueError(
            f"no run has {cost} of {seconds:.3g} or less; the cheapest has {costs[index]:.3g} with "
            f"{results.rows[index].settings}: run coarser ones"
        )
    return _choice(results, errors, holds[np.lexsort((costs[holds], errors[holds]))[0]])


def _looked_up(study, error, cost):
    results = study if isinstance(study, Results) else study.results
    if cost not in COSTS:
        raise ValueError(f"cost {cost!r} must be one of {', '.join(COSTS)}")
    if not len(results):
        raise ValueError("the study has no runs yet: call its run() first")
    errors = results.reliable(error)
    if not np.any(np.isfinite(errors)):
        raise ValueError(f"no run of the study has an error: {results.rows[0].failure or 'it has no reference'}")
    return results, errors, np.array(results[cost], float)


def _choice(results, errors, index) -> Choice:
    row = results.rows[int(index)]
    assert math.isfinite(errors[index])
    return Choice(dict(row.settings), float(errors[index]), row)
