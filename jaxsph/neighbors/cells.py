"""Cells: how particles are sorted so that all candidates of a particle are a few contiguous ranges."""

from __future__ import annotations

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxsph.neighbors.domain import Domain

Box = tuple[tuple[float, ...], tuple[float, ...]]

CELLS_AT_MOST = 2**20  # more would cost more to count than they save; 4 MB
BLOCK = 16  # of a cumulative sum
MARGIN = 0.01  # of the reach, around a box: its upper end would be in the last cell or, by rounding, in the first
REPEATED = 16.0  # times the box: so far beyond it the rounding of coordinates in float32 is within the margin of cells


@dataclasses.dataclass(frozen=True)
class CellGrid:
    """A grid of cells over a domain, the same for every set of particles.

    Cells form rows along one axis, in which they are numbered consecutively. In particles sorted by cell
    number, the candidates of a particle are one contiguous range for each row nearby, or two where a
    periodic row goes round. Cells are finer than the reach of the search: across, half of it, so that the ranges
    hug the sphere and one machine word holds a range; along the row a quarter, which costs nothing.

    Attributes:
        domain: the box.
        reach: distance within which pairs are found, cutoff + skin [m].
        cells: number of cells along each axis of the domain.
        spans: how many cells the reach extends over, along each axis.
        along: the axis of the rows.
        lower, lengths: of the box that the cells divide, as large as the domain or smaller. Particles beyond it
            belong to cells in it: across the rows as if the box were repeated, along them and in domains that are far
            longer (`repeats`) to the outermost ones. Their neighbors are found too, among candidates from both places.
    """

    domain: Domain
    reach: float
    cells: tuple[int, ...]
    spans: tuple[int, ...]
    along: int
    lower: tuple[float, ...]
    lengths: tuple[float, ...]

    @classmethod
    def covering(
        cls, domain: Domain, reach: float | int, fineness: tuple[int, int] = (2, 4), box: Box | None = None
    ) -> CellGrid:
        """The grid whose cells measure at least reach / fineness, across and along the rows.

        box: lower and upper corner of where particles are expected; None is the whole domain, as is always the case
        along periodic axes.

        Raises ValueError if a periodic axis is shorter than twice the reach, where a particle would meet two
        images of the same neighbor.
        """
        for axis, length in enumerate(domain.lengths):
            if domain.periodic[axis] and length < 2 * reach:
                raise ValueError(
                    f"the support radius is too large for the box: cutoff + skin = {reach:.6g} m, but along the "
                    f"periodic axis {axis} the domain is {length:.6g} m long and must be at least twice that, "
                    f"{2 * reach:.6g} m; lengthen the domain, or reduce the particle spacing or the skin"
                )
        # A periodic row has a second range for each particle, a free one does not; prefer a free axis, the last one.
        along = max(range(domain.dimension), key=lambda axis: (not domain.periodic[axis], axis))
        lower, lengths = _within(domain, reach, box)
        across, lengthwise = fineness
        while True:
            spans = tuple(lengthwise if axis == along else across for axis in range(domain.dimension))
            cells = tuple(_cells_of_axis(length, reach / span) for length, span in zip(lengths, spans, strict=True))
            if math.prod(cells) <= CELLS_AT_MOST:
                return cls(domain, reach, cells, spans, along, lower, lengths)
            if across > 1 or lengthwise > 1:
                across, lengthwise = max(across // 2, 1), max(lengthwise // 2, 1)
            else:
                return cls(domain, reach, _coarsened(cells), spans, along, lower, lengths)

    @property
    def number_of_cells(self) -> int:
        """Number of all cells."""
        return math.prod(self.cells)

    @property
    def across(self) -> tuple[int, ...]:
        """The axes across the rows."""
        return tuple(axis for axis in range(self.domain.dimension) if axis != self.along)

    def repeats(self, axis: int) -> bool:
        """Whether the box is repeated along a free axis: water that has left it is not all in one cell then."""
        beyond = self.lengths[axis] < self.domain.lengths[axis] <= REPEATED * self.lengths[axis]
        return beyond and not self.domain.periodic[axis]

    def closes(self, axis: int) -> bool:
        """Whether the last row of cells across an axis is beside the first one."""
        return self.domain.periodic[axis] or (axis != self.along and self.repeats(axis))

    @property
    def goes_round(self) -> bool:
        """Whether a particle's candidates in a row can be two ranges, one at each end of a periodic row."""
        return self.domain.periodic[self.along] and 2 * self.spans[self.along] + 1 < self.cells[self.along]

    @property
    def row_offsets(self) -> tuple[tuple[int, ...], ...]:
        """Steps across to every row that can hold candidates."""
        steps = []
        for axis in self.across:
            span, cells = self.spans[axis], self.cells[axis]
            if self.closes(axis) and 2 * span + 1 >= cells:
                steps.append(range(cells))  # every cell is near, each must come once
            else:
                steps.append(range(-min(span, cells - 1), min(span, cells - 1) + 1))
        return tuple(itertools.product(*steps))

    def coordinates(self, positions: Float[Array, "d n"]) -> Int[Array, "d n"]:
        """Cell of each particle along each axis. Outside and NaN give some cell: `Domain.contains` tells them."""
        rows = []
        for axis, x in enumerate(self.domain.wrap(positions)):
            scaled = (x - self.lower[axis]) * (self.cells[axis] / self.lengths[axis])
            number = jnp.floor(scaled)
            if self.closes(axis):
                number = jnp.mod(number, self.cells[axis])
            clipped = jnp.clip(number, 0, self.cells[axis] - 1)  # before the conversion: it can overflow
            rows.append(jnp.clip(clipped.astype(jnp.int32), 0, self.cells[axis] - 1))
        return jnp.stack(rows)

    def number(self, coordinates: Int[Array, "d n"]) -> Int[Array, " n"]:
        """Number of a cell from its coordinates: consecutive along the rows."""
        row = self._row(tuple(coordinates[axis] for axis in self.across))
        return row * self.cells[self.along] + coordinates[self.along]

    def number_or_none(self, positions: Float[Array, "d n"]) -> Int[Array, " n"]:
        """Number of each particle's cell; beyond all of them for a position that is NaN."""
        return jnp.where(jnp.isnan(positions[0]), self.number_of_cells, self.number(self.coordinates(positions)))

    def starts(self, sorted_numbers: Int[Array, " n"]) -> Int[Array, " cells_and_more"]:
        """First particle of each cell among particles sorted by cell; behind the last cell, how many are in one."""
        whole = BLOCK**3  # blocks, of which none is cut short: a fifth of the time
        counts = jnp.zeros(-(-(self.number_of_cells + 2) // whole) * whole, jnp.int32)
        counts = counts.at[sorted_numbers + 1].add(1, mode="promise_in_bounds", indices_are_sorted=True)
        return cumulative_sum(counts)

    def any_near(self, positions: Float[Array, "d n"], others: Float[Array, "d m"]) -> Bool[Array, " n"]:
        """Whether there are others in the cells around each particle: no neighbor has a particle for which not."""
        taken = jnp.zeros(self.number_of_cells + 1, bool).at[self.number_or_none(others)].set(True)
        order = (*self.across, self.along)
        near = taken[:-1].reshape([self.cells[axis] for axis in order])
        for place, axis in enumerate(order):
            near = _dilated(near, place, self.spans[axis], periodic=self.closes(axis))
        return near.reshape(-1).at[self.number(self.coordinates(positions))].get(mode="promise_in_bounds")

    def ranges(self, coordinates: Int[Array, "d n"], starts: Int[Array, " cells_and_one"]):
        """Candidate ranges [first, last) of particles in these cells: for each row nearby, and for its far end.

        Returns (first, last, first_round, last_round), each (rows, n); the last two are None unless `goes_round`.
        """
        n_along, span = self.cells[self.along], self.spans[self.along]
        c = coordinates[self.along]
        if self.domain.periodic[self.along] and not self.goes_round:
            low, high = jnp.zeros_like(c), jnp.full_like(c, n_along - 1)
        else:
            low, high = jnp.maximum(c - span, 0), jnp.minimum(c + span, n_along - 1)
        pieces = [(low, high + 1)]
        if self.goes_round:
            below, above = c < span, c > n_along - 1 - span
            pieces.append(
                (
                    jnp.where(below, c - span + n_along, 0),
                    jnp.where(below, n_along, jnp.where(above, c + span + 1 - n_along, 0)),
                )
            )
        row, exists = self._rows_nearby(coordinates)
        found = []
        for low, high in pieces:
            first = starts.at[row * n_along + low].get(mode="promise_in_bounds")
            last = starts.at[row * n_along + high].get(mode="promise_in_bounds")
            found += [first, jnp.where(exists, last, first)]
        return tuple(found) if self.goes_round else (*found, None, None)

    def _row(self, across):
        row = jnp.zeros_like(across[0])
        for axis, coordinate in zip(self.across, across, strict=True):
            row = row * self.cells[axis] + coordinate
        return row

    def _rows_nearby(self, coordinates):
        """Numbers of the rows nearby (rows, n), and whether each exists; if not, some row in its place."""
        steps = np.asarray(self.row_offsets, np.int32)
        across, exists = [], True
        for number, axis in enumerate(self.across):
            cells = self.cells[axis]
            c = coordinates[axis] + steps[:, number, None]
            if self.closes(axis):
                c = jnp.where(c < 0, c + cells, jnp.where(c >= cells, c - cells, c))
            else:
                exists &= (c >= 0) & (c < cells)
                c = jnp.clip(c, 0, cells - 1)
            across.append(c)
        return self._row(across), exists


def cumulative_sum(counts: Int[Array, " n"]) -> Int[Array, " n"]:
    """What `jnp.cumsum` gives, in blocks whose sums are added up likewise.

    Compiled in a quarter of the time of an associative scan, which is some 30 small programs, and quicker. What is left
    over when blocks are full is added up apart: filled up with zeros, arrays take several times as long.
    """
    n = counts.shape[0]
    n_blocks = n // BLOCK
    if n_blocks < 1:
        return _added_up(counts[None])[0]
    within = _added_up(counts[: n_blocks * BLOCK].reshape(n_blocks, BLOCK))
    totals = within[:, -1]
    up_to = cumulative_sum(totals) if n_blocks > 1 else totals
    within = (within + (up_to - totals)[:, None]).reshape(-1)
    rest = counts[n_blocks * BLOCK :]
    return jnp.concatenate([within, up_to[-1] + _added_up(rest[None])[0]]) if len(rest) else within


def _added_up(blocks):
    """Sums of the first numbers of each block (blocks, n), up to each."""
    n = blocks.shape[1]
    return jnp.sum(jnp.where(jnp.triu(jnp.ones((n, n), bool)), blocks[:, :, None], 0), axis=1, dtype=blocks.dtype)


def _dilated(flags, axis, span, *, periodic):
    """Flags that are set where one is set within so many cells along an axis."""
    n = flags.shape[axis]
    if periodic:
        return jnp.any(jnp.stack([jnp.roll(flags, step, axis) for step in range(-span, span + 1)]), axis=0)
    widths = [(span, span) if other == axis else (0, 0) for other in range(flags.ndim)]
    padded = jnp.pad(flags, widths)
    parts = [jax.lax.slice_in_dim(padded, step, step + n, axis=axis) for step in range(2 * span + 1)]
    return jnp.any(jnp.stack(parts), axis=0)


def cell_order(grid: CellGrid, positions: Float[Array, "d n"]) -> Int[Array, " n"]:
    """The permutation that sorts particles by cell; particles of one cell keep their order."""
    return order_by(grid.number_or_none(positions), grid.number_of_cells.bit_length())


def order_by(numbers: Int[Array, " n"], bits: int) -> Int[Array, " n"]:
    """The permutation that sorts by whole numbers of so many bits, none negative; what is equal keeps its order.

    XLA sorts a single array of integers four to seven times faster than keys with a payload. So the number and the
    place are packed into one 32-bit key, and if they do not fit, it is sorted digit by digit.
    """
    n = numbers.shape[0]
    place_bits = max((n - 1).bit_length(), 1)
    digit_bits = 32 - place_bits
    lanes = jnp.arange(n, dtype=jnp.uint32)
    permutation = jnp.arange(n, dtype=jnp.int32)
    left = numbers.astype(jnp.uint32)
    for shift in range(0, max(bits, 1), digit_bits):
        digit = (left >> shift) & jnp.uint32(2**digit_bits - 1)
        key = jax.lax.sort((digit << place_bits) | lanes)
        taken = (key & jnp.uint32(2**place_bits - 1)).astype(jnp.int32)
        permutation = permutation.at[taken].get(mode="promise_in_bounds")
        left = left.at[taken].get(mode="promise_in_bounds")
    return permutation


def _within(domain: Domain, reach: float, box: Box | None):
    """Lower corner and lengths of a box, within the domain; along periodic axes those of the domain."""
    lower, lengths = list(domain.lower), list(domain.lengths)
    for axis in range(domain.dimension):
        if box is not None and not domain.periodic[axis]:
            low, high = box[0][axis] - MARGIN * reach, box[1][axis] + MARGIN * reach
            low, high = max(low, domain.lower[axis]), min(high, domain.upper[axis])
            lower[axis], lengths[axis] = low, max(high - low, reach)
    return tuple(lower), tuple(lengths)


def _cells_of_axis(length: float, smallest: float) -> int:
    # The margin covers the rounding of cell coordinates in float32, so that a pair within reach is never one
    # cell further apart than the reach spans.
    ratio = length / smallest
    return max(int(ratio / (1.0 + 2e-6 * ratio)), 1)


def _coarsened(cells: tuple[int, ...]) -> tuple[int, ...]:
    coarse = list(cells)
    while math.prod(coarse) > CELLS_AT_MOST:
        longest = max(range(len(coarse)), key=lambda axis: coarse[axis])
        coarse[longest] = (coarse[longest] + 1) // 2
    return tuple(coarse)
