"""The collapse of a water column as an inviscid flow with a free surface: what a dam break converges to.

The velocity is the gradient of a potential. Markers of the surface move with it; between two moments the potential on
them changes by (|grad phi|^2 / 2 - g y), and everywhere else it solves Laplace's equation with solid floor and back
wall. M. S. Longuet-Higgins, E. D. Cokelet (1976), Proc. R. Soc. Lond. A 350, 1; here with linear finite elements on
rays from the lower corner of the column, from which all of the surface can be seen.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve


def collapse(height: float, end: float, *, markers: int = 40, layers: int = 16, steps: int = 175):
    """Front and energy of a column of width 1 and gravity 1/2, whose time is T = t sqrt(2 g / a).

    Args:
        height: of the column, in widths.
        end: T at the end.
        markers: about their number; they crowd at the foot of the column.
        layers: of elements between the corner and the surface.
        steps: in time, of Runge and Kutta's fourth order.

    Returns: times, fronts (steps + 1,), relative change of the energy and of the area at the end, the surface (n, 2).
    """
    # from the foot up the face, then along the top to the back wall
    face = height * np.linspace(0, 1, markers) ** 1.5
    top = 1 - np.linspace(0, 1, max(markers // 2, 10))[1:]
    surface = np.concatenate([np.stack([np.ones(markers), face], 1), np.stack([top, np.full(len(top), height)], 1)])
    potential, step = np.zeros(len(surface)), end / steps
    rays = Rays(len(surface), layers)
    start, fronts = _energy(rays, surface, potential), [1.0]
    for index in range(steps):
        moved, stages = (surface, potential), []
        for share in (0.5, 0.5, 1.0, 0.0):
            stages.append(_rates(rays, *moved))
            moved = tuple(y + share * step * rate for y, rate in zip((surface, potential), stages[-1], strict=True))
        one, two, three, four = stages
        mean = [(one[k] + 2 * two[k] + 2 * three[k] + four[k]) / 6 for k in range(2)]
        surface, potential = surface + step * mean[0], potential + step * mean[1]
        if index % 2:
            surface, potential = _smoothed(surface), _smoothed(potential)
        fronts.append(surface[0, 0])
    energy, area = (now / before - 1 for now, before in zip(_energy(rays, surface, potential), start, strict=True))
    return np.linspace(0, end, steps + 1), np.array(fronts), energy, area, surface


class Rays:
    """Triangles between the corner and the surface; `solve` gives the flux through the surface."""

    def __init__(self, markers: int, layers: int):
        self.share = np.sin(0.5 * np.pi * np.arange(1, layers + 1) / layers)  # finer towards the surface
        index = 1 + np.arange(markers * layers).reshape(layers, markers)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        first = np.stack([np.zeros(markers - 1, int), index[0, :-1], index[0, 1:]], 1)
        pairs = [np.stack([x.ravel() for x in three], 1) for three in ((a, c, d), (a, d, b))]
        self.triangles, self.index = np.concatenate([first, *pairs]), index

    def solve(self, surface, potential):
        """phi_n (n,) at the markers, and the kinetic energy per density."""
        nodes = np.concatenate([np.zeros((1, 2)), (self.share[:, None, None] * surface).reshape(-1, 2)])
        corners = nodes[self.triangles]
        edges = np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1)
        twice = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
        local = np.einsum("nik,njk->nij", edges, edges) / (2 * np.abs(twice))[:, None, None]
        i, j = np.repeat(self.triangles, 3, axis=1), np.tile(self.triangles, (1, 3))
        stiffness = coo_matrix((local.ravel(), (i.ravel(), j.ravel())), shape=(len(nodes),) * 2).tocsr()
        outer = self.index[-1]
        inner = np.setdiff1d(np.arange(len(nodes)), outer)
        phi = np.zeros(len(nodes))
        phi[outer] = potential
        rows = stiffness[inner]
        phi[inner] = np.asarray(spsolve(rows[:, inner].tocsc(), -rows @ phi))
        through = (stiffness @ phi)[outer]
        length = np.linalg.norm(np.diff(surface, axis=0), axis=1)
        n = len(surface)
        main = np.zeros(n)
        main[:-1] += length / 3
        main[1:] += length / 3
        k = np.arange(n - 1)
        values = np.concatenate([main, length / 6, length / 6])
        at = (np.concatenate([np.arange(n), k, k + 1]), np.concatenate([np.arange(n), k + 1, k]))
        return spsolve(coo_matrix((values, at), shape=(n, n)).tocsc(), through), 0.5 * phi @ (stiffness @ phi)


def _rates(rays, surface, potential):
    """Velocity (n, 2) of the markers and rate of their potential (n,)."""
    normal_speed, _ = rays.solve(surface, potential)
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(surface, axis=0), axis=1))])
    tangent = np.gradient(surface, s, axis=0, edge_order=2)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], 1)
    velocity = np.gradient(potential, s, edge_order=2)[:, None] * tangent + normal_speed[:, None] * normal
    velocity[0, 1] = velocity[-1, 0] = 0.0  # floor and back wall
    return velocity, 0.5 * np.sum(velocity**2, axis=1) - 0.5 * surface[:, 1]


def _smoothed(values):
    """Without what alternates from marker to marker: Longuet-Higgins' and Cokelet's five points; ends stay."""
    out = values.copy()
    out[2:-2] = (-values[:-4] + 4 * values[1:-3] + 10 * values[2:-2] + 4 * values[3:-1] - values[4:]) / 16
    return out


def _energy(rays, surface, potential):
    """Energy and area; g = 1/2."""
    x, y = np.concatenate([surface, [[0.0, 0.0]]]).T
    x2, y2 = np.roll(x, -1), np.roll(y, -1)
    cross = x * y2 - x2 * y
    return rays.solve(surface, potential)[1] + 0.5 * np.sum(cross * (y + y2)) / 6, 0.5 * np.sum(cross)
