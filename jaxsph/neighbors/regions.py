"""How much closer pairs of particles can have come since their list was built, judged region by region.

Water that falls or flows as a whole moves far, but its particles hardly move against each other: judged by how far
particles went, a list would be out of date long before a pair of its neighbors could have met.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxsph.neighbors.lists import NeighborList, require_senders

EDGE = 2.0  # of a region, in reaches of the search


class Closing(NamedTuple):
    """How much closer pairs can come [m].

    Attributes:
        near: (regions,) for each region, any two particles of it and of the regions around it.
        far: any two particles at all.
    """

    near: Float[Array, " regions"]
    far: Float[Array, ""]


def closing(neighbors: NeighborList, ways: Float[Array, "d n"], sender_ways: Any = None) -> Closing:
    """How much closer pairs come if particles that stood where the list was built go these ways (d, N) [m].

    Two particles of a region and those around it come closer by no more than the diagonal of the box that holds all
    ways of these particles. Two that are not in such regions are further apart than the edge of a region.

    Raises ValueError if the ways of the senders are missing for a list of two sets, or given for a list of one.
    """
    require_senders(neighbors.transpose is not None, sender_ways)
    counts = _regions(neighbors)
    d = len(counts)
    largest = jnp.full((2 * d, *counts), -jnp.inf, ways.dtype)
    sets = [(neighbors, ways)]
    sets += [] if neighbors.transpose is None else [(neighbors.transpose, sender_ways)]
    for part, part_ways in sets:
        both = jnp.concatenate([part_ways, -part_ways])
        largest = largest.at[:, *_region_of(neighbors, part.reference)].max(both)
    everywhere = jnp.max(largest, axis=range(1, d + 1))
    for axis in range(d):
        largest = _around(largest, axis + 1, periodic=_closes(neighbors.grid, axis))
    return Closing(_diagonal(largest.reshape(2 * d, -1)), _diagonal(everywhere))


def far_enough(neighbors: NeighborList) -> float:
    """How much closer two particles of regions apart can come before they are within the cutoff [m]."""
    grid = neighbors.grid
    edges = [
        length / count
        for axis, (length, count) in enumerate(zip(grid.lengths, _regions(neighbors), strict=True))
        if count > (3 if _closes(grid, axis) else 2)
    ]
    return min(edges, default=float("inf")) - neighbors.cutoff


def _regions(neighbors):
    """Number of regions along each axis."""
    grid = neighbors.grid
    return tuple(max(1, int(length / (EDGE * grid.reach))) for length in grid.lengths)


def _closes(grid, axis):
    return grid.domain.periodic[axis] or grid.repeats(axis)


def _region_of(neighbors, positions):
    """The region of particles, an index for each axis. Who is beyond the box belongs to one in it, as in `CellGrid`."""
    grid = neighbors.grid
    found = []
    for axis, (x, count) in enumerate(zip(grid.domain.wrap(positions), _regions(neighbors), strict=True)):
        number = jnp.floor((x - grid.lower[axis]) * (count / grid.lengths[axis]))
        if grid.repeats(axis):
            number = jnp.mod(number, count)
        found.append(jnp.clip(number, 0, count - 1).astype(jnp.int32))
    return tuple(found)


def _around(values, axis, *, periodic):
    """The largest of each value and the two beside it along an axis."""
    if periodic:
        return jnp.maximum(values, jnp.maximum(jnp.roll(values, 1, axis), jnp.roll(values, -1, axis)))
    edge = [(1, 1) if other == axis else (0, 0) for other in range(values.ndim)]
    padded = jnp.pad(values, edge, constant_values=-jnp.inf)
    n = values.shape[axis]
    before, after = (jnp.take(padded, jnp.arange(n) + step, axis=axis) for step in (0, 2))
    return jnp.maximum(values, jnp.maximum(before, after))


def _diagonal(largest):
    """Of boxes given by the largest values of each coordinate and of its opposite; zero of those that are empty."""
    d = largest.shape[0] // 2
    extent = jnp.maximum(largest[:d] + largest[d:], 0.0)
    return jnp.sqrt(jnp.sum(extent * extent, axis=0))
