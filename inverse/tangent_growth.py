"""How far a gradient reaches: how fast tangents grow along a run, and from when on they say nothing."""

from __future__ import annotations

import dataclasses
import pathlib
from typing import Any

import numpy as np

from inverse.gradient_check import point_of
from inverse.model import Model
from inverse.problem import Problem
from inverse.report import figure_for

CHANGE = 0.1  # internal: of a logarithmic unknown 10 %, about what a fit that has nearly converged still moves
TOLERANCE = 0.2  # of the largest difference so far: a tangent that is 20 % off still points the right way
NEGLIGIBLE = (
    0.05  # sensitivity, in scales of the signal per z, below which an error does not count: rounding of float32
)
EXPONENTIAL = 3.0  # e-folds over the record, at least, before growth is called exponential


@dataclasses.dataclass(frozen=True, eq=False)
class TangentGrowth:
    """Sensitivity of the observed series to each unknown over time; T samples, m columns, n unknowns.

    All is in internal coordinates (log: relative changes; linear: quarters of the range).

    Attributes:
        times: (T,) [s].
        tangents: (T, m, n) derivative of the simulated series.
        scales: (m,) the signal's own size: half the range of each simulated column.
        differences: (T, m, n) central differences of the same, (series(z + step) - series(z - step)) / (2 step), or
            None where they were not asked for.
        step: of the differences.
    """

    labels: tuple[str, ...]
    times: np.ndarray
    tangents: np.ndarray
    scales: np.ndarray
    differences: np.ndarray | None
    step: float | None
    simulation_runs: int

    @property
    def growth(self) -> np.ndarray:
        """(T, n) largest |tangent| / scale over the columns, and over time so far."""
        relative = np.max(np.abs(self.tangents) / self.scales[None, :, None], axis=1)
        return np.maximum.accumulate(relative, axis=0)

    @property
    def rate(self) -> np.ndarray:
        """(n,) exponential growth rate [1/s], by least squares over the second half of the record.

        Also growth like a power t^p has one, about 1.4 p / T: compare with `exponential`.
        """
        return np.array([self._fitted(i)[0] for i in range(len(self.labels))])

    @property
    def exponential(self) -> np.ndarray:
        """(n,) whether tangents grow exponentially: a line through log |tangent| over time fits better than over log
        time, and the record holds `EXPONENTIAL` e-folds. A chaotic run; that of a vibration grows like t.
        """
        return np.array([self._fitted(i)[1] for i in range(len(self.labels))])

    def horizon(self, change: float = CHANGE) -> np.ndarray:
        """(n,) times [s] up to which a change of the unknown by this much moves the series, to first order, by less
        than the signal's own scale. Beyond it a linear model is extrapolated out of all that can happen.
        """
        if not change > 0:
            raise ValueError(f"change={change} must be > 0, in internal coordinates")
        return self._until(self.growth * change <= 1)

    def agrees_until(self, tolerance: float = TOLERANCE) -> np.ndarray:
        """(n,) times [s] up to which tangents are central differences, to a fraction of the largest difference so far.

        Raises:
            ValueError: no differences were asked for.
        """
        if self.differences is None:
            raise ValueError("no central differences; ask for them with tangent_growth(problem, difference_step=1e-2)")
        error = np.max(np.abs(self.tangents - self.differences) / self.scales[None, :, None], axis=1)
        size = np.max(np.abs(self.differences) / self.scales[None, :, None], axis=1)
        return self._until(error <= tolerance * np.maximum(np.maximum.accumulate(size, axis=0), NEGLIGIBLE))

    def _until(self, good: np.ndarray) -> np.ndarray:
        """(n,) the last time before the first sample that is not good (T, n); 0 if the first is not."""
        bad = np.where(np.all(good, axis=0), len(self.times), np.argmin(good, axis=0))
        return np.where(bad > 0, self.times[np.maximum(bad - 1, 0)], 0.0)

    def _fitted(self, i: int) -> tuple[float, bool]:
        growth = self.growth[:, i]
        later = (self.times > 0.5 * self.times[-1]) & (growth > 0)
        if np.sum(later) < 3:
            return 0.0, False
        rate = float(np.polyfit(self.times[later], np.log(growth[later]), 1)[0])
        seen = (self.times > 0) & (growth > 0)
        logs = np.log(growth[seen])
        left = [np.polyfit(x, logs, 1, full=True)[1] for x in (self.times[seen], np.log(self.times[seen]))]
        straight, power = (float(each[0]) if len(each) else 0.0 for each in left)
        return rate, bool(straight < power and rate * self.times[-1] > EXPONENTIAL)

    def __str__(self) -> str:
        width = max(len("unknown"), *(len(label) for label in self.labels))
        head = f"{'unknown':<{width}}  {'growth':>22}  {f'horizon of {CHANGE:g}':>14}"
        rate, exponential, horizon = self.rate, self.exponential, self.horizon()
        agrees = None if self.differences is None else self.agrees_until()
        head += "" if agrees is None else f"  {f'as differences of {self.step:g}':>24}"
        lines = [head]
        for i, label in enumerate(self.labels):
            kind = f"exp({rate[i]:.3g} t)" if exponential[i] else "slower than exp"
            line = f"{label:<{width}}  {kind:>22}  {horizon[i]:12.4g} s"
            line += "" if agrees is None else f"  {'until':>14} {agrees[i]:7.4g} s"
            lines.append(line)
        end = self.times[-1]
        if np.any(horizon < end) or (agrees is not None and np.any(agrees < end)):
            soonest = min(float(np.min(horizon)), *([] if agrees is None else [float(np.min(agrees))]), end)
            lines.append(
                f'! the record has {end:g} s, its gradient can be trusted for {soonest:g} s: fit with method="secant", '
                "or a window up to there, or several shorter ones with inverse.multiple_shooting"
            )
        return "\n".join(lines)

    __repr__ = __str__

    def plot(self, path: Any) -> pathlib.Path:
        """Draw the growth of the tangents, and of the differences, over time; the format follows the suffix."""
        path = pathlib.Path(path)
        figure = figure_for(path, (7, 4))
        axes = figure.subplots()
        for i, label in enumerate(self.labels):
            sizes = [(self.tangents, "-", "tangent")]
            if self.differences is not None:
                sizes.append((self.differences, ".", f"difference of {self.step:g}"))
            for series, style, name in sizes:
                size = np.max(np.abs(series[:, :, i]) / self.scales, axis=1)
                axes.semilogy(self.times, np.maximum(size, 1e-300), style, color=f"C{i}", label=f"{label}: {name}")
            axes.axvline(self.horizon()[i], color=f"C{i}", linestyle="--", linewidth=0.8)
        axes.axhline(1 / CHANGE, color="0.5", linewidth=0.8)
        biggest = float(np.max(self.growth))
        axes.set(
            xlabel="time [s]", ylabel="|d series / d z| / scale", ylim=(1e-6 * biggest, 3 * max(biggest, 1 / CHANGE))
        )
        axes.legend(fontsize=8)
        path = pathlib.Path(path)
        figure.savefig(path, dpi=150)
        return path


def tangent_growth(
    problem: Problem, at: dict[str, Any] | None = None, difference_step: float | None = None
) -> TangentGrowth:
    """Measure how tangents grow along the run of a problem, by one run in forward mode.

    Args:
        problem: what will be fitted.
        at: {name: value} where; the starting values by default.
        difference_step: compare with central differences of this step in internal coordinates, by two runs per
            unknown. Large ones, 1e-2, tell what a fit sees; small ones whether the derivative is right.

    Raises:
        ValueError: a step that is not positive, or values out of their bounds.
        RunFailed: the simulator fails there.
    """
    if difference_step is not None and not difference_step > 0:
        raise ValueError(f"difference_step={difference_step} must be > 0, in internal coordinates")
    z, model = point_of(problem, at or {}, 0.0 if difference_step is None else difference_step), Model(problem)
    evaluation = model.evaluate(z)
    shape = (len(problem.data), model.width)
    deviation = model.deviation[:, None]
    tangents = (evaluation.jacobian * deviation).reshape(*shape, len(z))
    series = (evaluation.residual * model.deviation + model.data).reshape(shape)
    scales = 0.5 * np.ptp(series, axis=0)
    scales = np.where(scales > 0, scales, np.maximum(np.max(np.abs(series), axis=0), np.finfo(float).tiny))
    differences = None
    if difference_step is not None:
        columns = []
        for direction in np.eye(len(z)):
            ahead, behind = (model.residual(z + sign * difference_step * direction) for sign in (1, -1))
            columns.append((ahead - behind) * model.deviation / (2 * difference_step))
        differences = np.stack(columns, axis=1).reshape(*shape, len(z))
    return TangentGrowth(
        tuple(model.labels), problem.data.times, tangents, scales, differences, difference_step, model.runs
    )
