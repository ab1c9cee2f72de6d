"""Neighbor lists filled for new positions, with arrays whose sizes stay as they are. Inside jit."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.neighbors.cells import cumulative_sum, order_by
from jaxsph.neighbors.lists import NeighborList
from jaxsph.neighbors.search import find_neighbors, index_cells
from jaxsph.pytree import replace

ORDERED_FROM = 8192
"""Rows of one part of a list from which on those of both are put in order of how many neighbors each has."""


@partial(jax.jit, static_argnums=(0, 1))
def rebuilt(grid, in_cell_order, neighbors, positions, senders):
    """The list for these positions of receivers, and of senders if there are two sets; see `NeighborSearch.update`."""
    neighbors = noted_outside(neighbors, positions, senders, jnp)
    if neighbors.members is not None:
        return _rebuilt_near(grid, neighbors, positions, senders)
    indexed = index_cells(grid, positions, in_cell_order)
    if neighbors.transpose is None:
        permutation, _, _, _ = indexed
        return _filled(grid, neighbors, positions, indexed, _places(permutation, positions.shape[1]))
    transpose = neighbors.transpose
    forward = _filled(grid, neighbors, positions, index_cells(grid, senders, in_cell_order), None)
    return replace(forward, transpose=_filled(grid, transpose, senders, indexed, None))


def _rebuilt_near(grid, neighbors, positions, senders):
    """A list of two sets with rows for those near each other: found, and then searched like any two sets."""
    forward, positions_near, n_near = _chosen(grid, neighbors, positions, senders)
    back, senders_near, n_senders_near = _chosen(grid, neighbors.transpose, senders, positions)
    by_count = max(forward.capacity.members, back.capacity.members) >= ORDERED_FROM
    indexed, indexed_senders = index_cells(grid, positions_near, False), index_cells(grid, senders_near, False)
    forward = _filled(grid, forward, positions_near, indexed_senders, None, n_near, in_cell_order=by_count)
    back = _filled(grid, back, senders_near, indexed, None, n_senders_near, in_cell_order=by_count)
    if by_count:
        order, order_of_back = _most_first(forward), _most_first(back)
        rows, rows_of_back = _places(order, len(order)), _places(order_of_back, len(order_of_back))
        of_cells, senders_of_cells = indexed[0], indexed_senders[0]
        forward = _reordered(forward, order, rows, rows_of_back.at[senders_of_cells].get(mode="promise_in_bounds"))
        back = _reordered(back, order_of_back, rows_of_back, rows.at[of_cells].get(mode="promise_in_bounds"))
    return replace(forward, reference=positions, transpose=replace(back, reference=senders))


def _most_first(part):
    """The permutation of rows that puts those with most neighbors first.

    A loop takes as many turns for a tile of receivers as one of them needs, and at a wall most have a few, some a
    hundred.
    """
    most = part.capacity.slots
    return order_by(most - part.count, most.bit_length())


def _reordered(part, order, rows, numbers):
    """The list with its rows in another order, and other numbers for neighbors.

    order, rows: which row comes where, and where each went; numbers: the row of each neighbor, by its old number.
    """

    def of_slot(slot, indices):
        row = jax.lax.dynamic_index_in_dim(part.indices, slot, keepdims=False).at[order].get(mode="promise_in_bounds")
        row = numbers.at[row].get(mode="promise_in_bounds")
        return jax.lax.dynamic_update_slice_in_dim(indices, row[None], slot, 0)

    return replace(
        part,
        indices=jax.lax.fori_loop(0, jnp.max(part.count), of_slot, jnp.zeros_like(part.indices)),
        count=part.count.at[order].get(mode="promise_in_bounds"),
        members=part.members.at[order].get(mode="promise_in_bounds"),
        place=rows.at[part.place].get(mode="fill", fill_value=len(order)),
    )


def _chosen(grid, part, positions, others):
    """The list with its members chosen, their positions (NaN in rows that are left over), and how many they are."""
    n, rows = positions.shape[1], part.capacity.members
    near = grid.any_near(positions, others)
    standing = cumulative_sum(near.astype(jnp.int32))
    place = jnp.where(near, jnp.minimum(standing - 1, rows), rows)
    members = jnp.full(rows, n, jnp.int32).at[place].set(jnp.arange(n, dtype=jnp.int32), mode="drop")
    n_near = standing[-1]
    part = replace(part, members=members, place=place, needed_members=jnp.maximum(part.needed_members, n_near))
    return part, positions.at[:, members].get(mode="fill", fill_value=jnp.nan), n_near


def _filled(grid, neighbors, receivers, indexed_senders, own, n_used=None, *, in_cell_order=False):
    """The list of these receivers, or of the first n_used, with its flags brought up to date.

    in_cell_order: number neighbors by their places in cell order.
    """
    permutation, sorted_senders, starts, ordered = indexed_senders
    ids = None if in_cell_order else permutation
    indices, count, width, width_round = find_neighbors(
        grid, receivers, sorted_senders, starts, ids, own, neighbors.capacity, n_used
    )
    return replace(
        neighbors,
        indices=indices,
        count=jnp.minimum(count, neighbors.capacity.slots),
        reference=receivers,
        needed_slots=jnp.maximum(neighbors.needed_slots, jnp.max(count)),
        needed_range=jnp.maximum(neighbors.needed_range, jnp.stack([width, width_round])),
        out_of_order=neighbors.out_of_order | ~ordered,
    )


def _places(permutation, n):
    """Where each particle stands in cell order: the inverse of the permutation."""
    standing = jnp.arange(n, dtype=jnp.int32)
    if permutation is None:
        return standing
    return jnp.zeros(n, jnp.int32).at[permutation].set(standing, unique_indices=True, mode="promise_in_bounds")


def noted_outside(neighbors: NeighborList, positions, senders, xp) -> NeighborList:
    """The list with the first particle outside noted, unless one has been already. xp is NumPy or its JAX double."""
    positions = xp.asarray(positions)
    contained = neighbors.grid.domain.contains(positions)
    first = xp.argmin(contained)
    is_news = ~contained[first] & (xp.asarray(neighbors.outside) < 0)
    if neighbors.transpose is not None:
        neighbors = replace(neighbors, transpose=noted_outside(neighbors.transpose, senders, None, xp))
    return replace(
        neighbors,
        outside=jnp.asarray(xp.where(is_news, first.astype(np.int32), neighbors.outside)),
        outside_position=jnp.asarray(xp.where(is_news, positions[:, first], neighbors.outside_position)),
    )
