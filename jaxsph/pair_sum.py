"""The one operator that loops over neighbors.

Physics is written for one pair of particles, `physics(a, b)`, and `pair_sum` adds it up over the neighbors b
of every particle a. Fields are component first, particle last: a scalar field is (N,), a vector field
(d, N), a tensor field (d, d, N), so that every operation inside is one long contiguous vector. The loop goes
over the slots of the neighbor list and keeps the sum in its carry: nothing of the size of all pairs is stored.

Derivatives. The tangent of a pair sum is a pair sum of the tangents. Its transpose is again a pair sum: for
a symmetric list, particle k collects what it received, (df(a_k, b_l)/da)^T c_k, and what it sent,
(df(a_l, b_k)/db)^T c_l, both from the same neighbors l. So reverse mode only gathers; it never scatters over
pairs and never stores them. The rule is a `custom_jvp` whose tangent is a `linear_call` with this
transpose, which gives `jvp`, `grad`, `vmap` and forward over reverse mode from one definition. With
`forward_mode=True` the rule is left out and JAX differentiates the loop itself, values and tangents in one
pass: cheaper when only `jvp` is asked for, and differentiable to any order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from jaxsph.linear_call import linear_call
from jaxsph.pytree import pytree_dataclass

UNROLL = 4  # slots per turn of the loop: fewer, longer operations; measured in tests/benchmarks


def dot(a, b):
    """Scalar product over the first axis. Under vmap `a @ b` becomes a batched dot, two to four times slower."""
    return jnp.sum(a * b, axis=0)


def apply(matrix, vector):
    """Matrix times vector for the small matrices of one particle, (d, d) and (d,) to (d,)."""
    return jnp.sum(matrix * vector[None], axis=1)


@pytree_dataclass
class PairList:
    """The least that a neighbor list is: who is in which slot. A `NeighborList` can stand in its place.

    Attributes:
        indices: (K, N) index of the sender in each slot, valid slots first; the others hold any index that exists.
        count: (N,) number of valid slots.
        transpose: the list seen from the senders; None for one set, whose list is symmetric.
    """

    indices: Any
    count: Any
    transpose: Any = None


@pytree_dataclass
class Edges:
    """Values that belong to a pair, one for each slot of a neighbor list, leaves (..., K, N).

    `forward` is what the receiver a sees of its neighbor b, `backward` what b sees of a: g(a, b) and g(b, a).
    Make them with `pair_edges`.
    """

    forward: Any
    backward: Any


def pair_edges(geometry: Callable, receivers: Any, senders: Any, neighbors: Any) -> Edges:
    """Evaluate geometry(a, b) and geometry(b, a) once for every slot, zero in the empty slots.

    For pairs that never change, as those of a solid's reference configuration.
    """
    gathered = jax.tree.map(lambda leaf: _gather(leaf, neighbors.indices), senders)
    filled = jnp.arange(neighbors.indices.shape[0])[:, None] < neighbors.count[None]

    def keep_filled(tree):
        return jax.tree.map(lambda leaf: jnp.where(filled, leaf, jnp.zeros((), leaf.dtype)), tree)

    forward = jax.vmap(jax.vmap(geometry, (-1, -1), -1), (None, -2), -2)(receivers, gathered)
    backward = jax.vmap(jax.vmap(geometry, (-1, -1), -1), (-2, None), -2)(gathered, receivers)
    return Edges(keep_filled(forward), keep_filled(backward))


def pair_sum(
    physics: Callable,
    receivers: Any,
    senders: Any,
    neighbors: Any,
    edges: Edges | None = None,
    *,
    forward_mode: bool = False,
) -> Any:
    """Sum physics(a, b) over the neighbors b of every receiver a.

    Args:
        physics: function of one pair. It gets the fields of receiver a and of sender b without the particle
            axis, and with `edges` also the value of the pair: physics(a, b, edge). It returns a pytree of
            arrays. It may close over traced values (a smoothing length, a viscosity): they are differentiated.
        receivers: pytree of fields (..., N_receivers).
        senders: pytree of fields (..., N_senders); the same object for one set.
        neighbors: a `NeighborList`: `indices` (K, N_receivers), `count` (N_receivers,), and `transpose`, the
            list seen from the senders; None for one set, whose list is symmetric.
        edges: constants of the pairs, from `pair_edges`.
        forward_mode: differentiate the loop itself. Cheaper for `jvp`; reverse mode then scatters.

    Returns:
        What physics returns, each leaf with a particle axis, (..., N_receivers).

    Raises:
        ValueError: a field's last axis does not fit the list.
    """
    _check_lengths(receivers, senders, neighbors)
    examples = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[:-1], leaf.dtype), (receivers, senders))
    if edges is not None:
        edge = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[:-2], leaf.dtype), edges.forward)
        examples = (*examples, edge)
    converted, constants = jax.closure_convert(physics, *examples)

    def of_pair(a, b, edge, constants):
        return converted(a, b, *constants) if edges is None else converted(a, b, edge, *constants)

    edge_fields = None if edges is None else edges.forward
    if forward_mode:
        return _over_slots(of_pair, receivers, senders, edge_fields, neighbors, constants)
    if edges is not None and neighbors.transpose is not None:
        raise ValueError("edges belong to pairs of one set; for two sets compute the pair's geometry in physics")
    symmetric = neighbors.transpose is None
    forward = PairList(neighbors.indices, neighbors.count)
    fixed = {
        "list": forward,
        "back": forward if symmetric else PairList(neighbors.transpose.indices, neighbors.transpose.count),
        "backward_edge": None if edges is None else edges.backward,
    }
    return _transposable(of_pair, symmetric)((receivers, senders, edge_fields, constants), fixed)


def _gather(leaf, index):
    return leaf.at[..., index].get(mode="promise_in_bounds")


def _check_lengths(receivers, senders, neighbors):
    n_receivers = neighbors.indices.shape[1]
    n_senders = n_receivers if neighbors.transpose is None else neighbors.transpose.indices.shape[1]
    for name, fields, n in (("receiver", receivers, n_receivers), ("sender", senders, n_senders)):
        for path, leaf in jax.tree_util.tree_leaves_with_path(fields):
            if jnp.shape(leaf)[-1:] != (n,):
                raise ValueError(
                    f"{name} field {jax.tree_util.keystr(path)} has shape {jnp.shape(leaf)}; its last axis must be "
                    f"the {n} {name}s of the neighbor list (fields are component first, particle last)"
                )


def _over_slots(f, a, b, edge, neighbors, constants):
    """Sum f(a, b, edge, constants) over the slots of a list; whatever the empty slots give is left out."""
    batched = jax.vmap(f, in_axes=(-1, -1, -1, None), out_axes=-1)
    first_edge = jax.tree.map(lambda leaf: leaf[..., 0, :], edge)
    like_b = jax.tree.map(lambda leaf: _gather(leaf, neighbors.indices[0]), b)
    shapes = jax.eval_shape(batched, a, like_b, first_edge, constants)
    zero = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)

    def add_slot(total, slot):
        number, index, edge_of_slot = slot
        value = batched(a, jax.tree.map(lambda leaf: _gather(leaf, index), b), edge_of_slot, constants)
        filled = number < neighbors.count
        return jax.tree.map(lambda t, v: t + jnp.where(filled, v, jnp.zeros((), v.dtype)), total, value), None

    n_slots = neighbors.indices.shape[0]
    slots = (jnp.arange(n_slots, dtype=neighbors.count.dtype), neighbors.indices)
    slots = (*slots, jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -2, 0), edge))
    return jax.lax.scan(add_slot, zero, slots, unroll=min(UNROLL, n_slots))[0]


def _per_slot(f, a, b, edge, neighbors, constants):
    """f of every slot, leaves (..., K, N), zero in the empty slots."""
    gathered = jax.tree.map(lambda leaf: _gather(leaf, neighbors.indices), b)
    over_particles = jax.vmap(f, in_axes=(-1, -1, -1, None), out_axes=-1)
    value = jax.vmap(over_particles, in_axes=(None, -2, -2, None), out_axes=-2)(a, gathered, edge, constants)
    filled = jnp.arange(neighbors.indices.shape[0])[:, None] < neighbors.count[None]
    return jax.tree.map(lambda leaf: jnp.where(filled, leaf, jnp.zeros((), leaf.dtype)), value)


class _Live:
    """Which leaves of (a, b, edge, constants) carry a tangent, and how to put such leaves in and take them out."""

    def __init__(self, tangents):
        is_zero = lambda t: isinstance(t, SymbolicZero)  # noqa: E731
        self.masks = tuple(tuple(not is_zero(t) for t in jax.tree.leaves(part, is_leaf=is_zero)) for part in tangents)

    def take(self, part, tree):
        leaves = jax.tree.leaves(tree, is_leaf=lambda t: isinstance(t, SymbolicZero))
        return [leaf for leaf, live in zip(leaves, self.masks[part], strict=True) if live]

    def put(self, part, tree, values):
        leaves, structure = jax.tree.flatten(tree)
        remaining = iter(values)
        merged = [next(remaining) if live else leaf for leaf, live in zip(leaves, self.masks[part], strict=True)]
        return jax.tree.unflatten(structure, merged)


def _transposable(f, symmetric):
    """The pair sum with its derivative rule: a function of (a, b, edge, constants), and of what is not differentiated.

    The lists and the edges seen backward come as arguments too: a rule may not close over traced values.
    """

    @jax.custom_jvp
    def evaluate(differentiable, fixed):
        a, b, edge, constants = differentiable
        return _over_slots(f, a, b, edge, fixed["list"], constants)

    def rule(primals, tangents):
        differentiable, fixed = primals
        live = _Live(tangents[0])
        linear = [live.take(part, tree) for part, tree in enumerate(tangents[0])]
        return evaluate(differentiable, fixed), linear_call(
            lambda residual, linear: _tangent(f, live, residual, linear),
            lambda residual, cotangent: _transpose(f, live, symmetric, residual, cotangent),
            (differentiable, fixed),
            linear,
        )

    evaluate.defjvp(rule, symbolic_zeros=True)
    return evaluate


def _tangent(f, live, residual, linear):
    """The pair sum of the tangents."""
    (a, b, edge, constants), fixed = residual
    da, db, dedge, dconstants = linear

    def of_pair(receiver, sender, pair, dconstants):
        primal, tangent = receiver["primal"], receiver["tangent"]
        of_live = lambda p, q, e, c: f(  # noqa: E731
            live.put(0, primal, p),
            live.put(1, sender["primal"], q),
            live.put(2, pair["primal"], e),
            live.put(3, constants, c),
        )
        primals = (
            live.take(0, primal), live.take(1, sender["primal"]), live.take(2, pair["primal"]), live.take(3, constants)
        )  # fmt: skip
        return jax.jvp(of_live, primals, (tangent, sender["tangent"], pair["tangent"], dconstants))[1]

    return _over_slots(
        of_pair,
        {"primal": a, "tangent": da},
        {"primal": b, "tangent": db},
        {"primal": edge, "tangent": dedge},
        fixed["list"],
        dconstants,
    )


def _transpose(f, live, symmetric, residual, cotangent):
    """The adjoint: every particle gathers from its neighbors what it received and what it sent."""
    (a, b, edge, constants), fixed = residual

    def as_receiver(receiver, sender, pair):
        """Cotangents of a, edge and constants from the pair (a_k, b_l)."""

        def of_live(p, e, c):
            return f(
                live.put(0, receiver["fields"], p),
                sender["fields"],
                live.put(2, pair["forward"], e),
                live.put(3, constants, c),
            )

        taken = (live.take(0, receiver["fields"]), live.take(2, pair["forward"]), live.take(3, constants))
        return jax.vjp(of_live, *taken)[1](receiver["cotangent"])

    def as_sender(sender, receiver, pair):
        """Cotangents of b from the pair (a_l, b_k), seen by the sender k."""
        of_live = lambda q: f(receiver["fields"], live.put(1, sender["fields"], q), pair["backward"], constants)
        return jax.vjp(of_live, live.take(1, sender["fields"]))[1](receiver["cotangent"])[0]

    as_receivers = {"fields": a, "cotangent": cotangent}
    pairs = {"forward": edge, "backward": fixed["backward_edge"]}
    forward, back = fixed["list"], fixed["back"]

    dedge = live.take(2, edge)
    if dedge:
        dedge = _per_slot(lambda r, s, e, _: as_receiver(r, s, e)[1], as_receivers, {"fields": b}, pairs, forward, ())

    if symmetric:

        def both_roles(k, neighbor, pair, _):
            of_a, _, of_constants = as_receiver(
                {"fields": k["a"], "cotangent": k["cotangent"]}, {"fields": neighbor["b"]}, pair
            )
            of_b = as_sender({"fields": k["b"]}, {"fields": neighbor["a"], "cotangent": neighbor["cotangent"]}, pair)
            return of_a, of_b, of_constants

        particles = {"a": a, "b": b, "cotangent": cotangent}
        da, db, dconstants = _over_slots(both_roles, particles, particles, pairs, forward, ())
    else:
        of_receiver = lambda r, s, e, _: tuple(as_receiver(r, s, e)[i] for i in (0, 2))  # noqa: E731
        da, dconstants = _over_slots(of_receiver, as_receivers, {"fields": b}, pairs, forward, ())
        db = _back_over_slots(as_sender, b, as_receivers, back, live)
    dconstants = jax.tree.map(lambda leaf: jnp.sum(leaf, axis=-1), dconstants)
    return [da, db, dedge, dconstants]


def _back_over_slots(as_sender, b, as_receivers, back, live):
    """Sum over the transposed list of two sets. Pairs of two sets have no edges."""
    if not any(live.masks[1]):
        return []
    no_edge = {"backward": None}
    return _over_slots(lambda s, r, _, __: as_sender(s, r, no_edge), {"fields": b}, as_receivers, None, back, ())
