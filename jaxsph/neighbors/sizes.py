"""How large the arrays of a search must be, counted outside of JAX: nothing is compiled for it."""

from __future__ import annotations

import numpy as np

from jaxsph.neighbors.cells import CellGrid

ROUNDING = 1e-6  # of the reach: distances in float32 may come out shorter


def most_neighbors(grid: CellGrid, receivers, senders=None) -> int:
    """Most senders within reach of a receiver; both (d, N) [m] within the domain; senders None is the same set."""
    from scipy.spatial import KDTree  # .8 s to import

    own, period = grid.domain.for_tree(receivers.T)
    tree = KDTree(own if senders is None else grid.domain.for_tree(senders.T)[0], boxsize=period)
    count = tree.query_ball_point(own, grid.reach * (1 + ROUNDING), return_length=True, workers=-1)
    return int(np.max(count)) - (senders is None)


def widest_ranges(grid: CellGrid, receivers, senders) -> tuple[int, int]:
    """Most candidates of a receiver in one row of cells, and at the far end of a periodic row."""
    widths: dict[int, int] = {}
    for k, width in _widths(grid, receivers, senders):
        widths[k] = max(widths.get(k, 0), int(np.max(width)))
    return widths[0], max((width for k, width in widths.items() if k), default=0)


def number_near(grid: CellGrid, receivers, senders) -> int:
    """How many receivers have senders in the cells around them, as `CellGrid.any_near`."""
    near = np.zeros(receivers.shape[1], bool)
    for _, width in _widths(grid, receivers, senders):
        near |= width > 0
    return int(np.sum(near))


def _widths(grid, receivers, senders):
    """By row of cells nearby the number of candidates (N,), with 0 for the row and 1, 2 for its far ends."""
    n_along, span = grid.cells[grid.along], grid.spans[grid.along]
    across, along = _coordinates(grid, senders)
    count = np.bincount(_row(grid, across) * n_along + along, minlength=grid.number_of_cells)
    starts = np.concatenate([[0], np.cumsum(count)])
    across, along = _coordinates(grid, receivers)
    if grid.domain.periodic[grid.along] and not grid.goes_round:
        pieces = [(np.zeros_like(along), np.full_like(along, n_along))]
    else:
        pieces = [(np.maximum(along - span, 0), np.minimum(along + span + 1, n_along))]
    if grid.goes_round:
        pieces.append((np.where(along < span, along - span + n_along, n_along), np.full_like(along, n_along)))
        pieces.append((np.zeros_like(along), np.maximum(along + span + 1 - n_along, 0)))
    for steps in grid.row_offsets:
        shifted, exists = [], np.ones_like(along, bool)
        for coordinate, step, axis in zip(across, steps, grid.across, strict=True):
            cells, moved = grid.cells[axis], coordinate + step
            if not grid.closes(axis):
                exists &= (moved >= 0) & (moved < cells)
            shifted.append(moved % cells)
        row = _row(grid, shifted) * n_along
        for k, (first, last) in enumerate(pieces):
            yield k, (starts[row + last] - starts[row + first]) * exists


def _wrapped(grid, positions):
    positions = np.array(positions, np.float64)
    for axis, (low, length) in enumerate(zip(grid.domain.lower, grid.domain.lengths, strict=True)):
        if grid.domain.periodic[axis]:
            positions[axis] = low + np.mod(positions[axis] - low, length)
            positions[axis][positions[axis] >= low + length] = low  # rounded up
    return positions


def _coordinates(grid, positions):
    """Cells across (a list, one array for each axis) and along the rows."""
    rows = []
    # in their own precision, so that rounding puts nobody into another cell than `CellGrid.coordinates` does
    for axis, x in enumerate(_wrapped(grid, positions).astype(positions.dtype)):
        number = np.floor((x - grid.lower[axis]) * (grid.cells[axis] / grid.lengths[axis]))
        if grid.closes(axis):
            number = np.mod(number, grid.cells[axis])
        rows.append(np.clip(number, 0, grid.cells[axis] - 1).astype(np.int64))
    return [rows[axis] for axis in grid.across], rows[grid.along]


def _row(grid, across):
    row = np.zeros_like(across[0])
    for axis, coordinate in zip(grid.across, across, strict=True):
        row = row * grid.cells[axis] + coordinate
    return row
