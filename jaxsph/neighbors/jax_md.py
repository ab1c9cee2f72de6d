"""jax-md's neighbor lists: its builder as a choice, and conversion of lists in both directions.

jax-md is an optional extra, loaded when it is first needed. Importing the whole package takes ten seconds and
imports its neural networks; `partition` and `space` take a tenth of a second, so only those are loaded.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import math
import sys
import types
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from jaxsph.neighbors.cells import CellGrid
from jaxsph.neighbors.domain import Domain
from jaxsph.neighbors.lists import NeighborList
from jaxsph.neighbors.search import Capacity
from jaxsph.neighbors.sizes import widest_ranges
from jaxsph.pytree import replace

if TYPE_CHECKING:
    from jaxsph.neighbors.build import NeighborSearch


@functools.cache
def load() -> types.ModuleType:
    """jax-md's module `partition`.

    Raises ImportError, with what to install, if jax-md is missing.
    """
    if "jax_md" in sys.modules:
        return importlib.import_module("jax_md.partition")
    found = importlib.util.find_spec("jax_md")
    if found is None or found.submodule_search_locations is None:
        raise ImportError('jax-md is not installed; install it with: pip install "jaxsph[jax-md]"')
    # A package without its __init__ lets the two modules be imported alone. It is taken away again, so that a
    # later `import jax_md` gets the whole package (with these two modules in it).
    package = types.ModuleType("jax_md")
    package.__path__ = list(found.submodule_search_locations)
    sys.modules["jax_md"] = package
    try:
        return importlib.import_module("jax_md.partition")
    except ImportError as error:
        raise ImportError(
            f'jax-md is installed but cannot be loaded ({error}); install it with: pip install "jaxsph[jax-md]"'
        ) from error
    finally:
        del sys.modules["jax_md"]


def allocate(search: NeighborSearch, blank: NeighborList, positions) -> NeighborList:
    """Build a list with jax-md and choose its sizes."""
    if blank.transpose is not None:
        raise ValueError('jax-md has no lists between two sets of particles; use builder="cells"')
    built = _functions(search.domain, search.cutoff + search.skin, 0.0, search.capacity_multiplier).allocate(
        _from_origin(search.domain, positions)
    )
    # jax-md has one number for cells; it stands where the widest range stands in a list of ours.
    blank = replace(blank, capacity=Capacity(built.max_occupancy, built.cell_list_capacity or 0, 0))
    return _taken_over(blank, built, positions)


def update(search: NeighborSearch, neighbors: NeighborList, positions) -> NeighborList:
    """Build the list again with jax-md, with the same sizes."""
    capacity = neighbors.capacity
    functions = _functions(search.domain, search.cutoff + search.skin, 0.0, search.capacity_multiplier)
    shifted = _from_origin(search.domain, positions)
    like = _as_jax_md(functions, neighbors, shifted, search.cutoff + search.skin, capacity.range)
    return _taken_over(neighbors, functions.update(shifted, like), positions)


def to_jax_md(neighbors: NeighborList, capacity_multiplier: float = 1.25) -> Any:
    """Convert a list of one set to jax-md's `NeighborList`, format Dense: `idx` (N, K), empty slots N.

    Its positions count from the lower corner of the domain, because jax-md's boxes begin at the origin: give
    its `update` positions (N, d) minus `domain.lower`. Outside jit.

    Raises:
        ValueError: a list between two sets, which jax-md does not have.
        ImportError: jax-md is missing.
    """
    if neighbors.transpose is not None:
        raise ValueError("jax-md has no lists between two sets of particles")
    partition = load()
    domain, reach = neighbors.grid.domain, neighbors.cutoff + neighbors.skin
    functions = _functions(domain, neighbors.cutoff, neighbors.skin, capacity_multiplier)
    shifted = _from_origin(domain, neighbors.reference)
    cells = _cell_list(domain, reach, capacity_multiplier)
    cell_capacity = 0 if cells is None else cells.allocate(shifted).cell_capacity
    overflow = jnp.where(neighbors.did_buffer_overflow, partition.PEC.NEIGHBOR_LIST_OVERFLOW, 0).astype(jnp.uint8)
    return _as_jax_md(functions, neighbors, shifted, reach, cell_capacity, overflow)


def from_jax_md(neighbors: Any, domain: Domain, cutoff: float | int, skin: float | int = 0.0) -> NeighborList:
    """Convert a list of jax-md, format Dense, to ours. Outside jit.

    Args:
        neighbors: jax-md's list, its positions counted from the lower corner of the domain.
        domain: the box.
        cutoff: the `r_cutoff` of that list [m].
        skin: its `dr_threshold` [m].

    Raises ValueError for a sparse list, whose shape is not that of an index per slot.
    """
    index = np.asarray(neighbors.idx)
    n = neighbors.reference_position.shape[0]
    if index.ndim != 2 or index.shape[0] != n or getattr(neighbors.format, "name", "Dense") != "Dense":
        raise ValueError(
            f"only lists of jax-md's format Dense, idx (N, K), can be converted; this is {neighbors.format} "
            f"with idx of shape {index.shape} for {n} particles"
        )
    grid = CellGrid.covering(domain, float(cutoff) + float(skin))
    lower = jnp.asarray(domain.lower, neighbors.reference_position.dtype)
    positions = (jnp.asarray(neighbors.reference_position) + lower).T
    widths = widest_ranges(grid, positions, positions)
    capacity = Capacity(index.shape[1], *(math.ceil(1.25 * width) for width in widths))
    blank = NeighborList(
        indices=jnp.zeros((index.shape[1], n), jnp.int32),
        count=jnp.zeros(n, jnp.int32),
        transpose=None,
        reference=positions,
        needed_slots=jnp.int32(0),
        needed_range=jnp.asarray(widths, jnp.int32),
        outside=jnp.int32(-1),
        outside_position=jnp.zeros(domain.dimension, positions.dtype),
        out_of_order=jnp.asarray(False),
        members=None,
        place=None,
        needed_members=jnp.int32(0),
        grid=grid,
        cutoff=float(cutoff),
        skin=float(skin),
        capacity=capacity,
    )
    return _taken_over(blank, neighbors, positions)


def _taken_over(neighbors: NeighborList, built, positions) -> NeighborList:
    """Indices and flags of a list of jax-md. It does not count beyond its slots: needed is at least one more."""
    partition = load()
    slots, n = neighbors.capacity.slots, positions.shape[1]
    index = built.idx.T.astype(jnp.int32)
    valid = index < n
    order = jnp.argsort(~valid, axis=0, stable=True)  # custom masks leave empty slots in between
    index, valid = jnp.take_along_axis(index, order, 0), jnp.take_along_axis(valid, order, 0)
    count = jnp.sum(valid, axis=0, dtype=jnp.int32)
    cell_overflow = (built.error.code & partition.PEC.CELL_LIST_OVERFLOW) != 0
    slot_overflow = (built.error.code & partition.PEC.NEIGHBOR_LIST_OVERFLOW) != 0
    needed_range = jnp.where(cell_overflow, neighbors.capacity.range + 1, neighbors.needed_range[0])
    needed_slots = jnp.where(slot_overflow, slots + 1, jnp.max(count))
    return replace(
        neighbors,
        indices=jnp.where(valid, index, jnp.arange(n, dtype=jnp.int32)),
        count=count,
        reference=positions,
        needed_slots=jnp.maximum(neighbors.needed_slots, needed_slots.astype(jnp.int32)),
        needed_range=jnp.stack([needed_range.astype(jnp.int32), neighbors.needed_range[1]]),
    )


def _as_jax_md(functions, neighbors, shifted, reach, cell_capacity, error: Any = 0):
    partition = load()
    n, slots = shifted.shape[0], neighbors.indices.shape[0]
    filled = jnp.arange(slots)[:, None] < neighbors.count
    cells = _cell_list(neighbors.grid.domain, reach, functions.multiplier)
    return partition.NeighborList(
        jnp.where(filled, neighbors.indices, n).T,
        shifted,
        partition.PartitionError(jnp.asarray(error, jnp.uint8)),
        None if cells is None else cell_capacity,
        slots,
        partition.NeighborListFormat.Dense,
        reach,
        cells,
        functions.update,
    )


class _Functions:
    """jax-md's allocate and update, and the multiplier with which its cells are made."""

    def __init__(self, functions, multiplier):
        self.allocate, self.update, self.multiplier = functions.allocate, functions.update, multiplier


@functools.cache
def _functions(domain: Domain, cutoff: float, skin: float, multiplier: float) -> _Functions:
    partition = load()
    box = np.asarray(domain.lengths)
    return _Functions(
        partition.neighbor_list(
            _displacement(domain), box, cutoff, skin, multiplier, format=partition.NeighborListFormat.Dense
        ),
        multiplier,
    )


def _displacement(domain: Domain):
    """The displacement as jax-md calls it: it passes keywords, and tries the number of axes from one upwards."""

    def displacement(a, b, **_):
        if a.shape != (domain.dimension,):
            raise ValueError(f"positions of shape {a.shape} in a domain of {domain.dimension} axes")
        return domain.displacement(a, b)

    return displacement


@functools.cache
def _cell_list(domain: Domain, reach: float, multiplier: float):
    """jax-md's cells, or None where it compares all pairs: an axis of fewer than three cells."""
    if any(reach >= length / 3.0 for length in domain.lengths):
        return None
    return load().cell_list(np.asarray(domain.lengths), reach, multiplier)


def _from_origin(domain: Domain, positions):
    lower = jnp.asarray(domain.lower, positions.dtype)
    return domain.wrap(positions).T - lower
