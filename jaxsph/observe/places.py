"""Points at which fields are asked for."""

from __future__ import annotations

import numpy as np


def line(start, end, n: int) -> np.ndarray:
    """Points (n, d) [m] on a line from start to end (d,), both included, evenly spaced.

    Raises ValueError for fewer than 2 points, or ends that have not the same 2 or 3 components.
    """
    start, end = _corners(start=start, end=end)
    return start + np.linspace(0.0, 1.0, _number("n", n))[:, None] * (end - start)


def plane(corner, first, second, n: tuple[int, int]) -> np.ndarray:
    """Points (n[0] n[1], d) [m] of a parallelogram, edges included, evenly spaced along both.

    The second edge varies fastest: reshape what is observed there to (n[0], n[1], ...).

    Args:
        corner: (d,) [m].
        first, second: the corners next to it (d,) [m].
        n: number of points along the edges to them.

    Raises ValueError for fewer than 2 points along an edge, or corners that have not the same 2 or 3 components.
    """
    corner, first, second = _corners(corner=corner, first=first, second=second)
    a = np.linspace(0.0, 1.0, _number("n[0]", n[0]))[:, None, None]
    b = np.linspace(0.0, 1.0, _number("n[1]", n[1]))[None, :, None]
    return (corner + a * (first - corner) + b * (second - corner)).reshape(-1, len(corner))


def _corners(**named):
    corners = {name: np.asarray(value, float) for name, value in named.items()}
    if len({corner.shape for corner in corners.values()}) > 1 or next(iter(corners.values())).shape not in ((2,), (3,)):
        shapes = ", ".join(f"{name} {corner.shape}" for name, corner in corners.items())
        raise ValueError(f"points of 2 or 3 components each are needed, not {shapes}")
    return corners.values()


def _number(name, n):
    if int(n) != n or n < 2:
        raise ValueError(f"{name} = {n} points; at least 2 are needed, the ends")
    return int(n)
