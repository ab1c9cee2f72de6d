"""How much closer pairs of particles can have come since their list was built, judged region by region.

Water that falls or flows as a whole moves far, but its particles hardly move against each other: judged by how far
particles went, a list would be out of date long before a pair of its neighbors could have met.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxsph.neighbors.lists import NeighborList, require_senders

EDGE = 1.0  # of a region, in reaches of the search
AROUND = 2  # so many regions on each side of one are near it: one touches it, and one has that one between


class Closing(NamedTuple):
    """How much closer pairs can come [m].

    Attributes:
        near: (..., regions) any particle of a region and any of it and the regions near it.
        far: (...) any two particles at all.
    """

    near: Float[Array, "... regions"]
    far: Float[Array, "..."]


def closing(neighbors: NeighborList, ways: Any, sender_ways: Any = None) -> Closing:
    """How much closer pairs come if particles that stood where the list was built go these ways (d, ..., N) [m].

    Two particles of one region, or of two that touch, come closer by no more than the diagonal of the box that holds
    the differences between ways in the one and ways in the other. Where a region lies between theirs along an axis,
    they are at least a reach apart along it, and only how much closer they come along it counts: in a flow that turns
    that is little.

    Args:
        neighbors: the list.
        ways: of the receivers, or 0 if they stand still.
        sender_ways: the same of the senders of a list of two sets.

    Raises ValueError if the ways of the senders are missing for a list of two sets, or given for a list of one.
    """
    require_senders(neighbors.transpose is not None, sender_ways)
    lead = max((jnp.shape(each)[1:-1] for each in (ways, sender_ways) if each is not None), key=len)
    here = there = _extents(neighbors, ways, lead)
    if neighbors.transpose is not None:
        there = _extents(neighbors.transpose, sender_ways, lead)
    near = jnp.maximum(_touching(neighbors, here, there), _apart(neighbors, here, there))
    if neighbors.transpose is not None:  # of one set every pair has been met
        near = jnp.maximum(near, _apart(neighbors, there, here))
    everywhere = range(2 + len(lead), here.ndim)
    far = _diagonal(*(jnp.max(extents, axis=everywhere) for extents in (here, there)))
    return Closing(near.reshape(*lead, -1), far)


def far_enough(neighbors: NeighborList) -> float:
    """How much closer two particles of regions apart can come before they are within the cutoff [m]."""
    grid = neighbors.grid
    between = [
        AROUND * length / count
        for axis, (length, count) in enumerate(zip(grid.lengths, _regions(neighbors), strict=True))
        if count > (2 * AROUND + 1 if _closes(grid, axis) else AROUND + 1)
    ]
    return min(between, default=float("inf")) - neighbors.cutoff


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


def _extents(part, ways, lead):
    """The largest of each coordinate of the ways in a region, and of its opposite; -inf where nobody stood.

    Shape (2, d, *lead, *regions).
    """
    region, counts = _region_of(part, part.reference), _regions(part)
    shape, dtype = (2, len(counts), *lead, *counts), part.reference.dtype
    if jnp.ndim(ways) == 0:
        still = jnp.full(counts, -jnp.inf, dtype).at[region].max(0.0)
        return jnp.broadcast_to(still, shape)
    return jnp.full(shape, -jnp.inf, dtype).at[..., *region].max(jnp.stack([ways, -ways]))


def _touching(neighbors, here, there):
    """How much closer particles of a region and of it and those that touch it come."""
    d = here.shape[1]
    beside = _with_around(neighbors, there, 1)
    for axis in range(d):
        beside = _largest_of(beside, axis - d, range(3), here.shape[axis - d])
    return _diagonal(here, beside)


def _apart(neighbors, here, there):
    """How much closer particles of regions with one between them along an axis come along it; there is further on."""
    d, closer = here.shape[1], []
    for along in range(d):
        back = _with_around(neighbors, there[1, along], AROUND)
        for axis in range(d):
            starts = (2 * AROUND,) if axis == along else range(2 * AROUND + 1)
            back = _largest_of(back, axis - d, starts, here.shape[axis - d])
        closer.append(here[0, along] + back)
    return reduce(jnp.maximum, closer)


def _with_around(neighbors, values, width):
    """Values (..., *regions) with so many more regions on each side: those of the other end, or empty ones."""
    counts = _regions(neighbors)
    for axis in range(len(counts)):
        widths = [(0, 0)] * values.ndim
        widths[axis - len(counts)] = width, width
        if _closes(neighbors.grid, axis):
            values = jnp.pad(values, widths, mode="wrap")
        else:
            values = jnp.pad(values, widths, constant_values=-jnp.inf)
    return values


def _largest_of(values, axis, starts, n):
    """Of so many values along an axis, counted from the last one, from each of these first ones on."""
    at = values.ndim + axis
    return reduce(jnp.maximum, [jax.lax.slice_in_dim(values, start, start + n, axis=at) for start in starts])


def _diagonal(here, there):
    """Of the boxes that hold the differences between ways here and ways there; zero where there are none."""
    widths = jnp.maximum(jnp.maximum(here[0] + there[1], here[1] + there[0]), 0.0)
    return jnp.sqrt(sum(width * width for width in widths))
