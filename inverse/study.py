"""What the accuracy of a fit costs: bias and spread of a parameter beside the time of the calibration."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from inverse.fit import fit
from inverse.problem import Problem
from inverse.report import Fit


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """A calibration at one resolution. Vectors (n,) follow `fit.labels`; errors are relative to the truth.

    Attributes:
        resolution: as given.
        fit: to the data as they are.
        bias: (value found - truth) / |truth|: what the model gets wrong.
        spread: standard deviation over the noise of the seeds; NaN with fewer than two.
        stated: the standard error that a fit of noisy data states, the mean over the seeds.
        noisy: (seeds, n) values found from noisy data.

    """

    resolution: float
    fit: Fit
    bias: np.ndarray
    spread: np.ndarray
    stated: np.ndarray
    noisy: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """(n,) root of the squares of bias and spread: how far a single calibration is off."""
        return np.sqrt(self.bias**2 + np.nan_to_num(self.spread) ** 2)

    @property
    def seconds(self) -> float:
        """Of the whole calibration, without compiling."""
        return self.fit.seconds - self.fit.compile_seconds

    def __str__(self) -> str:
        parts = [
            f"{label}: bias {100 * b:+.3g} %, spread {100 * s:.2g} %, stated {100 * e:.2g} %"
            for label, b, s, e in zip(self.fit.labels, self.bias, self.spread, self.stated, strict=True)
        ]
        return (
            f"resolution {self.resolution:g}: {'; '.join(parts)}; {self.fit.simulation_runs} runs, {self.seconds:.1f} s"
            f" (+ {self.fit.compile_seconds:.1f} s compiling)"
        )


def calibrations(
    problem_of: Callable[[float], Problem],
    resolutions: Sequence[float | int],
    truth: Sequence[float] | float,
    noise: float = 0.05,
    seeds: Iterable[int] = range(5),
    progress: bool = False,
) -> list[Calibration]:
    """Calibrate at some resolutions, and see how far off and how noisy the values are.

    At each resolution the data are fitted as they are, from the start of the problem: its time is that of the
    calibration. Then once per seed with noise added, from the value found: its own start would lead there too.

    Args:
        problem_of: resolution -> Problem.
        resolutions: in any order.
        truth: the values (n,), in the order of `problem.labels`.
        noise: standard deviation, relative to the root mean square of the data.
        seeds: of the noise; none for no noise.
        progress: print a line for each resolution.

    """
    true, out = np.atleast_1d(np.asarray(truth, float)), []
    for resolution in resolutions:
        problem = problem_of(resolution)
        found = fit(problem)
        level = noise * float(np.sqrt(np.mean(problem.data.values**2)))
        near = problem.started_at(found.vector)
        noisy = [fit(near.with_data(problem.data.with_noise(absolute=level, seed=seed))) for seed in seeds]
        values = np.array([one.vector for one in noisy]).reshape(len(noisy), len(true))
        stated = [list(one.standard_errors.values()) for one in noisy if one.uncertainty is not None]
        missing = np.full(len(true), np.nan)
        scale = np.abs(true)
        one = Calibration(
            resolution=float(resolution),
            fit=found,
            bias=(found.vector - true) / scale,
            spread=np.std(values, axis=0, ddof=1) / scale if len(noisy) > 1 else missing,
            stated=np.mean(stated, axis=0) / scale if stated else missing,
            noisy=values,
        )
        out.append(one)
        if progress:
            print(one, flush=True)
    return out
