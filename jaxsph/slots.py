"""The loop over the slots of a neighbor list, and what it loops over.

Only `pair_sum` and its adjoint call it. Whatever the empty slots of a list give is left out here, so that physics
need not know of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxsph.components import components, in_components
from jaxsph.pytree import pytree_dataclass, replace

UNROLL_FROM, UNROLL = 3000, 4
"""From this many particles on, the forward loop over lists that change does 4 slots in a turn, which lets XLA use both
cores; below, one slot a turn is faster. Measured by `make bench`, turns; the next two by pair_sum."""

UNROLL_OTHERS_FROM = 8192
"""From this many on the other loops do several: those over the edges of solids, over tangents and over adjoints."""

UNROLL_DERIVATIVE, UNROLL_DERIVATIVE_UP_TO = 2, 40_000
"""The loops over tangents and adjoints carry more: 2 slots in a turn are faster by a quarter at 10,000 particles and no
better from 40,000 on, where one slot alone keeps both cores busy (in float64, 2 are slower there)."""

TILE = 32_768
"""At most so many receivers go through the slots together: of more, what one slot gathers has left the cache before the
next asks for it again. Tiles of this size are 3 times faster in 3D from 50,000 particles on and twice as fast in
2D at half a million, and cost nothing at 50,000 in 2D, where smaller ones are slower."""

SMALLEST_TILE, PARTS = 1024, 8
"""Lists of which the first rows are in use, those of particles near another set, go through in up to 8 parts: rows that
wait for what may come near take no time then."""


@pytree_dataclass
class PairList:
    """The least that a neighbor list is: who is in which slot. A `NeighborList` can stand in its place.

    Attributes:
        indices: (K, N) index of the sender in each slot, valid slots first. The empty slots hold the receiver's
            own index in a list of one set, any index that exists in a list of two.
        count: (N,) number of valid slots.
        transpose: the list seen from the senders; None for one set, whose list is symmetric.
        used: how many rows are in use, the first ones; None if all may be.
    """

    indices: Any
    count: Any
    transpose: Any = None
    used: Any = None

    def transposed(self) -> PairList:
        """The list with receivers and senders exchanged."""
        if self.transpose is None:
            return self
        return replace(self.transpose, transpose=replace(self, transpose=None))


@pytree_dataclass
class Edges:
    """Values that belong to a pair, one for each slot of a list of one set, leaves (..., K, N).

    `forward` is what the receiver a sees of its neighbor b, `backward` what b sees of a: g(a, b) and g(b, a).
    Make them with `pair_edges`. `backward` may be None if pair sums with these edges state their symmetry.
    """

    forward: Any
    backward: Any


def gather(leaf, index):
    return leaf.at[..., index].get(mode="promise_in_bounds")


def _gathered(leaves, index):
    return [None if leaf is None else gather(leaf, index) for leaf in leaves]


def _gathered_by_two(leaves):
    """`_gathered` of these leaves (N,) as a function of the index: two real ones at a time, as one complex field.

    Half of a pair sum's time goes into gathering, and two numbers that lie side by side take as long as one: forward
    sums are faster by a sixth in float32 and by a thirtieth in float64. Loops over tangents are slower this way.
    """
    places: dict = {}
    for place, leaf in enumerate(leaves):
        if leaf is not None:
            places.setdefault((leaf.dtype, leaf.shape), []).append(place)
    groups = []
    for (dtype, _), alike in places.items():
        size = 2 if dtype in (jnp.float32, jnp.float64) else 1
        groups += [alike[first : first + size] for first in range(0, len(alike), size)]
    fields = [
        jax.lax.complex(*(leaves[at] for at in group)) if len(group) == 2 else leaves[group[0]] for group in groups
    ]

    def gathered(index):
        near: list = [None] * len(leaves)
        for group, field in zip(groups, fields, strict=True):
            # Without the barrier XLA gathers once for the real parts and once for the imaginary ones.
            found = jax.lax.optimization_barrier(gather(field, index))
            values = (found.real, found.imag) if len(group) == 2 else (found,)
            for place, value in zip(group, values, strict=True):
                near[place] = value
        return near

    return gathered


def pair_edges(geometry: Callable, particles: Any, neighbors: Any, *, backward: bool = True) -> Edges:
    """Evaluate geometry(a, b), and geometry(b, a), once for every slot; zero in the empty slots.

    For pairs that never change, as those of a solid's reference configuration.
    """
    gathered = jax.tree.map(lambda leaf: gather(leaf, neighbors.indices), particles)
    filled = jnp.arange(neighbors.indices.shape[0])[:, None] < neighbors.count[None]

    def keep_filled(tree):
        return jax.tree.map(lambda leaf: jnp.where(filled, leaf, jnp.zeros((), leaf.dtype)), tree)

    forward = jax.vmap(jax.vmap(geometry, (-1, -1), -1), (None, -2), -2)(particles, gathered)
    if not backward:
        return Edges(keep_filled(forward), None)
    seen_back = jax.vmap(jax.vmap(geometry, (-1, -1), -1), (-2, None), -2)(gathered, particles)
    return Edges(keep_filled(forward), keep_filled(seen_back))


def over_slots(f, particles, edge, neighbors, constants, signs=None, *, derivative=False, transposable=False):
    """Sum f(a, b, edge, constants) over the slots of a list. particles: one set (a,), or two sets (a, b).

    Whatever the empty slots give is left out. Where f is antisymmetric it need not be: there the particle is
    paired with itself.

    derivative: whether f is a tangent or an adjoint, which decides how many slots are done in a turn.
    transposable: whether JAX will differentiate the loop in reverse mode.

    Lists with edges, those of solids, are short and never change; their fields go through the loop as they are. Other
    lists have slots that are not in use, and the loop ends with the last one that is; their fields go through it
    component by component. Either way takes one and a half to two times as long for the lists of the other.
    """
    if jax.tree.leaves(edge):
        return _over_fixed(f, particles, edge, neighbors, constants, signs, derivative)
    return _over_used(f, particles, edge, neighbors, constants, signs, derivative, transposable)


def _over_fixed(f, particles, edge, neighbors, constants, signs, derivative):
    """Over all slots, each with its edge."""
    a, b = particles[0], particles[-1]
    batched = jax.vmap(f, in_axes=(-1, -1, -1, None), out_axes=-1)

    def of_slot(index, edge_of_slot):
        near = jax.tree.map(lambda leaf: gather(leaf, index), b)
        return batched(a, near, edge_of_slot, constants)

    first = jax.tree.map(lambda leaf: leaf[..., 0, :], edge)
    shapes, structure = jax.tree.flatten(jax.eval_shape(of_slot, neighbors.indices[0], first))
    masked = [signs is None or sign != -1 for sign in signs or [None] * len(shapes)]

    def add_slot(totals, slot):
        number, index, edge_of_slot = slot
        values = jax.tree.leaves(of_slot(index, edge_of_slot))
        return _added(totals, values, masked, number < neighbors.count), None

    n_slots, n = neighbors.indices.shape
    slots = (jnp.arange(n_slots, dtype=neighbors.count.dtype), neighbors.indices)
    slots = (*slots, jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -2, 0), edge))
    totals = [jnp.zeros(shape.shape, shape.dtype) for shape in shapes]
    unroll = min(_slots_in_a_turn(n, derivative, UNROLL_OTHERS_FROM), n_slots)
    totals, _ = jax.lax.scan(add_slot, totals, slots, unroll=unroll)
    return jax.tree.unflatten(structure, totals)


def _over_used(f, particles, edge, neighbors, constants, signs, derivative, transposable):
    """Over the slots in use, or over all of them if the loop is to be transposed."""
    single = tuple(
        jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[:-1], leaf.dtype), tree)
        for tree in (particles[0], particles[-1])
    )
    of_components, structure, shapes, read_of_b = in_components(f, (*single, edge), constants, keep_rules=transposable)
    fields_a, fields_b = components(particles[0]), components(particles[-1])
    batched = jax.vmap(of_components)
    n_slots, n = neighbors.indices.shape
    width = n if transposable else _width_of_tiles(n, neighbors.used is not None)
    several_from = UNROLL_OTHERS_FROM if derivative or transposable else UNROLL_FROM
    unroll = min(_slots_in_a_turn(width, derivative, several_from), n_slots)
    whole = n_slots % unroll == 0 or transposable
    masked = [
        signs is None or signs[leaf] != -1 or not whole
        for leaf, shape in enumerate(shapes)
        for _ in range(math.prod(shape.shape))
    ]
    dtypes = [shape.dtype for shape in shapes for _ in range(math.prod(shape.shape))]

    of_b = [leaf if read else None for leaf, read in zip(fields_b, read_of_b, strict=True)]
    near_of = partial(_gathered, of_b) if derivative or transposable else _gathered_by_two(of_b)

    def add_slot(totals, slot, receivers, count):
        number, index = slot
        near = near_of(index)
        return _added(totals, batched(receivers, near, []), masked, number < count), None

    def of_tile(first):
        """The sums of the receivers from the first on, up to the last slot that one of them has in use."""
        receivers, count = jax.tree.map(partial(_rows, first, width), (fields_a, neighbors.count))

        def turn(carry):
            slot, totals = carry
            for step in range(unroll):
                index = jax.lax.dynamic_index_in_dim(neighbors.indices, slot + step, keepdims=False)
                index = _rows(first, width, index)
                totals, _ = add_slot(totals, (slot + step, index), receivers, count)
            return slot + unroll, totals

        used, totals = jnp.max(count), [jnp.zeros(width, dtype) for dtype in dtypes]
        return jax.lax.while_loop(lambda carry: carry[0] < used, turn, (jnp.zeros_like(used), totals))[1]

    if transposable:
        slots = (jnp.arange(n_slots, dtype=neighbors.count.dtype), neighbors.indices)
        add = partial(add_slot, receivers=fields_a, count=neighbors.count)
        totals, _ = jax.lax.scan(add, [jnp.zeros(n, dtype) for dtype in dtypes], slots, unroll=unroll)
    else:
        totals = _tile_by_tile(of_tile, n, width, dtypes, neighbors.used)
    totals = iter(totals)
    return jax.tree.unflatten(structure, [joined(totals, shape.shape) for shape in shapes])


def in_tiles(neighbors, edge) -> bool:
    """Whether the receivers of a list go through its slots so many at a time."""
    n = neighbors.indices.shape[1]
    return not jax.tree.leaves(edge) and _width_of_tiles(n, partly_used=False) < n


def _width_of_tiles(n, partly_used):
    """The number of receivers in a tile: as few tiles as TILE allows, of about the same size.

    partly_used: whether only the first rows may be in use; then tiles that hold none are left out.
    """
    tiles = max(1, math.ceil(n / TILE))
    if partly_used:
        tiles = max(tiles, min(PARTS, math.ceil(n / SMALLEST_TILE)))
    return min(n, 64 * math.ceil(n / (64 * tiles)))


def _tile_by_tile(of_tile, n, width, dtypes, used=None):
    """Totals (n,), computed so many at a time."""
    if width == n:
        return of_tile(0)

    def add_tile(tile, totals):
        # The last tile ends with the last particle, and so repeats some rows of the one before.
        first = jnp.minimum(tile * width, n - width)
        parts = of_tile(first)
        put = partial(jax.lax.dynamic_update_slice_in_dim, start_index=first, axis=0)
        return [put(total, part) for total, part in zip(totals, parts, strict=True)]

    n_tiles = math.ceil(n / width) if used is None else -(-used // width)
    return jax.lax.fori_loop(0, n_tiles, add_tile, [jnp.zeros(n, dtype) for dtype in dtypes])


def _rows(first, width, leaf):
    """So many values (..., N) from the first on."""
    return leaf if leaf.shape[-1] == width else jax.lax.dynamic_slice_in_dim(leaf, first, width, axis=-1)


def _added(totals, values, masked, filled):
    """Totals and what a slot gives; of masked values only that of the filled slots."""
    values = [
        jnp.where(filled, value, jnp.zeros((), value.dtype)) if mask else value
        for value, mask in zip(values, masked, strict=True)
    ]
    return [total + value for total, value in zip(totals, values, strict=True)]


def joined(parts, shape):
    """The field of components (N,) taken from an iterator, (*shape, N)."""
    return jnp.stack([joined(parts, shape[1:]) for _ in range(shape[0])]) if shape else next(parts)


def _slots_in_a_turn(n_particles: int, derivative: bool, several_from: int) -> int:
    if n_particles < several_from:
        return 1
    if not derivative:
        return UNROLL
    return UNROLL_DERIVATIVE if n_particles < UNROLL_DERIVATIVE_UP_TO else 1


def per_slot(f, particles, edge, neighbors):
    """f of every slot, leaves (..., K, N), zero in the empty slots."""
    gathered = jax.tree.map(lambda leaf: gather(leaf, neighbors.indices), particles[-1])
    over_particles = jax.vmap(f, in_axes=(-1, -1, -1), out_axes=-1)
    value = jax.vmap(over_particles, in_axes=(None, -2, -2), out_axes=-2)(particles[0], gathered, edge)
    filled = jnp.arange(neighbors.indices.shape[0])[:, None] < neighbors.count[None]
    return jax.tree.map(lambda leaf: jnp.where(filled, leaf, jnp.zeros((), leaf.dtype)), value)
