"""The one operator that loops over neighbors.

Physics is written for one pair of particles, `physics(a, b)`, and `pair_sum` adds it up over the neighbors b
of every particle a. Fields are component first, particle last: a scalar field is (N,), a vector field
(d, N), a tensor field (d, d, N), so that every operation inside is one long contiguous vector. The loop goes
over the slots of the neighbor list and keeps the sum in its carry: nothing of the size of all pairs is stored.

Derivatives. The tangent of a pair sum is a pair sum of the tangents. Its transpose is again a pair sum: for
a symmetric list, particle k collects what it received, (df(a_k, b_l)/da)^T c_k, and what it sent,
(df(a_l, b_k)/db)^T c_l, both from the same neighbors l. So reverse mode only gathers; it never scatters over
pairs and never stores them. If the physics is symmetric or antisymmetric, f(b, a) = s f(a, b), both are one:
(df(a_k, b_l)/da)^T (c_k + s c_l), which halves the work. The rule is a `custom_jvp` whose tangent is a
`linear_call` with this transpose, which gives `jvp`, `grad`, `vmap` and forward over reverse mode from one
definition. With `forward_mode=True` the rule is left out and JAX differentiates the loop itself, values and
tangents in one pass: cheaper when only `jvp` is asked for, and differentiable to any order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from jaxsph.linear_call import linear_call
from jaxsph.pytree import pytree_dataclass

UNROLL = 4  # slots per turn of the forward loop: fewer, longer operations; measured in tests/benchmarks
UNROLL_DERIVATIVE = 1  # of the loops over tangents and adjoints, whose bodies are long enough


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
        indices: (K, N) index of the sender in each slot, valid slots first. The empty slots hold the receiver's
            own index in a list of one set, any index that exists in a list of two.
        count: (N,) number of valid slots.
        transpose: the list seen from the senders; None for one set, whose list is symmetric.
    """

    indices: Any
    count: Any
    transpose: Any = None


@pytree_dataclass
class Edges:
    """Values that belong to a pair, one for each slot of a list of one set, leaves (..., K, N).

    `forward` is what the receiver a sees of its neighbor b, `backward` what b sees of a: g(a, b) and g(b, a).
    Make them with `pair_edges`. `backward` may be None if pair sums with these edges state their symmetry.
    """

    forward: Any
    backward: Any


def pair_edges(geometry: Callable, particles: Any, neighbors: Any, *, backward: bool = True) -> Edges:
    """Evaluate geometry(a, b), and geometry(b, a), once for every slot; zero in the empty slots.

    For pairs that never change, as those of a solid's reference configuration.
    """
    gathered = jax.tree.map(lambda leaf: _gather(leaf, neighbors.indices), particles)
    filled = jnp.arange(neighbors.indices.shape[0])[:, None] < neighbors.count[None]

    def keep_filled(tree):
        return jax.tree.map(lambda leaf: jnp.where(filled, leaf, jnp.zeros((), leaf.dtype)), tree)

    forward = jax.vmap(jax.vmap(geometry, (-1, -1), -1), (None, -2), -2)(particles, gathered)
    if not backward:
        return Edges(keep_filled(forward), None)
    seen_back = jax.vmap(jax.vmap(geometry, (-1, -1), -1), (-2, None), -2)(gathered, particles)
    return Edges(keep_filled(forward), keep_filled(seen_back))


def pair_sum(
    physics: Callable,
    receivers: Any,
    senders: Any,
    neighbors: Any,
    edges: Edges | None = None,
    *,
    symmetry: Any = None,
    forward_mode: bool = False,
) -> Any:
    """Sum physics(a, b) over the neighbors b of every receiver a.

    Args:
        physics: function of one pair. It gets the fields of receiver a and of sender b without the particle
            axis, and with `edges` also the value of the pair: physics(a, b, edge). It returns a pytree of
            arrays, finite also for coincident particles. It may close over traced values (a smoothing length, a
            viscosity): they are differentiated.
        receivers: pytree of fields (..., N_receivers).
        senders: pytree of fields (..., N_senders); the same object as receivers if they are the same.
        neighbors: a `NeighborList` or `PairList`.
        edges: constants of the pairs, from `pair_edges`; for one set.
        symmetry: what the caller knows of the physics of one set: +1 if f(b, a) = f(a, b), -1 if f(b, a) =
            -f(a, b), exactly and for all pairs; one number, or a tree like what physics returns. Then the
            gradient costs half. A wrong statement gives wrong gradients: test it with `symmetry_error`.
        forward_mode: differentiate the loop itself. Cheaper for `jvp`; reverse mode then scatters.

    Returns:
        What physics returns, each leaf with a particle axis, (..., N_receivers).

    Raises:
        ValueError: a field's last axis does not fit the list; edges or symmetry with two sets.
    """
    one_set = neighbors.transpose is None
    if not one_set and (edges is not None or symmetry is not None):
        raise ValueError("edges and symmetry belong to pairs of one set; this list is one of two sets")
    _check_lengths(receivers, senders, neighbors, one_set)
    if one_set and receivers is not senders:
        if symmetry is not None:
            raise ValueError("symmetry needs one set of fields: pass the same object as receivers and senders")
        # Two views of one set: its derivative is that of both together.
        of_views, receivers = physics, (receivers, senders)
        senders, physics = receivers, lambda a, b, *edge: of_views(a[0], b[1], *edge)
    edge_fields = None if edges is None else edges.forward
    single = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[:-1], leaf.dtype), (receivers, senders))
    if edges is not None:
        edge = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[:-2], leaf.dtype), edge_fields)
        single = (*single, edge)
    converted, constants = jax.closure_convert(physics, *single)
    signs = _signs(symmetry, converted, single, constants)

    def of_pair(a, b, edge, constants):
        return converted(a, b, *constants) if edges is None else converted(a, b, edge, *constants)

    # One set is one argument, so that its derivative is collected once; two sets are two.
    particles = (receivers,) if one_set else (receivers, senders)
    if forward_mode:
        return _over_slots(of_pair, particles, edge_fields, neighbors, constants, signs)
    forward = PairList(neighbors.indices, neighbors.count)
    fixed = {
        "list": forward,
        "back": forward if one_set else PairList(neighbors.transpose.indices, neighbors.transpose.count),
        "edge_back": None if edges is None else edges.backward,
    }
    if edges is not None and edges.backward is None and signs is None:
        raise ValueError("these edges were made without backward values; state the symmetry of the physics")
    return _transposable(of_pair, signs)((particles, edge_fields, constants), fixed)


def symmetry_error(physics: Callable, a: Any, b: Any, symmetry: Any, edges: tuple = ()) -> float:
    """Largest violation of a stated symmetry for pairs of particles: |f(b, a) - s f(a, b)| / max |f|.

    Args:
        physics: of one pair, as in `pair_sum`.
        a, b: fields of many pairs, (..., number of pairs).
        symmetry: as in `pair_sum`.
        edges: the pairs' edges seen from a and from b, or nothing.
    """
    each = jax.vmap(physics, -1, -1)
    there, back = each(a, b, *edges[:1]), each(b, a, *edges[1:])
    signs = jax.tree.broadcast(symmetry, there)
    errors = jax.tree.map(lambda s, p, q: jnp.max(jnp.abs(q - s * p)) / jnp.max(jnp.abs(p)), signs, there, back)
    return max(float(error) for error in jax.tree.leaves(errors))


def _gather(leaf, index):
    return leaf.at[..., index].get(mode="promise_in_bounds")


def _check_lengths(receivers, senders, neighbors, one_set):
    n_receivers = neighbors.indices.shape[1]
    n_senders = n_receivers if one_set else neighbors.transpose.indices.shape[1]
    for name, fields, n in (("receiver", receivers, n_receivers), ("sender", senders, n_senders)):
        for path, leaf in jax.tree_util.tree_leaves_with_path(fields):
            if jnp.shape(leaf)[-1:] != (n,):
                raise ValueError(
                    f"{name} field {jax.tree_util.keystr(path)} has shape {jnp.shape(leaf)}; its last axis must be "
                    f"the {n} {name}s of the neighbor list (fields are component first, particle last)"
                )


def _signs(symmetry, converted, single, constants):
    """The stated symmetry of each leaf that physics returns, as a tuple of +1 and -1; None if nothing is stated."""
    if symmetry is None:
        return None
    out = jax.eval_shape(lambda *arguments: converted(*arguments), *single, *constants)
    signs = tuple(jax.tree.leaves(jax.tree.broadcast(symmetry, out)))
    if any(sign not in (1, -1) for sign in signs):
        raise ValueError(f"symmetry is {symmetry}; it must be made of +1 and -1")
    return signs


def _over_slots(f, particles, edge, neighbors, constants, signs=None, unroll=None):
    """Sum f(a, b, edge, constants) over the slots of a list. particles: one set (a,), or two sets (a, b).

    Whatever the empty slots give is left out. Where f is antisymmetric it need not be: there the particle is
    paired with itself.
    """
    a, b = particles[0], particles[-1]
    batched = jax.vmap(f, in_axes=(-1, -1, -1, None), out_axes=-1)
    first_edge = jax.tree.map(lambda leaf: leaf[..., 0, :], edge)
    like_b = jax.tree.map(lambda leaf: _gather(leaf, neighbors.indices[0]), b)
    shapes, structure = jax.tree.flatten(jax.eval_shape(batched, a, like_b, first_edge, constants))
    masked = [signs is None or sign != -1 for sign in signs or [None] * len(shapes)]

    def add_slot(totals, slot):
        number, index, edge_of_slot = slot
        values = batched(a, jax.tree.map(lambda leaf: _gather(leaf, index), b), edge_of_slot, constants)
        filled = number < neighbors.count
        values = jax.tree.leaves(values)
        values = [
            jnp.where(filled, value, jnp.zeros((), value.dtype)) if mask else value
            for value, mask in zip(values, masked, strict=True)
        ]
        return [total + value for total, value in zip(totals, values, strict=True)], None

    n_slots = neighbors.indices.shape[0]
    slots = (jnp.arange(n_slots, dtype=neighbors.count.dtype), neighbors.indices)
    slots = (*slots, jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -2, 0), edge))
    zeros = [jnp.zeros(shape.shape, shape.dtype) for shape in shapes]
    unroll = min(UNROLL if unroll is None else unroll, n_slots)
    return jax.tree.unflatten(structure, jax.lax.scan(add_slot, zeros, slots, unroll=unroll)[0])


def _per_slot(f, particles, edge, neighbors):
    """f of every slot, leaves (..., K, N), zero in the empty slots."""
    gathered = jax.tree.map(lambda leaf: _gather(leaf, neighbors.indices), particles[-1])
    over_particles = jax.vmap(f, in_axes=(-1, -1, -1), out_axes=-1)
    value = jax.vmap(over_particles, in_axes=(None, -2, -2), out_axes=-2)(particles[0], gathered, edge)
    filled = jnp.arange(neighbors.indices.shape[0])[:, None] < neighbors.count[None]
    return jax.tree.map(lambda leaf: jnp.where(filled, leaf, jnp.zeros((), leaf.dtype)), value)


class _Live:
    """Which leaves of a tree carry a tangent: how to take them out, and to put others in their place."""

    def __init__(self, tangents):
        self.mask = [not isinstance(t, SymbolicZero) for t in self._leaves(tangents)]

    @staticmethod
    def _leaves(tree):
        return jax.tree.leaves(tree, is_leaf=lambda leaf: isinstance(leaf, SymbolicZero))

    def take(self, tree):
        return [leaf for leaf, live in zip(self._leaves(tree), self.mask, strict=True) if live]

    def put(self, tree, values):
        leaves, structure = jax.tree.flatten(tree)
        remaining = iter(values)
        merged = [next(remaining) if live else leaf for leaf, live in zip(leaves, self.mask, strict=True)]
        return jax.tree.unflatten(structure, merged)


def _transposable(f, signs):
    """The pair sum with its derivative rule: a function of (particles, edge, constants), and of what is fixed.

    The lists and the edges seen backward come as arguments too: a rule may not close over traced values.
    """

    @jax.custom_jvp
    def evaluate(differentiable, fixed):
        particles, edge, constants = differentiable
        return _over_slots(f, particles, edge, fixed["list"], constants, signs)

    def rule(primals, tangents):
        particles, edge, constants = tangents[0]
        live = {"sets": [_Live(one) for one in particles], "edge": _Live(edge), "constants": _Live(constants)}
        linear = {
            "sets": [which.take(one) for which, one in zip(live["sets"], particles, strict=True)],
            "edge": live["edge"].take(edge),
            "constants": live["constants"].take(constants),
        }
        return evaluate(*primals), linear_call(
            lambda residual, linear: _tangent(f, signs, live, residual, linear),
            lambda residual, cotangent: _transpose(f, signs, live, residual, cotangent),
            primals,
            linear,
        )

    evaluate.defjvp(rule, symbolic_zeros=True)
    return evaluate


def _tangent(f, signs, live, residual, linear):
    """The pair sum of the tangents."""
    (particles, edge, constants), fixed = residual
    of_a, of_b = live["sets"][0], live["sets"][-1]

    def of_pair(a, b, pair, moved):
        def of_live(values_a, values_b, values_edge, values_constants):
            return f(
                of_a.put(a["value"], values_a),
                of_b.put(b["value"], values_b),
                live["edge"].put(pair["value"], values_edge),
                live["constants"].put(constants, values_constants),
            )

        values = (
            of_a.take(a["value"]),
            of_b.take(b["value"]),
            live["edge"].take(pair["value"]),
            live["constants"].take(constants),
        )
        return jax.jvp(of_live, values, (a["tangent"], b["tangent"], pair["tangent"], moved))[1]

    both = [{"value": v, "tangent": t} for v, t in zip(particles, linear["sets"], strict=True)]
    pairs = {"value": edge, "tangent": linear["edge"]}
    return _over_slots(of_pair, both, pairs, fixed["list"], linear["constants"], signs, UNROLL_DERIVATIVE)


def _transpose(f, signs, live, residual, cotangent):
    """The adjoint: every particle gathers from its neighbors what it received and what it sent."""
    (particles, edge, constants), fixed = residual
    of_a, of_b = live["sets"][0], live["sets"][-1]

    def received(a, b, pair, cotangent):
        """Cotangents of a and of the constants from the pair (a, b)."""

        def of_live(values, values_constants):
            return f(of_a.put(a, values), b, pair, live["constants"].put(constants, values_constants))

        return jax.vjp(of_live, of_a.take(a), live["constants"].take(constants))[1](cotangent)

    def sent(b, a, pair, cotangent):
        """Cotangent of b from the pair (a, b)."""
        return jax.vjp(lambda values: f(a, of_b.put(b, values), pair, constants), of_b.take(b))[1](cotangent)[0]

    def of_edge(k, neighbor, pair):
        def of_live(values):
            return f(k["fields"], neighbor["fields"], live["edge"].put(pair, values), constants)

        return jax.vjp(of_live, live["edge"].take(pair))[1](k["cotangent"])[0]

    here = [{"fields": one} for one in particles]
    here[0]["cotangent"] = cotangent
    pairs = {"forward": edge, "back": fixed["edge_back"]}
    if len(particles) == 1 and signs is not None:

        def of_pair(k, neighbor, pair, _):
            ours, theirs = jax.tree.flatten(k["cotangent"]), jax.tree.leaves(neighbor["cotangent"])
            both = [c + sign * d for sign, c, d in zip(signs, ours[0], theirs, strict=True)]
            return received(k["fields"], neighbor["fields"], pair["forward"], jax.tree.unflatten(ours[1], both))

        # The own pair of an empty slot drops out by itself only if everything is antisymmetric.
        clear = (-1,) * (len(of_a.take(particles[0])) + sum(live["constants"].mask))
        clear = clear if all(sign == -1 for sign in signs) else None
        of_particles, of_constants = _over_slots(
            of_pair, here, pairs, fixed["list"], (), clear, unroll=UNROLL_DERIVATIVE
        )
        # Each pair was met from both sides, with both cotangents: twice what the constants get.
        of_sets, of_constants = [of_particles], jax.tree.map(lambda leaf: 0.5 * leaf, of_constants)
    elif len(particles) == 1:

        def of_pair(k, neighbor, pair, _):
            mine, of_constants = received(k["fields"], neighbor["fields"], pair["forward"], k["cotangent"])
            theirs = sent(k["fields"], neighbor["fields"], pair["back"], neighbor["cotangent"])
            return [x + y for x, y in zip(mine, theirs, strict=True)], of_constants

        of_particles, of_constants = _over_slots(of_pair, here, pairs, fixed["list"], (), unroll=UNROLL_DERIVATIVE)
        of_sets = [of_particles]
    else:
        of_receivers, of_constants = _over_slots(
            lambda k, neighbor, _, __: received(k["fields"], neighbor["fields"], None, k["cotangent"]),
            here, None, fixed["list"], (), unroll=UNROLL_DERIVATIVE,
        )  # fmt: skip
        of_senders = []
        if any(of_b.mask):
            of_senders = _over_slots(
                lambda k, neighbor, _, __: sent(k["fields"], neighbor["fields"], None, neighbor["cotangent"]),
                here[::-1], None, fixed["back"], (), unroll=UNROLL_DERIVATIVE,
            )  # fmt: skip
        of_sets = [of_receivers, of_senders]
    of_edges = _per_slot(of_edge, here, edge, fixed["list"]) if any(live["edge"].mask) else []
    return {"sets": of_sets, "edge": of_edges, "constants": jax.tree.map(lambda leaf: jnp.sum(leaf, -1), of_constants)}
