"""Walls around a box."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jaxsph.geometry.shapes import Particles, box, check_spacing, floating


def tank(corner, size, spacing: float, layers: int = 3, *, sides: Sequence[str] | None = None, dtype=None) -> Particles:
    """Layers of wall particles around a box, outside of it; cell-centered, so that the wall is half a spacing off.

    Args:
        corner: lower corner of the inside (d,) [m].
        size: inner edge lengths (d,) [m], multiples of the spacing to within 1 %.
        spacing: distance of particles [m].
        layers: of wall particles; as many as the support radius reaches.
        sides: which faces have a wall: in 2D of "left", "right" (x), "bottom", "top" (y); in 3D "left", "right" (x),
            "front", "back" (y), "bottom", "top" (z). None takes all but the top. Corners belong to the faces that meet
            there, and to one alone if the other is open.
        dtype: float32 or float64; None takes jax's default.

    Raises ValueError for a size that does not fit the spacing, an unknown side, or less than one layer.
    """
    check_spacing(spacing)
    corner, size = np.asarray(corner, float), np.asarray(size, float)
    d = len(size)
    if layers < 1:
        raise ValueError(f"layers = {layers} must be at least 1")
    names = (
        (("left", "right"), ("bottom", "top")) if d == 2 else (("left", "right"), ("front", "back"), ("bottom", "top"))
    )
    known = [name for pair in names for name in pair]
    sides = [name for name in known if name != "top"] if sides is None else list(sides)
    for name in sides:
        if name not in known:
            raise ValueError(f"side {name!r} is not known; a tank in {d}D has {', '.join(known)}")
    box(corner, size, spacing)  # checks the sizes
    cells = np.array([round(length / spacing) for length in size])
    step = size / cells
    before = [layers if pair[0] in sides else 0 for pair in names]
    after = [layers if pair[1] in sides else 0 for pair in names]
    axes = [np.arange(-b, n + a) for b, n, a in zip(before, cells, after, strict=True)]
    index = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
    wall = index[np.any((index < 0) | (index >= cells), axis=1)]
    real = floating(dtype)
    positions = (corner + (wall + 0.5) * step).astype(real)
    return Particles(positions, np.full(len(wall), math.prod(step)).astype(real), float(spacing))


def polygon(corners, spacing: float, *, dtype=None) -> Particles:
    """A polygon in 2D filled with a square lattice; its particles share its exact area.

    Args:
        corners: (M, 2) [m] in either sense of rotation; the polygon must not cross itself.
        spacing: distance of particles [m].
        dtype: float32 or float64; None takes jax's default.

    Raises ValueError for fewer than 3 corners, edges that cross, no area, or no particle inside.
    """
    check_spacing(spacing)
    corners = np.asarray(corners, float)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise ValueError(f"corners has shape {corners.shape}; it must be (M, 2) with M >= 3")
    crossing = _crossing_edges(corners)
    if crossing is not None:
        raise ValueError(
            f"edges {crossing[0]} and {crossing[1]} of the polygon cross; list its corners along the outline"
        )
    x, y = corners.T
    area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    if not area > 0:
        raise ValueError("the corners of the polygon lie on a line; it has no area")
    low = corners.min(axis=0)
    cells = np.maximum(np.ceil((corners.max(axis=0) - low) / spacing - 1e-9).astype(int), 1)
    axes = [low[k] + (np.arange(cells[k]) + 0.5) * spacing for k in range(2)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = lattice[_is_inside(lattice, corners)]
    if not len(inside):
        raise ValueError(f"no particle fits into the polygon at a spacing of {spacing} m; take a smaller one")
    real = floating(dtype)
    return Particles(inside.astype(real), np.full(len(inside), area / len(inside)).astype(real), float(spacing))


def _crossing_edges(corners):
    """The numbers of the first two edges that cross within both of them; None if no two do."""
    start, end = corners, np.roll(corners, -1, axis=0)

    def side(a, b, point):
        """Of which side of the line from a to b a point is."""
        return np.sign((b - a)[..., 0] * (point - a)[..., 1] - (b - a)[..., 1] * (point - a)[..., 0])

    for number, (a, b) in enumerate(zip(start, end, strict=True)):  # one by one: outlines may have thousands
        cross = (side(a, b, start) * side(a, b, end) < 0) & (side(start, end, a) * side(start, end, b) < 0)
        if cross.any():
            return number, int(np.argmax(cross))
    return None


def _is_inside(points, corners):
    """Whether an odd number of edges is crossed on the way to the right."""
    inside = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        spans = (y0 > points[:, 1]) != (y1 > points[:, 1])
        crossing = x0 + (points[:, 1] - y0) * (x1 - x0) / np.where(y1 == y0, 1.0, y1 - y0)
        inside ^= spans & (points[:, 0] < crossing)
    return inside
