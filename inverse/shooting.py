"""Multiple shooting: a record cut into windows that each start anew, for runs that forget where they came from.

Over a chaotic run the misfit has a valley as narrow as exp(-rate t), and a gradient, however exact, points nowhere.
H. G. Bock (1983), in Numerical Treatment of Inverse Problems in Differential and Integral Equations, 95: cut the record
into windows shorter than the tangents need to grow, make the state at the start of each an unknown of its own, and ask
that windows join, the gaps between them being residuals beside those of the data.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from inverse.observations import Observations
from inverse.problem import Problem
from inverse.transforms import linear

ROOM = 2.0  # how far the state at a start may be from its guess, in its scales
JOINED = 1e-2  # gaps, in scales, at which windows count as joined; tighter ones make the valley narrow again


def multiple_shooting(
    scene: Any,
    observe: Callable[[Any], Any],
    data: Observations,
    unknown: Mapping[str, Any],
    advance: Callable[[Any, Any, np.ndarray, str], tuple[Any, Any]],
    starts: Any,
    scale: Any = None,
    gap: float | None = JOINED,
    replace: Callable[[Any, dict[str, Any]], Any] | None = None,
) -> Problem:
    """A problem whose record is cut into W windows of the same length, to be fitted like any other.

    Its further unknowns are called "start": the states (W - 1, d) at the starts of all windows but the first. All
    windows are run side by side (`jax.vmap`). Gauss-Newton carries one tangent for each unknown: for a state of some
    numbers. Whoever has a large state, a fluid's, describes its starts by few numbers, or shortens the record.

    Args:
        scene, observe, data, unknown, replace: as of `Problem`. `observe` gets the run of one window.
        advance: (scene, state (d,), times, mode) -> (run, state at times[-1]), with times (T/W,) counted from the
            start of the window [s], pure and differentiable by JAX. The window starts at its time 0, where the last
            sample of the one before is.
        starts: (W, d) states at the starts of the windows, from measurements or from a run nearby. The first is known,
            the others are where the fit begins.
        scale: (d,) sizes of the state's numbers; half the range of `starts` by default.
        gap: standard deviation of the gaps between windows, in scales. Smaller ones join better and converge slower;
            None holds the starts as they are given and asks for no joining: for states that were measured.

    Raises:
        ValueError: samples that are not a multiple of W or not evenly spaced from the start; starts or scales of
            another shape, or without size; data without standard deviations where there are gaps.
    """
    starts = np.asarray(starts, dtype=float)
    if starts.ndim != 2 or len(starts) < 2:
        raise ValueError(f"starts have shape {starts.shape}; give (W, d), the state of each of two windows or more")
    windows, size = starts.shape
    if len(data) % windows:
        raise ValueError(
            f"{len(data)} samples are not a multiple of {windows} windows; leave out {len(data) % windows}"
        )
    length = len(data) // windows
    times = data.times[:length]
    expected = data.times[-1] / len(data) * np.arange(1, len(data) + 1)
    if np.max(np.abs(data.times - expected)) > 1e-6 * data.times[-1]:
        raise ValueError("samples are not evenly spaced from the start, the first one interval after it: resample them")
    scale = 0.5 * np.ptp(starts, axis=0) if scale is None else np.broadcast_to(np.asarray(scale, float), (size,))
    if not np.all(scale > 0):
        raise ValueError(f"scale={scale} must be > 0; give the size of each number of the state")
    if gap is not None and not gap > 0:
        raise ValueError(f"gap={gap} must be > 0, or None for starts that are known")
    if gap is not None and data.standard_deviations is None:
        raise ValueError(f"{data.source}: give standard deviations, against which gaps between windows are weighed")
    plain = replace or (lambda scene, values: scene.replace(values))

    def change(scene, values):
        later = values.get("start", starts[1:])
        return plain(scene, {name: value for name, value in values.items() if name != "start"}), _joined(
            starts[:1], later
        )

    def simulate(changed, _, mode):
        scene, states = changed

        def window(state):
            run, end = advance(scene, state, times, mode)
            return jnp.reshape(jnp.asarray(observe(run)), (length, -1)), end

        series, ends = jax.vmap(window)(states)
        series = series.reshape(len(data), -1)
        if gap is None:
            return series.reshape(data.values.shape)
        # At the last sample of each window but the last: a window of the fit that ends earlier does not see it.
        gaps = jnp.zeros((windows, length, size), series.dtype)
        gaps = gaps.at[:-1, -1].set((ends[:-1] - states[1:]) / jnp.asarray(scale))
        return jnp.concatenate([series, gaps.reshape(len(data), size)], axis=1)

    if gap is None:
        return Problem(scene, lambda series: series, data, unknown, simulate=simulate, replace=change)
    unknowns = {**unknown, "start": linear(starts[1:] - ROOM * scale, starts[1:] + ROOM * scale, start=starts[1:])}
    problem = Problem(
        scene, lambda series: series, _with_gaps(data, size, gap), unknowns, simulate=simulate, replace=change
    )
    problem.empty_rows = (len(data) - windows + 1) * size
    return problem


def _joined(first: np.ndarray, later: Any) -> jax.Array:
    later = jnp.asarray(later)
    return jnp.concatenate([jnp.asarray(first, later.dtype), later])


def _with_gaps(data: Observations, size: int, gap: float) -> Observations:
    """The data, and beside them the gaps that shall be zero."""
    values = data.values.reshape(len(data), -1)
    assert data.standard_deviations is not None, "checked before"
    return Observations(
        data.times,
        np.concatenate([values, np.zeros((len(data), size))], axis=1),
        np.concatenate([np.reshape(data.standard_deviations, values.shape), np.full((len(data), size), gap)], axis=1),
        (*data.columns, *(f"gap[{i}]" for i in range(size))),
        data.source,
    )
