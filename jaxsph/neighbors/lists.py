"""The neighbor list, and what it reports: overflow, particles outside, use beyond its skin."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxsph.errors import NeighborOverflow, ParticleOutside, SkinExceeded
from jaxsph.neighbors.cells import CellGrid
from jaxsph.neighbors.search import Capacity
from jaxsph.pytree import pytree_dataclass, replace, static


@pytree_dataclass
class NeighborList:
    """Who is near whom: for each receiver the senders closer than cutoff + skin when the list was built.

    Made by `neighbor_list(...).allocate`. It stays right while particles have moved so little that nobody can
    have come closer than the cutoff unseen (`is_valid`). Flags are values, because nothing can be raised inside
    jit; `raise_if_wrong` turns them into errors. They are kept by `update`, so that a failure in a loop is
    still there after it.

    Attributes:
        indices: (K, N) index of the sender in each slot, valid slots first. Empty slots hold an index that
            exists: the receiver's own in a list of one set.
        count: (N,) number of valid slots.
        transpose: the list seen from the senders; None for one set, whose list is symmetric.
        reference: (d, N) positions of the receivers when the list was built [m].
        needed_slots: () most neighbors of any particle so far; more than K is an overflow.
        needed_range: (2,) most candidates in a range of cells so far, see `Capacity`.
        outside: () index of the first particle found outside the domain, -1 for none.
        outside_position: (d,) where it was [m].
        out_of_order: () whether particles promised in cell order were not.
        members: (M,) for two sets of which few are near each other: the receivers that have a row, that is a column of
            `indices`, which then counts the senders that have one. The rows that are left over hold N.
        place: (N,) the row of each receiver; M for none.
        needed_members: () most receivers near senders so far; more than M is an overflow.
        grid: cells of the search.
        cutoff: distance up to which pairs interact [m].
        skin: additional distance [m].
        capacity: sizes of the arrays.
        builder: which builder made it.
    """

    indices: Int[Array, "slots members"]
    count: Int[Array, " members"]
    transpose: NeighborList | None
    reference: Float[Array, "d receivers"]
    needed_slots: Int[Array, ""]
    needed_range: Int[Array, "2"]
    outside: Int[Array, ""]
    outside_position: Float[Array, " d"]
    out_of_order: Bool[Array, ""]
    members: Int[Array, " members"] | None
    place: Int[Array, " receivers"] | None
    needed_members: Int[Array, ""]
    grid: CellGrid = static()
    cutoff: float = static()
    skin: float = static()
    capacity: Capacity = static()
    builder: str = static(default="cells")

    @property
    def needed_and_room(self) -> list[tuple[Int[Array, ""], int]]:
        """Of each array of this list, not of the transpose, how much of it has been needed and how much there is."""
        sizes, (width, width_round) = self.capacity, self.needed_range
        pairs = [(self.needed_slots, sizes.slots), (width, sizes.range), (width_round, sizes.range_round)]
        return pairs if sizes.members is None else [*pairs, (self.needed_members, sizes.members)]

    @property
    def did_buffer_overflow(self) -> Bool[Array, ""]:
        """Whether neighbors or candidates did not fit, here or in the transpose; the list is then wrong."""
        overflow = jnp.any(jnp.stack([needed > room for needed, room in self.needed_and_room]))
        return overflow if self.transpose is None else overflow | self.transpose.did_buffer_overflow

    @property
    def used(self) -> Int[Array, ""] | None:
        """How many rows are in use, the first ones; None if all receivers have one."""
        if self.members is None:
            return None
        return jnp.max(jnp.where(self.count > 0, jnp.arange(1, self.count.shape[0] + 1, dtype=self.count.dtype), 0))

    @property
    def is_wrong(self) -> Bool[Array, ""]:
        """Whether the build failed in any way: overflow, a particle outside, particles out of order."""
        wrong = self.did_buffer_overflow | (self.outside >= 0) | self.out_of_order
        return wrong if self.transpose is None else wrong | self.transpose.is_wrong

    def transposed(self) -> NeighborList:
        """The list with receivers and senders exchanged."""
        if self.transpose is None:
            return self
        return replace(self.transpose, transpose=replace(self, transpose=None))


def moved(neighbors: NeighborList, positions, senders=None) -> Float[Array, ""]:
    """How much closer a pair can have come since the list was built [m]; NaN if a position is.

    Twice the largest displacement in one set; for two sets the sum of the largest of each. Positions are (d, N) in
    the order in which the list was built.

    Raises ValueError if senders are missing for a list of two sets, or given for a list of one.
    """
    require_senders(neighbors.transpose is not None, senders)
    largest = _largest_displacement(neighbors, positions)
    if neighbors.transpose is None:
        return 2.0 * largest
    return largest + _largest_displacement(neighbors.transpose, senders)


def is_valid(neighbors: NeighborList, positions, senders=None) -> Bool[Array, ""]:
    """Whether no pair can be closer than the cutoff without being in the list; False for NaN."""
    distance = moved(neighbors, positions, senders)
    return (distance < neighbors.skin) | (distance == 0)


def safe_steps(
    skin: float | int, time_step: float, max_speed: float | int, max_sender_speed: float | int | None = None
) -> int:
    """The number of steps for which a list stays valid if nobody is faster than given.

    Args:
        skin: of the list [m].
        time_step: [s].
        max_speed: largest speed of the receivers, a bound for all these steps [m/s].
        max_sender_speed: of the senders if they are another set.

    Returns the largest n with n * time_step * (both speeds) < skin; 0 if one step is too much already, and
    2**31 - 1 if nothing moves.

    Raises ValueError for a negative skin or speed, or a time step that is not positive.
    """
    both = 2.0 * max_speed if max_sender_speed is None else max_speed + max_sender_speed
    if not (skin >= 0 and time_step > 0 and both >= 0 and math.isfinite(both)):
        raise ValueError(
            f"skin={skin} and the speeds {max_speed}, {max_sender_speed} must be finite and not negative, and "
            f"time_step={time_step} positive"
        )
    most, closing = 2**31 - 1, both * time_step
    if closing * most < skin or closing == 0:
        return most
    steps = max(math.ceil(skin / closing) - 1, 0)
    # The quotient and the products may be rounded up, in whatever order they are formed.
    return steps if steps * closing < skin * (1 - 1e-12) else max(steps - 1, 0)


def raise_if_wrong(neighbors: NeighborList, positions=None, senders=None, name: str = "") -> None:
    """Raise what the flags of a list say. Outside jit only.

    Args:
        neighbors: the list.
        positions: current positions (d, N); given, the skin is checked too.
        senders: positions of the second set.
        name: of the list, for the message, such as "water-wall".

    Raises:
        NeighborOverflow: more neighbors or candidates than there is room for.
        ParticleOutside: a particle beyond a free boundary, or with a position that is NaN.
        SkinExceeded: particles have moved further than the skin allows.
        ValueError: particles promised in cell order were not.
    """
    of_list = f" of {name}" if name else ""
    # Outside first: such a particle makes the other numbers meaningless.
    sets = [neighbors] if neighbors.transpose is None else [neighbors, neighbors.transpose]
    for role, part in zip(("receiver", "sender"), sets, strict=False):
        kind = "particle" if len(sets) == 1 else role
        if int(part.outside) >= 0:
            raise ParticleOutside(_outside_message(part, kind, of_list))
    for part in sets:
        _raise_overflow(part, of_list)
    if any(bool(part.out_of_order) for part in sets):
        raise ValueError(
            f"the neighbor list{of_list} was updated with in_cell_order=True, but the particles were not in cell "
            "order; permute them with the order that sort(positions) gives first, or leave in_cell_order=False"
        )
    if positions is not None:
        distance = float(moved(neighbors, positions, senders))
        if not (distance < neighbors.skin or distance == 0):
            raise SkinExceeded(skin_message(distance, neighbors.skin, of_list))


def skin_message(distance: float, skin: float, of_list: str = "") -> str:
    """The sentence for a list used beyond its skin."""
    return (
        f"the neighbor list{of_list} is out of date: pairs can have come {distance:.6g} m closer since it was built, "
        f"its skin is {skin:.6g} m; rebuild it more often, or choose a larger skin or a smaller time step"
    )


def require_senders(two_sets: bool, senders) -> None:
    """Raise ValueError unless senders are given exactly for a list of two sets."""
    if two_sets and senders is None:
        raise ValueError("this neighbor list is of two sets; give the positions of its senders too")
    if not two_sets and senders is not None:
        raise ValueError("this neighbor list is of one set; do not give senders")


def _largest_displacement(neighbors, positions):
    displacement = neighbors.grid.domain.displacement(positions, neighbors.reference)
    return jnp.sqrt(jnp.max(jnp.sum(displacement * displacement, axis=0)))


def _raise_overflow(part, of_list):
    slots, widths = int(part.needed_slots), np.asarray(part.needed_range)
    capacity = part.capacity
    cure = "allocate the list again from these positions, or with a larger capacity_multiplier"
    if (widths > (capacity.range, capacity.range_round)).any():
        raise NeighborOverflow(
            f"a range of cells of the neighbor list{of_list} holds {int(widths[0])} candidates (at the far end of a "
            f"periodic row {int(widths[1])}); there is room for {capacity.range} ({capacity.range_round}). The "
            f"particles have come closer together; {cure}"
        )
    if capacity.members is not None and int(part.needed_members) > capacity.members:
        raise NeighborOverflow(
            f"{int(part.needed_members)} particles are near those of the other set, the neighbor list{of_list} has "
            f"{capacity.members} rows; {cure}"
        )
    if slots > capacity.slots:
        raise NeighborOverflow(
            f"a particle has {slots} neighbors, the neighbor list{of_list} has {capacity.slots} slots; {cure}"
        )


def _outside_message(part, kind, of_list):
    index, position = int(part.outside), np.asarray(jax.device_get(part.outside_position))
    domain = part.grid.domain
    where = ", ".join(f"{value:.6g}" for value in position)
    cure = (
        "the run became unstable before: take a smaller time step"
        if not np.isfinite(position).all()
        else "widen the domain, close the wall where it got through, or along a periodic axis wrap the positions"
    )
    return (
        f"{kind} {index}{of_list} is at ({where}) m, outside the domain from {domain.lower} to {domain.upper} "
        f"(periodic: {domain.periodic}); {cure}"
    )
