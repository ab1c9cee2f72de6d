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
from jaxsph.side_by_side import SideBySide

UNROLL_FROM, UNROLL = 1024, 4
"""From this many particles on loops do 4 slots in a turn: between turns the sums are written and read again. Below, a
step with one in a turn takes up to a fifth longer, but the program is compiled two seconds sooner, which is thousands
of steps. `make bench` measures it from 4,000 particles on, turns; the tiles by pair_sum."""

ABREAST = {jnp.dtype(jnp.float32): 2048, jnp.dtype(jnp.float64): 0}
"""Few receivers do several slots of theirs at once, as one array of at most so many pairs: every turn of a loop takes
some time however short its arrays are. Runs of a few hundred particles take three fifths of what they take with one
slot in a turn. Of arrays twice as long XLA makes parts for both cores, which wait for each other. In float64, where
calculating takes longer than turning, it gains nothing; pairs with edges, which are read and not calculated, lose by
it. `make bench` measures it, turns."""

UNROLL_NARROW, NARROW = 8, 64
"""In lists of at most 64 slots, as with few neighbors in 2D, it is 8 of them, but not in derivatives, which take long
to compile. Between turns cores wait for each other."""

TILE = 32_768
"""At most so many receivers go through the slots together: of more, what one slot gathers has left the cache before the
next asks for it again. Tiles of this size are twice as fast in 3D from 50,000 particles on and in 2D at half a million,
and a tenth slower at 50,000 in 2D."""

SMALLEST_TILE, PARTS = 2048, 8
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
    return leaf.at[..., index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def _gathered(leaves, index):
    return [None if leaf is None else gather(leaf, index) for leaf in leaves]


def _gathered_by_two(leaves):
    """`_gathered` of these leaves (N,) as a function of the index: two real ones at a time, as one complex field.

    Two numbers that lie side by side take as long as one. Loops over tangents are slower this way.
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
    """Sum f(a, b, edge, constants) over the slots of a list, or over all of them if the loop is to be transposed.

    Whatever the empty slots give is left out. Where f is antisymmetric it need not be: there the particle is
    paired with itself. All fields go through the loop component by component.

    particles: one set (a,), or two sets (a, b).
    derivative: whether f is a tangent or an adjoint, which may be differentiated again.
    transposable: whether JAX will differentiate the loop in reverse mode.
    """

    def of_one(tree, axes):
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[:-axes], leaf.dtype), tree)

    single = (of_one(particles[0], 1), of_one(particles[-1], 1), of_one(edge, 2))
    of_components, structure, shapes, read_of_b = in_components(f, single, constants, keep_rules=transposable)
    fields_a, fields_b, edges = components(particles[0]), components(particles[-1]), components(edge, 2)
    n_slots, n = neighbors.indices.shape
    width = n if transposable or edges else _width_of_tiles(n, neighbors.used is not None)
    unroll = _slots_in_a_turn(width, n_slots, derivative or transposable)
    abreast = 1 if transposable or edges else _slots_abreast(width, n_slots, [shape.dtype for shape in shapes])
    batched = jax.vmap(of_components)
    batched = batched if abreast == 1 else jax.vmap(batched, in_axes=(None, 0, 0), axis_size=abreast)
    whole = n_slots % (abreast * unroll) == 0 or transposable
    masked = [
        signs is None or signs[leaf] != -1 or not whole
        for leaf, shape in enumerate(shapes)
        for _ in range(math.prod(shape.shape))
    ]
    dtypes = [shape.dtype for shape in shapes for _ in range(math.prod(shape.shape))]
    side_by_side = SideBySide(dtypes, differentiable=derivative)
    of_b = [leaf if read else None for leaf, read in zip(fields_b, read_of_b, strict=True)]
    near_of = partial(_gathered, of_b) if derivative or transposable else _gathered_by_two(of_b)

    def values_of(receivers, index, edges_of_slots, filled):
        return _masked(batched(receivers, near_of(index), edges_of_slots), masked, filled)

    def of_tile(first):
        """The sums of the receivers from the first on, up to the last slot that one of them has in use."""
        receivers, count = jax.tree.map(partial(_rows, first, width), (fields_a, neighbors.count))

        def turn(carry):
            slot, sums = carry
            totals = side_by_side.apart(sums)
            with jax.enable_x64(is_double):  # as the physics expects
                for places in side_by_side.passes:
                    for number in range(unroll):
                        at = slot + number * abreast
                        (index, of_slots), filled = _slots(at, abreast, (neighbors.indices, edges), count)
                        values = values_of(receivers, _rows(first, width, index), of_slots, filled)
                        for place in places:
                            totals[place] = totals[place] + values[place]
            return slot + unroll * abreast, side_by_side.joined(totals)

        used, is_double = jnp.max(count), jax.config.read("jax_enable_x64")
        with side_by_side.types_allowed():
            shape = (width,) if abreast == 1 else (abreast, width)
            nothing = side_by_side.joined([jnp.zeros(shape, dtype) for dtype in dtypes])
            sums = jax.lax.while_loop(lambda carry: carry[0] < used, turn, (jnp.zeros_like(used), nothing))[1]
            totals = side_by_side.apart(sums)
            return totals if abreast == 1 else [jnp.sum(total, axis=0) for total in totals]

    if transposable:

        def add_slot(totals, slot):
            number, index, edges_of_slot = slot
            values = values_of(fields_a, index, edges_of_slot, number < neighbors.count)
            return [total + value for total, value in zip(totals, values, strict=True)], None

        slots = (jnp.arange(n_slots, dtype=neighbors.count.dtype), neighbors.indices, edges)
        totals, _ = jax.lax.scan(add_slot, [jnp.zeros(n, dtype) for dtype in dtypes], slots, unroll=unroll)
    else:
        totals = _tile_by_tile(of_tile, n, width, dtypes, neighbors.used)
    totals = iter(totals)
    return jax.tree.unflatten(structure, [joined(totals, shape.shape) for shape in shapes])


def _slots_in_a_turn(width, n_slots, derivative):
    if width < UNROLL_FROM:
        return 1
    return min(n_slots, UNROLL_NARROW if n_slots <= NARROW and not derivative else UNROLL)


def _slots_abreast(width, n_slots, dtypes):
    """How many slots are in one array."""
    pairs = max((ABREAST.get(dtype, 0) for dtype in dtypes if jnp.issubdtype(dtype, jnp.floating)), default=0)
    return max(1, min(n_slots, pairs // max(width, 1)))


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


def _slots(at, abreast, leaves, count):
    """The slots from one on of values (K, N), and which of them are filled. The last ones begin before, to fit in."""
    if abreast == 1:
        return jax.tree.map(lambda leaf: jax.lax.dynamic_index_in_dim(leaf, at, keepdims=False), leaves), at < count
    first = jnp.minimum(at, leaves[0].shape[0] - abreast)
    numbers = first + jnp.arange(abreast, dtype=first.dtype)[:, None]
    slots = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, first, abreast), leaves)
    return slots, (numbers >= at) & (numbers < count)


def _masked(values, masked, filled):
    """Of the masked values only those of the filled slots."""
    return [
        jnp.where(filled, value, jnp.zeros((), value.dtype)) if mask else value
        for value, mask in zip(values, masked, strict=True)
    ]


def joined(parts, shape):
    """The field of components (N,) taken from an iterator, (*shape, N)."""
    return jnp.stack([joined(parts, shape[1:]) for _ in range(shape[0])]) if shape else next(parts)


def per_slot(f, particles, edge, neighbors):
    """f of every slot, leaves (..., K, N), zero in the empty slots."""
    gathered = jax.tree.map(lambda leaf: gather(leaf, neighbors.indices), particles[-1])
    over_particles = jax.vmap(f, in_axes=(-1, -1, -1), out_axes=-1)
    value = jax.vmap(over_particles, in_axes=(None, -2, -2), out_axes=-2)(particles[0], gathered, edge)
    filled = jnp.arange(neighbors.indices.shape[0])[:, None] < neighbors.count[None]
    return jax.tree.map(lambda leaf: jnp.where(filled, leaf, jnp.zeros((), leaf.dtype)), value)
