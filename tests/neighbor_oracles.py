"""Particles to search neighbors of, and the pairs near each other found in two other ways."""

import math

import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from jaxsph.neighbors import CellGrid, Domain

N = 400  # particles of every test set, so that one compilation serves them all


def lattice(dimension, jitter, seed=0):
    """A regular lattice in the unit box; jitter as a fraction of its spacing."""
    per_axis = math.ceil(N ** (1 / dimension))
    coordinates = (np.arange(per_axis) + 0.5) / per_axis
    points = np.stack([g.ravel() for g in np.meshgrid(*[coordinates] * dimension, indexing="ij")])[:, :N]
    moved = points + np.random.default_rng(seed).uniform(-jitter, jitter, points.shape) / per_axis
    return np.clip(moved, 1e-6, 1 - 1e-6)


def random(dimension, n=N, seed=1):
    return np.random.default_rng(seed).uniform(0, 1, (dimension, n))


def clusters(dimension, seed=2):
    """Dense blobs in an almost empty box."""
    rng = np.random.default_rng(seed)
    centers = np.repeat(rng.uniform(0.1, 0.9, (dimension, 5)), N // 5, axis=1)
    return np.clip(centers + rng.normal(0, 0.05, (dimension, N)), 0, 1)


def on_cell_boundaries(dimension):
    """Particles exactly on the corners of the cells of a search with reach 0.25, the farthest on the bounds."""
    grid = CellGrid.covering(Domain((0,) * dimension, (1,) * dimension), 0.25)
    ticks = [np.arange(n + 1) / n for n in grid.cells]
    corners = np.stack([g.ravel() for g in np.meshgrid(*ticks, indexing="ij")])
    return corners[:, np.random.default_rng(6).choice(corners.shape[1], N, replace=corners.shape[1] < N)]


def coincident(dimension):
    """Every particle four times in the same place."""
    return np.repeat(random(dimension, N // 4, seed=3), 4, axis=1)


PARTICLES = {
    "lattice": lambda dimension: lattice(dimension, 0.0),
    "jittered": lambda dimension: lattice(dimension, 0.3),
    "random": random,
    "clusters": clusters,
    "on boundaries": on_cell_boundaries,
    "coincident": coincident,
}


def pairs_of(neighbors):
    """The list as a set of (receiver, sender)."""
    indices, count = np.asarray(neighbors.indices), np.asarray(neighbors.count)
    found = [(i, int(j)) for i in range(indices.shape[1]) for j in indices[: count[i], i]]
    assert len(found) == len(set(found)), "a neighbor is listed twice"
    return set(found)


def all_pairs(domain, a, b, reach, same):
    """Pairs within reach by comparing all with all; for particles none of which are exactly that far apart."""
    displacement = domain.displacement(a[:, :, None], b[:, None, :])
    near = np.array(jnp.sum(displacement * displacement, axis=0) < jnp.asarray(reach, a.dtype) ** 2)
    if same:
        np.fill_diagonal(near, False)
    return set(zip(*(index.tolist() for index in np.nonzero(near)), strict=True))


def tree_pairs(domain, a, b, reach, same):
    """Pairs surely within reach and pairs surely not beyond it: rounding decides between the two.

    Coordinates up to 1 carry a rounding of eps / 2, differences of two eps, so distances of 0.2 some 10 eps.
    """
    lower, box = np.asarray(domain.lower), np.where(domain.periodic, domain.lengths, 1e6)
    trees = [KDTree((np.asarray(x, float).T - lower) % box, boxsize=box) for x in (a, b)]
    bounds = []
    rounding = 10 * float(jnp.finfo(a.dtype).eps)
    for radius in (reach * (1 - rounding), reach * (1 + rounding)):
        near = trees[0].query_ball_tree(trees[1], radius)
        bounds.append({(i, j) for i, row in enumerate(near) for j in row if not (same and i == j)})
    return bounds
