"""The step of a damped Gauss-Newton iteration within bounds and a trust radius."""

from __future__ import annotations

import numpy as np


def trust_region_step(
    z: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    radius: float,
    floor: float,
) -> np.ndarray:
    """Minimize |r + J p|^2 + damping |p|^2 with |p| <= radius and lower <= z + p <= upper.

    Levenberg-Marquardt with the damping found from the trust radius (More 1978, doi:10.1007/BFb0067700), so
    that it vanishes by itself near the solution and the convergence is that of Gauss-Newton. Unknowns that
    run into a bound are put on it and the others solved again.

    Args:
        z: (n,) current point.
        residual: (R,) at z.
        jacobian: (R, n) at z.
        lower: (n,) bounds.
        upper: (n,) bounds.
        radius: largest Euclidean length of the step.
        floor: singular values below floor * the largest one count as round-off.

    Returns:
        (n,) step.

    """
    step = np.zeros_like(z)
    gradient = jacobian.T @ residual
    tiny = 1e-12 * (upper - lower)
    free = ~(((z <= lower + tiny) & (gradient > 0)) | ((z >= upper - tiny) & (gradient < 0)))
    while np.any(free):
        remaining = residual + jacobian[:, ~free] @ step[~free]
        step[free] = _damped(remaining, jacobian[:, free], radius, floor)
        outside = free & ((z + step < lower) | (z + step > upper))
        if not np.any(outside):
            break
        step[outside] = np.clip(z + step, lower, upper)[outside] - z[outside]
        free &= ~outside
    return step


def _damped(residual: np.ndarray, jacobian: np.ndarray, radius: float, floor: float) -> np.ndarray:
    left, singular, right = np.linalg.svd(jacobian, full_matrices=False)
    if singular[0] == 0.0:
        return np.zeros(jacobian.shape[1])
    projected = left.T @ residual

    def step(damping: float) -> np.ndarray:
        return -singular * projected / (singular**2 + damping)

    damping = (floor * singular[0]) ** 2
    if np.linalg.norm(step(damping)) > radius:
        low, high = np.log(damping), np.log(damping)
        while np.linalg.norm(step(np.exp(high))) > radius:
            high += np.log(1e3)
        for _ in range(40):  # bisection to 1e-9 in the damping: the length of the step is not delicate
            middle = 0.5 * (low + high)
            low, high = (middle, high) if np.linalg.norm(step(np.exp(middle))) > radius else (low, middle)
        damping = float(np.exp(high))
    return right.T @ step(damping)
