"""How much of the record to fit next: continuation over a growing time window, chosen from the data.

Fitting a frequency by least squares has a local minimum for every period that the model may slip against the
data: a stiffness off by a factor 3 is sqrt(3) in frequency, and after a few periods the full sum of squares
points the wrong way. Early samples do not lie: over the first part of the record the phase error is still
small. One run with its Jacobian holds every window at once, so that looking for the longest trustworthy one
costs linear algebra only. Multiple shooting (Bock 1983) cures the same disease with more unknowns.
"""

from __future__ import annotations

import numpy as np

from inverse.trust_region import trust_region_step

EXPLAINED = 0.8  # the linear model must explain this much of the misfit for a window to be trusted, or ...
SMALL_MISFIT = 0.3  # ... leave a misfit below this fraction of the signal: .3 rad of phase is linear
SHRINK = 0.85  # ratio of successive candidate windows
PARTLY_EXPLAINED = 0.3  # if no window is trusted, the best explained one is taken, if it reaches this


def candidate_windows(samples: int, unknowns: int, width: int) -> list[int]:
    """Numbers of samples, longest first; the shortest still has four values per unknown, against noise."""
    fewest = min(samples, max(5, int(np.ceil(4 * unknowns / width))))
    ends, length = [], float(samples)
    while length > fewest:
        ends.append(int(np.ceil(length)))
        length *= SHRINK
    return list(dict.fromkeys([*ends, fewest]))


def longer_window(candidates: list[int], samples: int) -> int:
    """The candidate about half as long again as `samples`, and at least the next longer one."""
    longer = [c for c in candidates if c > samples]
    return next((c for c in longer if c <= 1.5 * samples), longer[-1])


def choose_window(
    evaluation,
    data: np.ndarray,
    width: int,
    candidates: list[int],
    shortest: int,
    lower: np.ndarray,
    upper: np.ndarray,
    radius: float,
    floor: float,
) -> tuple[int, np.ndarray]:
    """The longest window that the linearized model can be trusted over, and the step that it asks for.

    Args:
        evaluation: residual (T m,) and Jacobian (T m, n) at z.
        data: (T m,) observations over their standard deviations.
        candidates: numbers of samples, longest first.
        shortest: windows shorter than this have been fitted already.
        width: observed columns m.
        lower: (n,) bounds.
        upper: (n,) bounds.
        radius: as for `trust_region_step`.
        floor: as for `trust_region_step`.

    Returns:
        Number of samples, step (n,) in z.

    """
    signal = data.reshape(-1, width)
    best_fraction, best = PARTLY_EXPLAINED, None
    for samples in candidates:
        rows = samples * width
        residual, jacobian = evaluation.residual[:rows], evaluation.jacobian[:rows]
        step = trust_region_step(evaluation.z, residual, jacobian, lower, upper, radius, floor)
        before = float(residual @ residual)
        after = float(np.sum((residual + jacobian @ step) ** 2))
        part = signal[:samples]
        variation = float(np.sum((part - np.mean(part, axis=0)) ** 2))
        if after <= (1 - EXPLAINED) * before or after <= SMALL_MISFIT**2 * variation or samples <= shortest:
            return samples, step
        if 1 - after / before > best_fraction:
            best_fraction, best = 1 - after / before, (samples, step)
    if best is not None:
        return best
    # No window is explained: noise above the signal, or a model that can't follow. All of the data is then
    # best.
    step = trust_region_step(evaluation.z, evaluation.residual, evaluation.jacobian, lower, upper, radius, floor)
    return candidates[0], step
