"""Allocate and update neighbor lists."""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int

from jaxsph.neighbors import jax_md
from jaxsph.neighbors.cells import Box, CellGrid, cell_order
from jaxsph.neighbors.domain import Domain
from jaxsph.neighbors.filling import noted_outside, rebuilt
from jaxsph.neighbors.lists import NeighborList, raise_if_wrong, require_senders
from jaxsph.neighbors.search import Capacity
from jaxsph.neighbors.sizes import most_neighbors, number_near, widest_ranges
from jaxsph.pytree import is_concrete, replace

BUILDERS = ("cells", "jax-md")
SPARE_ROWS = 32  # of a list of two sets whose rows are for particles near the other set
EVERY_ROW = 4096
"""So few particles all get a row: one not in use takes next to no time, and to make room later is to compile again, as
long as thousands of steps of a dam break. With 16,384 its steps take a twelfth longer."""


@dataclasses.dataclass(frozen=True)
class NeighborSearch:
    """How neighbors are searched; made by `neighbor_list`. Hashable, holds no arrays."""

    domain: Domain
    cutoff: float
    skin: float
    capacity_multiplier: float
    builder: str
    grid: CellGrid

    def allocate(
        self, positions: ArrayLike, senders: ArrayLike | None = None, *, near_only: bool = False
    ) -> NeighborList:
        """Build a list and choose the sizes of its arrays from the data. Outside jit.

        Args:
            positions: of the receivers, component first (d, N) [m].
            senders: of the second set (d, M); None for the neighbors of a set in itself, itself excluded.
            near_only: of two sets, give rows only to particles near the other one: what takes time and memory for
                all of a fluid otherwise, though few of it are near a wall.

        Raises:
            ValueError: wrong shapes or types, no particles, or called inside jit.
            ParticleOutside: a particle beyond a free boundary, or a position that is NaN.
        """
        neighbors = self.template(positions, senders, near_only=near_only)
        positions = self._checked(positions, "positions")
        senders = None if senders is None else self._checked(senders, "senders", positions.dtype)
        if self.builder == "jax-md":
            return jax_md.allocate(self, neighbors, positions)
        return rebuilt(self.grid, False, neighbors, positions, senders)

    def template(
        self,
        positions: ArrayLike,
        senders: ArrayLike | None = None,
        *,
        near_only: bool = False,
        crowd: np.ndarray | None = None,
    ) -> NeighborList:
        """An empty list with the sizes of `allocate`, to be filled by `update`. Outside jit; compiles nothing.

        Arguments and errors as of `allocate`. crowd: where receivers may come to be around the senders (d, M) [m], for
        all of which there is room at once.
        """
        if not is_concrete(positions, senders):
            raise ValueError(
                "allocate chooses array sizes from the positions and cannot run inside jit, grad or vmap; "
                "allocate before, and call update(positions, neighbors) inside"
            )
        positions = self._checked(positions, "positions")
        senders = None if senders is None else self._checked(senders, "senders", positions.dtype)
        # Sizes chosen for particles outside would be meaningless, so the sets are looked at first.
        blank = self._blank(positions, senders, Capacity(1, 1, 1))
        raise_if_wrong(noted_outside(blank, positions, senders, np))
        if self.builder == "jax-md":
            return blank
        if senders is None:
            return self._blank(positions, None, self._capacity(positions, None, False))
        forward, back = self._capacity(positions, senders, near_only), self._capacity(senders, positions, near_only)
        if crowd is not None:
            forward = _larger(forward, self._capacity(crowd, senders, near_only), positions.shape[1])
            back = _larger(back, self._capacity(senders, crowd, near_only), senders.shape[1])
        neighbors = self._blank(positions, None, forward)
        return replace(neighbors, transpose=self._blank(senders, None, back))

    def update(
        self,
        positions: ArrayLike,
        neighbors: NeighborList,
        senders: ArrayLike | None = None,
        in_cell_order: bool = False,
    ) -> NeighborList:
        """Build the list again for new positions, with the arrays' sizes as they are. Works inside jit.

        It always rebuilds: whether that is needed is `is_valid`'s answer. Derivatives with respect to positions
        stop here.

        Args:
            positions: of the receivers (d, N) [m].
            neighbors: a list of the same number of particles.
            senders: of the second set (d, M), if the list has one.
            in_cell_order: promise that the particles (of both sets) have been permuted with `sort`, which
                makes the search faster. A broken promise is flagged.

        Returns:
            The list. Its flags are those of this build and of all before it.

        Raises:
            ValueError: shapes, types or number of sets that do not fit the list.
        """
        require_senders(neighbors.transpose is not None, senders)
        if neighbors.grid != self.grid or neighbors.builder != self.builder:
            raise ValueError(
                f"the list was built with cutoff={neighbors.cutoff}, skin={neighbors.skin}, "
                f"builder={neighbors.builder!r} in {neighbors.grid.domain}, not with cutoff={self.cutoff}, "
                f"skin={self.skin}, builder={self.builder!r} in {self.domain}; allocate a list with this search"
            )
        positions = self._checked(positions, "positions", neighbors.reference.dtype, neighbors.reference.shape)
        if senders is not None:
            like = neighbors.transpose.reference  # type: ignore[union-attr]
            senders = self._checked(senders, "senders", like.dtype, like.shape)
        positions, senders = jax.lax.stop_gradient((positions, senders))
        if self.builder == "jax-md":
            return jax_md.update(self, noted_outside(neighbors, positions, senders, jnp), positions)
        return rebuilt(self.grid, in_cell_order, neighbors, positions, senders)

    def sort(self, positions: ArrayLike) -> Int[Array, " n"]:
        """The permutation that puts particles in cell order. Works inside jit.

        Particles that are near each other in space are then near each other in memory, which makes the search and
        everything that gathers from neighbors faster. Permute all fields of a set with it, its identities too:
        `identity = identity[permutation]`; the caller's order comes back with `field.at[identity].set(sorted)`.
        """
        return cell_order(self.grid, self._checked(positions, "positions"))

    def _checked(self, positions, name, dtype=None, shape=None):
        positions = jnp.asarray(positions)
        if not jnp.issubdtype(positions.dtype, jnp.floating):
            raise ValueError(f"{name} must be real numbers, got {positions.dtype}")
        if positions.ndim != 2 or positions.shape[0] != self.domain.dimension or positions.shape[1] == 0:
            raise ValueError(
                f"{name} has shape {positions.shape}; it must be component first, ({self.domain.dimension}, N) with "
                "at least one particle"
            )
        if (dtype is not None and positions.dtype != dtype) or (shape is not None and positions.shape != shape):
            raise ValueError(
                f"{name} is {positions.dtype} of shape {positions.shape}; expected {dtype}"
                + (f" of shape {shape}, as in the list; allocate a new list if the set changed" if shape else "")
            )
        return positions

    def _capacity(self, receivers, senders, near_only: bool) -> Capacity:
        """Sizes for these positions with the reserve."""
        receivers = np.asarray(receivers)
        most = most_neighbors(self.grid, receivers, senders)
        width, width_round = widest_ranges(self.grid, receivers, receivers if senders is None else senders)
        n_senders = receivers.shape[1] if senders is None else senders.shape[1]
        if near_only:
            # Sets that are apart now will meet: then a particle sees half of what the other set's see of each other.
            others = np.asarray(senders)
            most = max(most, math.ceil(0.5 * most_neighbors(self.grid, others)))
            width, width_round = np.maximum((width, width_round), widest_ranges(self.grid, others, others))

        def reserve(needed, limit):
            return max(min(math.ceil(needed * self.capacity_multiplier), limit), 1)

        return Capacity(
            reserve(most, n_senders - 1 if senders is None else n_senders),
            reserve(width, n_senders),
            # Half of a range can lie at the far end, also if there are no particles yet.
            reserve(max(width_round, width // 2), n_senders) if self.grid.goes_round else 0,
            self._rows(receivers, senders) if near_only else None,
        )

    def _rows(self, receivers, senders) -> int:
        """How many particles get a row: those near now with the reserve, and what can come near, up to half of all.

        In small sets all: water that spreads wets a large part of the walls.
        """
        n = receivers.shape[1]
        if n <= EVERY_ROW:
            return n
        near = number_near(self.grid, receivers, senders)
        return min(n, max(math.ceil(near * self.capacity_multiplier), min(senders.shape[1], n // 2)) + SPARE_ROWS)

    def _blank(self, positions, senders, capacity: Capacity) -> NeighborList:
        """A list of these sizes, still empty. Made with NumPy: nothing to compile."""
        n = positions.shape[1]
        rows = n if capacity.members is None else capacity.members
        arrays = {
            "indices": np.zeros((capacity.slots, rows), np.int32),
            "count": np.zeros(rows, np.int32),
            "needed_members": np.int32(0),
            "needed_slots": np.int32(0),
            "needed_range": np.zeros(2, np.int32),
            "outside": np.int32(-1),
            "outside_position": np.zeros(positions.shape[0], positions.dtype),
            "out_of_order": np.asarray(False),
        }
        if capacity.members is not None:
            arrays |= {"members": np.full(rows, n, np.int32), "place": np.full(n, rows, np.int32)}
        return NeighborList(
            transpose=None if senders is None else self._blank(senders, None, capacity),
            reference=positions,
            grid=self.grid,
            cutoff=self.cutoff,
            skin=self.skin,
            capacity=capacity,
            builder=self.builder,
            **{"members": None, "place": None, **{name: jnp.asarray(value) for name, value in arrays.items()}},
        )


def neighbor_list(
    domain: Domain,
    cutoff: float | int,
    skin: float | int = 0.0,
    capacity_multiplier: float | int = 1.25,
    builder: str = "cells",
    box: Box | None = None,
) -> NeighborSearch:
    """Neighbor search in a domain, after the conventions of jax-md's `partition.neighbor_list`.

    Args:
        domain: the box.
        cutoff: distance up to which pairs interact, the support radius of the kernel [m].
        skin: additional distance [m] (jax-md's `dr_threshold`). The list holds the pairs closer than
            cutoff + skin and stays valid while twice the largest displacement is below the skin.
        capacity_multiplier: arrays are made larger by this factor than the data need at allocation.
        builder: "cells", or "jax-md" (slower; one set only; needs the extra `jax-md`).
        box: lower and upper corner (d,) of where most particles will be, if that is much less than the domain. The
            search takes time and memory for it, and finds neighbors beyond it too.

    Returns:
        A `NeighborSearch` with the functions `allocate`, `update` and `sort`.

    Raises:
        ValueError: cutoff not positive, skin negative, multiplier below 1, unknown builder, or a periodic axis
            shorter than twice cutoff + skin.
        ImportError: builder "jax-md" without jax-md.
    """
    if not (cutoff > 0 and math.isfinite(cutoff)):
        raise ValueError(f"cutoff={cutoff} must be positive and finite [m]")
    if not (skin >= 0 and math.isfinite(skin)):
        raise ValueError(f"skin={skin} must be finite and not negative [m]")
    if not (capacity_multiplier >= 1 and math.isfinite(capacity_multiplier)):
        raise ValueError(f"capacity_multiplier={capacity_multiplier} must be at least 1")
    if builder not in BUILDERS:
        raise ValueError(f"builder={builder!r} is not known; choose one of {BUILDERS}")
    if builder == "jax-md":
        jax_md.load()
    cutoff, skin = float(cutoff), float(skin)
    grid = CellGrid.covering(domain, cutoff + skin, box=box)
    return NeighborSearch(domain, cutoff, skin, float(capacity_multiplier), builder, grid)


def search_of(neighbors: NeighborList) -> NeighborSearch:
    """The search that a list was made with; what it allocates has no reserve."""
    grid = neighbors.grid
    return NeighborSearch(grid.domain, neighbors.cutoff, neighbors.skin, 1.0, neighbors.builder, grid)


def _larger(a: Capacity, b: Capacity, n_receivers: int) -> Capacity:
    """Sizes that suffice for both, of lists of so many receivers."""
    members = None if a.members is None or b.members is None else min(max(a.members, b.members), n_receivers)
    return Capacity(max(a.slots, b.slots), max(a.range, b.range), max(a.range_round, b.range_round), members)
