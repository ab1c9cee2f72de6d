"""The search: candidates of a range are tested into machine words, then read out slot by slot.

For each receiver the candidates in one row of cells are consecutive in memory. Testing them is one pass over
contiguous coordinates, whose outcomes are packed into the bits of a word. Reading out puts each word at the slot
where its first neighbor belongs; a loop over slots then takes the lowest bit off the current word until the next
word begins. Nothing is sorted and there is one scatter per word, not one per candidate. Receivers are processed
in tiles whose temporary arrays stay in the cache.
"""

from __future__ import annotations

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
from jax.lax import GatherDimensionNumbers

from jaxsph.neighbors.cells import CellGrid, cell_order

WORD = 32
TILE_BYTES = 4 * 2**20  # temporary arrays of one tile; about the second-level cache of current CPUs
SMALLEST_TILE = 1024  # receivers
_CONSECUTIVE = GatherDimensionNumbers(offset_dims=(2,), collapsed_slice_dims=(), start_index_map=(0,))


@dataclasses.dataclass(frozen=True)
class Capacity:
    """Sizes of the arrays of a search, fixed when a list is allocated.

    Attributes:
        slots: neighbors of one particle.
        range: candidates of one particle in one row of cells.
        range_round: candidates at the far end of a periodic row.
        members: receivers that have a row in the list; None if all of them have.
    """

    slots: int
    range: int
    range_round: int = 0
    members: int | None = None


def index_cells(grid: CellGrid, positions, in_cell_order: bool):
    """Put a set of particles (d, N) in cell order. One whose position is NaN comes last and is in no cell.

    Returns (permutation or None, sorted positions, first particle of each cell, whether the order is right).
    With `in_cell_order` the caller has sorted them; that is checked, not repeated.
    """
    permutation = None
    if not in_cell_order:
        permutation = cell_order(grid, positions)
        positions = positions.at[:, permutation].get(mode="promise_in_bounds")
    numbers = grid.number_or_none(positions)
    ordered = jnp.all(numbers[1:] >= numbers[:-1])
    return permutation, positions, grid.starts(numbers), ordered


def find_neighbors(grid: CellGrid, receivers, senders, starts, sender_ids, own, capacity: Capacity, n_used=None):
    """The neighbors of every receiver.

    Args:
        grid: cells of both sets.
        receivers: positions (d, N), in any order; fastest in cell order.
        senders: positions (d, M) in cell order.
        starts: first sender of each cell, as `CellGrid.starts` gives them.
        sender_ids: (M,) the number of each sorted sender in its own set; None if they are the same.
        own: (N,) where each receiver stands among the sorted senders; None for two different sets.
        capacity: sizes of the arrays.
        n_used: how many receivers there are, the first of them; those that follow have no neighbors, and cost nothing.

    Returns:
        indices (slots, N), number of neighbors (N,) also beyond the slots, widest range, widest far range.
    """
    n, slots = receivers.shape[1], capacity.slots
    padded = jnp.pad(senders, ((0, 0), (0, WORD)), constant_values=jnp.inf)
    # Of receivers of which many may not be there, small tiles: whole ones are left out.
    tile = min(n, SMALLEST_TILE if n_used is not None else max(TILE_BYTES // (8 * max(slots, 1)), SMALLEST_TILE))
    n_tiles = -(-n // tile) if n_used is None else (jnp.minimum(n_used, n) + (tile - 1)) // tile

    def process(number, found):
        indices, counts, width, width_round = found
        begin = jnp.minimum(number * tile, n - tile)  # the last tile overlaps the one before and repeats its result
        # A gather, because XLA fuses a dynamic slice into the tests of candidates and halves their speed.
        ids = begin + jnp.arange(tile, dtype=jnp.int32)
        part = receivers.at[:, ids].get(mode="promise_in_bounds")
        own_part = None if own is None else own.at[ids].get(mode="promise_in_bounds")
        ranges = _candidates(grid, part, starts)
        widths = [jnp.max(last - first) if last is not None else jnp.int32(0) for first, last in ranges]
        indices_part, count = _found(grid, part, padded, own_part, ranges, widths[0], capacity)
        if sender_ids is not None:
            indices_part = sender_ids.at[indices_part].get(mode="promise_in_bounds")
        filled = jnp.arange(slots, dtype=jnp.int32)[:, None] < count
        indices_part = jnp.where(filled, indices_part, 0 if own is None else ids)
        indices = jax.lax.dynamic_update_slice_in_dim(indices, indices_part, begin, 1)
        counts = jax.lax.dynamic_update_slice_in_dim(counts, count, begin, 0)
        return indices, counts, jnp.maximum(width, widths[0]), jnp.maximum(width_round, widths[1])

    empty = (jnp.zeros((slots, n), jnp.int32), jnp.zeros(n, jnp.int32), jnp.int32(0), jnp.int32(0))
    return process(0, empty) if n_used is None and n_tiles == 1 else jax.lax.fori_loop(0, n_tiles, process, empty)


def _candidates(grid, receivers, starts):
    """Ranges of candidates: first and last of each row of cells, and of its far end (None where there is none)."""
    ranges = grid.ranges(grid.coordinates(receivers), starts)
    known = ~jnp.isnan(receivers[0])  # what has no position has no candidates
    ranges = tuple(None if ends is None else jnp.where(known, ends, 0) for ends in ranges)
    # Without the barriers XLA computes each range again for each candidate, and each word for each of its uses.
    first, last, first_round, last_round = jax.lax.optimization_barrier(ranges)
    return (first, last), (first_round, last_round)


def _found(grid, receivers, padded, own, ranges, width, capacity):
    """Positions of the neighbors (slots, n) among the sorted senders, and how many they are.

    width: of the widest range here, which decides how many words are tested: one where the reserve is not used.
    """
    (first, last), (first_round, last_round) = ranges
    test = partial(_words, grid, receivers, padded, own)
    most = max(-(-capacity.range // WORD), 1)
    if most == 1:
        words, bases = test(first, last, _bits_of(capacity.range))
        used = len(first)
    else:
        rows = len(first)

        def one_more(carry):
            number, words, bases = carry
            found = test(first + number * WORD, last, WORD)
            put = partial(jax.lax.dynamic_update_slice_in_dim, start_index=number * rows, axis=0)
            return number + 1, put(words, found[0]), put(bases, found[1])

        n_words = jnp.minimum(-(-width // WORD), most)
        empty = jnp.zeros((most * rows, receivers.shape[1]), jnp.int32)
        carry = (jnp.int32(0), empty.astype(jnp.uint32), empty)
        _, words, bases = jax.lax.while_loop(lambda carry: carry[0] < n_words, one_more, carry)
        used = n_words * rows
    if first_round is not None:
        # In front, so that the words in use are the first ones.
        n_far = -(-capacity.range_round // WORD)
        starts = jnp.concatenate([first_round + word * WORD for word in range(n_far)])
        far = test(starts, jnp.concatenate([last_round] * n_far), _bits_of(capacity.range_round))
        words, bases = jnp.concatenate([far[0], words]), jnp.concatenate([far[1], bases])
        used = used + len(starts)
    words, bases = jax.lax.optimization_barrier((words, bases))
    count = jnp.sum(jax.lax.population_count(words), axis=0, dtype=jnp.int32)
    return _read_out(words, bases, used, count, capacity.slots), count


def _bits_of(width: int) -> int:
    """How many bits of a word are used for a range, of many words all: as few candidates beyond it as possible."""
    return min(-(-width // 8) * 8, WORD)


def _words(grid, receivers, padded, own, base, end, bits):
    """A word for each of these candidates and receivers, which says which of the `bits` from base on are neighbors."""
    base = jnp.minimum(base, end)  # a word beyond the range tests nothing and must not read beyond the array
    squared = 0.0
    for axis in range(grid.domain.dimension):
        candidates = jax.lax.gather(padded[axis], base[..., None], _CONSECUTIVE, (bits,), mode="promise_in_bounds")
        difference = grid.domain.component(axis, receivers[axis][None, :, None], candidates)
        squared = squared + difference * difference
    bit = jnp.uint32(1) << jnp.arange(bits, dtype=jnp.uint32)
    flags = jnp.where(squared < _limit(grid, receivers), bit, jnp.uint32(0))
    word = jnp.sum(flags, axis=-1, dtype=jnp.uint32)
    word = word & _lowest(jnp.clip(end - base, 0, bits))
    if own is not None:
        at = own - base
        mine = jnp.uint32(1) << jnp.clip(at, 0, WORD - 1).astype(jnp.uint32)
        word = jnp.where((at >= 0) & (at < bits), word & ~mine, word)
    return word, base


def _limit(grid, positions):
    return jnp.asarray(grid.reach, positions.dtype) ** 2


def _lowest(number):
    """A word whose lowest `number` bits are set, 0 to 32."""
    shift = jnp.clip(WORD - number, 0, WORD - 1).astype(jnp.uint32)
    return jnp.where(number > 0, jnp.uint32(2**WORD - 1) >> shift, jnp.uint32(0))


def _read_out(words, bases, used, count, slots):
    """Positions of the set bits of the first `used` words, one after another: (slots, n).

    What follows the last of a receiver is arbitrary; count: how many each has.
    """
    n = words.shape[1]
    lanes = jnp.arange(n, dtype=jnp.int32)

    def spread(number, placed):
        before, word_at, base_at = placed
        word, base = words[number], bases[number]
        at = jnp.where((word != 0) & (before < slots), before * n + lanes, slots * n)
        word_at = word_at.at[at].set(word, mode="drop", unique_indices=True)
        base_at = base_at.at[at].set(base, mode="drop", unique_indices=True)
        return before + jax.lax.population_count(word).astype(jnp.int32), word_at, base_at

    placed = (jnp.zeros(n, jnp.int32), jnp.zeros(slots * n, jnp.uint32), jnp.zeros(slots * n, jnp.int32))
    _, word_at, base_at = jax.lax.fori_loop(0, used, spread, placed)

    def take_lowest(current, new):
        word, base = current
        new_word, new_base = new
        begins = new_word != 0
        word, base = jnp.where(begins, new_word, word), jnp.where(begins, new_base, base)
        rest = word & (word - jnp.uint32(1))
        lowest = jax.lax.population_count((word ^ rest) - jnp.uint32(1)).astype(jnp.int32)
        return (rest, base), jnp.where(word != 0, base + lowest, 0)

    word_at, base_at = word_at.reshape(slots, n), base_at.reshape(slots, n)

    def of_slot(carry):
        slot, current, read = carry
        current, lowest = take_lowest(current, (word_at[slot], base_at[slot]))
        return slot + 1, current, jax.lax.dynamic_update_slice_in_dim(read, lowest[None], slot, 0)

    most = jnp.minimum(jnp.max(count), slots)
    start = (jnp.zeros(n, jnp.uint32), jnp.zeros(n, jnp.int32))
    carry = (jnp.int32(0), start, jnp.zeros((slots, n), jnp.int32))
    return jax.lax.while_loop(lambda carry: carry[0] < most, of_slot, carry)[2]
