"""Can the data tell the unknowns at all? Directions of the Jacobian that they leave undetermined.

Collinearity is read off the singular values of the Jacobian with columns of unit length (Belsley, Kuh &
Welsch, Regression Diagnostics, 1980), size off the relative standard errors. The limits below are the
verdict's.
"""

from __future__ import annotations

import numpy as np

# Column-scaled condition number from which Belsley et al. speak of a damaging collinearity ...
CONDITION_LIMIT = 30.0
# ... whose members are the unknowns with more than this share of their variance on such directions.
SHARE_LIMIT = 0.5
WEAK_ERROR = 0.10  # relative standard error from which an unknown counts as weakly determined
LOST_ERROR = 0.50  # ... and from which the data do not determine it
NAMED = 6  # unknowns that a sentence names; fields have hundreds
ACCURACY = 0.01  # the verdict takes no data or model for better than this fraction of the amplitude


def unit_covariance(jacobian: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """(J^T J)^-1 (n, n) over the free unknowns, condition number of the scaled columns, members of collinear
    groups.

    Columns are scaled to unit length, so that the condition number does not depend on units; unknowns without
    any influence get an infinite variance, those at a bound NaN.
    """
    size = len(free)
    covariance, collinear = np.full((size, size), np.nan), np.zeros(size, dtype=bool)
    lengths = np.linalg.norm(jacobian, axis=0)
    silent = free & (lengths <= 1e-12 * np.max(lengths, initial=0.0))
    covariance[silent, silent] = np.inf
    used = np.flatnonzero(free & ~silent)
    if not used.size:
        return covariance, np.inf if np.any(silent) else np.nan, collinear
    _, singular, right = np.linalg.svd(jacobian[:, used] / lengths[used], full_matrices=False)
    if len(singular) < len(used):  # fewer data than unknowns
        right = np.linalg.svd(jacobian[:, used] / lengths[used], full_matrices=True)[2]
        singular = np.concatenate([singular, np.zeros(len(used) - len(singular))])
    # 1e-12 stands for zero: below it the inverse is rounding noise, above it merely hopeless
    singular = np.maximum(singular, 1e-12 * singular[0])
    parts = (right / singular[:, None]) ** 2  # (direction, unknown) contributions to each variance
    shares = parts / np.sum(parts, axis=0)
    weak = singular[0] / singular > CONDITION_LIMIT
    if np.any(weak):
        collinear[used] = np.sum(shares[weak], axis=0) > SHARE_LIMIT
    inverse = (right.T / singular**2) @ right
    covariance[np.ix_(used, used)] = inverse / np.outer(lengths[used], lengths[used])
    return covariance, np.inf if np.any(silent) else float(singular[0] / singular[-1]), collinear


def verdict(
    labels: list[str],
    error: np.ndarray,
    alone: np.ndarray,
    collinear: np.ndarray,
    condition: float,
    correlation: np.ndarray,
) -> tuple[str, list[str]]:
    """One of "identifiable", "weakly identifiable", "not identifiable", and the reasons with their numbers.

    Vectors (n,): relative errors together and alone, membership in a collinear group; correlation (n, n).
    """
    reasons: list[str] = []
    group_lost = bool(np.any(error[collinear] > WEAK_ERROR))
    if np.any(collinear):
        members = np.flatnonzero(collinear).tolist()
        names = " and ".join(labels[i] for i in members[:NAMED]) + _more(members)
        strongest = max((abs(correlation[i, j]) for i in members for j in members if i < j), default=np.nan)
        numbers = ", ".join(
            f"{labels[i]} +- {_percent(error[i])} ({_percent(alone[i])} if the others were known)"
            for i in members[:NAMED]
        )
        what = "can't be told apart" if group_lost else "are hard to tell apart"
        numbers += _more(members)
        reasons.append(
            f"{names} {what} by these data: correlation {strongest:.6f}, condition number "
            f"{condition:.3g} (limit {CONDITION_LIMIT:g}); at {_percent(ACCURACY)} accuracy {numbers}. "
            "Fix one of them, or observe something that tells them apart"
        )
    weak = np.flatnonzero(~collinear & (error > WEAK_ERROR)).tolist()
    for i in weak[:NAMED]:
        strength = "do not determine" if error[i] > LOST_ERROR else "determine only weakly"
        reasons.append(
            f"the data {strength} {labels[i]}: standard error {_percent(error[i])} (limit "
            f"{_percent(LOST_ERROR if error[i] > LOST_ERROR else WEAK_ERROR)})"
        )
    if len(weak) > NAMED:
        reasons.append(f"and so of {len(weak) - NAMED} more unknowns; fit.uncertainty has the numbers of all")
    if group_lost or np.any(error > LOST_ERROR):
        return "not identifiable", reasons
    if reasons:
        return "weakly identifiable", reasons
    return "identifiable", reasons


def _more(members: list[int]) -> str:
    """What stands for the unknowns of a group that are not named."""
    return f" and {len(members) - NAMED} more" if len(members) > NAMED else ""


def _percent(fraction: float) -> str:
    return "more than 1000 %" if not fraction < 10 else f"{100 * fraction:.2g} %"
