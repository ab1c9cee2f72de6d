"""The simulator that a Problem has by default: jaxsph, through its public names alone."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from inverse.transforms import Transform


class JaxsphSimulation:
    """The default `simulate`: jaxsph.simulate to the last observation time, seen at the observation times.

    The time step is the smallest stable one over the corners of the bounds, so that it never depends on a
    traced value: a fit does not change its own discretization while it moves.
    """

    def __init__(
        self,
        scene: Any,
        replace: Callable[[Any, dict[str, Any]], Any],
        unknown: Mapping[str, Transform],
        times: np.ndarray,
        time_step: float | None = None,
        save_every: float | None = None,
    ) -> None:
        if times[-1] <= 0:
            raise ValueError(
                f"the last observation is at {times[-1]:g} s, before anything can happen; "
                "give observations at later times"
            )
        if time_step is None:
            import jaxsph

            steps = [float(jaxsph.stable_time_step(replace(scene, corner))) for corner in corners(unknown)]
            time_step = min(steps)
        self.time_step = time_step
        self.save_every = common_interval(times) if save_every is None else save_every

    def __call__(self, scene: Any, times: np.ndarray, mode: str):
        import jaxsph

        intervals = max(1, int(np.ceil(times[-1] / self.save_every - 1e-9)))
        run = jaxsph.simulate(
            scene,
            t_end=intervals * self.save_every,
            save_every=self.save_every,
            time_step=self.time_step,
            mode=mode,
        )
        return run.at(times)


def corners(unknown: Mapping[str, Transform]) -> Iterator[dict[str, Any]]:
    """Dictionaries of values at the corners of the bounds (all entries of an array at the same end)."""
    if len(unknown) > 8:  # 2^n corners: beyond that, one unknown at a time off both ends
        ends = [(0,) * len(unknown), (1,) * len(unknown)]
        ends += [tuple(int(i == j) ^ base for i in range(len(unknown))) for j in range(len(unknown)) for base in (0, 1)]
    else:
        ends = list(itertools.product((0, 1), repeat=len(unknown)))
    for end in ends:
        yield {name: (t.upper if upper else t.lower)[()] for (name, t), upper in zip(unknown.items(), end, strict=True)}


def common_interval(times: np.ndarray) -> float:
    """The longest saving interval [s] that hits all times; without one, one short enough to interpolate.

    Times written with few digits count as hit within 1e-3 of an interval.
    """
    marks = np.concatenate([[0.0], times[times > 0]])
    if len(marks) < 2:
        return 1.0
    shortest = float(np.min(np.diff(marks)))
    for divisor in range(1, 11):
        interval = shortest / divisor
        # the last mark sets the interval: it averages out the rounding of a short difference
        count = np.round(marks[-1] / interval)
        interval = marks[-1] / count
        offset = marks / interval
        if np.max(np.abs(offset - np.round(offset))) < 1e-3:
            return float(interval)
    # cubic Hermite interpolation between saved states; at least 400 of them, at most 4,000
    return float(np.clip(shortest, marks[-1] / 4000, marks[-1] / 400))
