"""The derivative rule of a pair sum: its tangent, and its adjoint by gathers only. See `jaxsph.pair_sum`."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from jaxsph.linear_call import linear_call
from jaxsph.slots import over_slots, per_slot


def transposable(f, signs):
    """The pair sum with its derivative rule: a function of (particles, edge, constants), and of what is fixed.

    The lists and the edges seen backward come as arguments too: a rule may not close over traced values.
    """

    @jax.custom_jvp
    def evaluate(differentiable, fixed):
        particles, edge, constants = differentiable
        return over_slots(f, particles, edge, fixed["list"], constants, signs)

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
    return over_slots(of_pair, both, pairs, fixed["list"], linear["constants"], signs, derivative=True)


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
        of_particles, of_constants = over_slots(of_pair, here, pairs, fixed["list"], (), clear, derivative=True)
        # Each pair was met from both sides, with both cotangents: twice what the constants get.
        of_sets, of_constants = [of_particles], jax.tree.map(lambda leaf: 0.5 * leaf, of_constants)
    elif len(particles) == 1:

        def both_roles(k, neighbor, pair, _):
            mine, of_constants = received(k["fields"], neighbor["fields"], pair["forward"], k["cotangent"])
            theirs = sent(k["fields"], neighbor["fields"], pair["back"], neighbor["cotangent"])
            return [x + y for x, y in zip(mine, theirs, strict=True)], of_constants

        of_particles, of_constants = over_slots(both_roles, here, pairs, fixed["list"], (), derivative=True)
        of_sets = [of_particles]
    else:
        of_receivers, of_constants = over_slots(
            lambda k, neighbor, _, __: received(k["fields"], neighbor["fields"], None, k["cotangent"]),
            here, None, fixed["list"], (), derivative=True,
        )  # fmt: skip
        of_senders = []
        if any(of_b.mask):
            of_senders = over_slots(
                lambda k, neighbor, _, __: sent(k["fields"], neighbor["fields"], None, neighbor["cotangent"]),
                here[::-1], None, fixed["back"], (), derivative=True,
            )  # fmt: skip
        of_sets = [of_receivers, of_senders]
    of_edges = per_slot(of_edge, here, edge, fixed["list"]) if any(live["edge"].mask) else []
    return {"sets": of_sets, "edge": of_edges, "constants": jax.tree.map(lambda leaf: jnp.sum(leaf, -1), of_constants)}
