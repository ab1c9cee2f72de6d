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
tangents in one pass: cheaper when only `jvp` is asked for, and differentiable to any order. Sums in tiles keep the
rule: the loop would have to go over all receivers at once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Literal, jaxpr_as_fun

from jaxsph.linear_call import linear_call
from jaxsph.pair_adjoint import transposable
from jaxsph.slots import Edges, PairList, in_tiles, over_slots, pair_edges

__all__ = ["Edges", "PairList", "apply", "dot", "pair_edges", "pair_sum", "symmetry_error"]


def dot(a, b):
    """Scalar product over the first axis. Under vmap `a @ b` becomes a batched dot, two to four times slower."""
    return jnp.sum(a * b, axis=0)


def apply(matrix, vector):
    """Matrix times vector for the small matrices of one particle, (d, d) and (d,) to (d,)."""
    return jnp.sum(matrix * vector[None], axis=1)


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
        forward_mode: differentiate the loop itself. Cheaper for `jvp`; reverse mode then scatters. Not done for sums
            in tiles, of more than `slots.TILE` receivers: a loop without tiles takes up to five times as long.

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
    single = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[:-1], leaf.dtype), (receivers, senders))
    if edges is not None:
        edge = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[:-2], leaf.dtype), edges.forward)
        single = (*single, edge)
    converted, constants, read, out = _hoist(physics, single)
    signs = _signs(symmetry, out)
    kept = _kept(read, one_set)

    wanted = [_take(flags, held) for flags, held in zip(read, kept, strict=True)]

    def of_pair(*leaves_and_constants):
        *leaves, constants = leaves_and_constants
        chosen = [leaf for held, flags in zip(leaves, wanted, strict=False) for leaf in _take(held, flags)]
        return converted(*chosen, *constants)

    # One set is one argument, so that its derivative is collected once; two sets are two.
    particles = tuple(_take(fields, held) for fields, held in zip((receivers, senders), kept, strict=False))
    particles = particles[:1] if one_set else particles
    edge_fields = None if edges is None else _take(edges.forward, kept[2])
    rows, members = neighbors, getattr(neighbors, "members", None) is not None
    forward = _rows_of(rows)
    if members:
        # Only some particles of both sets have a row: their values are taken out, and the sums put back among zeros.
        parts = (rows, rows.transpose)
        particles = tuple(
            jax.tree.map(partial(_taken, part), fields) for part, fields in zip(parts, particles, strict=True)
        )
    if forward_mode and not in_tiles(forward, edge_fields):
        total = over_slots(of_pair, particles, edge_fields, forward, constants, signs, transposable=True)
        return jax.tree.map(partial(_put_back, rows), total) if members else total
    fixed = {
        "list": forward,
        "back": forward if one_set else _rows_of(rows.transpose),
        "edge_back": None if edges is None or edges.backward is None else _take(edges.backward, kept[2]),
    }
    if edges is not None and edges.backward is None and signs is None:
        raise ValueError("these edges were made without backward values; state the symmetry of the physics")
    total = transposable(of_pair, signs)((particles, edge_fields, constants), fixed)
    return jax.tree.map(partial(_put_back, rows), total) if members else total


def _rows_of(part) -> PairList:
    """What of a list a loop needs."""
    return PairList(part.indices, part.count, used=part.used)


def _taken(part, leaf):
    """The members' values of a field (..., N). What stands in rows that are left over is that of the last particle."""
    return linear_call(_members_of, _among_all, _Places(part.members, part.place), leaf)


def _put_back(part, leaf):
    """A field (..., N) with the values of the members, and zero for all others. A gather too, in both directions."""
    return linear_call(_among_all, _members_of_or_zero, _Places(part.members, part.place), leaf)


class _Places(NamedTuple):
    members: Any
    place: Any


def _members_of(places, leaf):
    return leaf.at[..., places.members].get(mode="clip")


def _members_of_or_zero(places, leaf):
    return leaf.at[..., places.members].get(mode="fill", fill_value=0)


def _among_all(places, leaf):
    return leaf.at[..., places.place].get(mode="fill", fill_value=0)


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


def _hoist(physics, single):
    """Physics as a function of the leaves that it reads and of all arrays that it closes over.

    Returns it, these arrays, which leaves of each argument it reads, and what it returns without its particle axis.
    What does not lead to a result is left out, so that nothing is gathered, differentiated or kept for it.
    (`jax.closure_convert` leaves traced integers behind, which a derivative rule may not close over.)
    """
    closed, out = jax.make_jaxpr(physics, return_shape=True)(*single)
    jaxpr, equations = closed.jaxpr, []
    needed = {atom for atom in jaxpr.outvars if not isinstance(atom, Literal)}
    for equation in reversed(jaxpr.eqns):
        if equation.effects or any(variable in needed for variable in equation.outvars):
            equations.append(equation)
            needed |= {atom for atom in equation.invars if not isinstance(atom, Literal)}
    held = [variable in needed for variable in jaxpr.constvars]
    pruned = jaxpr.replace(
        constvars=[variable for variable, is_held in zip(jaxpr.constvars, held, strict=True) if is_held],
        invars=[variable for variable in jaxpr.invars if variable in needed],
        eqns=equations[::-1],
    )
    constants = [value for value, is_held in zip(closed.consts, held, strict=True) if is_held]
    structure, n_read = jax.tree.structure(out), len(pruned.invars)
    flags = iter(variable in needed for variable in jaxpr.invars)
    read = [[next(flags) for _ in jax.tree.leaves(argument)] for argument in single]

    def converted(*leaves):
        hoisted = ClosedJaxpr(pruned, leaves[n_read:])
        return jax.tree.unflatten(structure, jaxpr_as_fun(hoisted)(*leaves[:n_read]))

    return converted, constants, read, out


def _kept(read, one_set):
    """Which leaves go into the loop, by argument: those that are read, of one set in either role."""
    kept = [list(flags) for flags in read]
    if one_set:
        kept[0] = kept[1] = [a or b for a, b in zip(*read[:2], strict=True)]
    if not any(kept[0]) and not any(kept[1]):
        kept[0][0] = True  # a constant for every pair: something must say how many particles there are
    return kept


def _take(tree, kept):
    return [leaf for leaf, is_kept in zip(jax.tree.leaves(tree), kept, strict=True) if is_kept]


def _check_lengths(receivers, senders, neighbors, one_set):
    n_receivers = _number_of_particles(neighbors)
    n_senders = n_receivers if one_set else _number_of_particles(neighbors.transpose)
    for name, fields, n in (("receiver", receivers, n_receivers), ("sender", senders, n_senders)):
        for path, leaf in jax.tree_util.tree_leaves_with_path(fields):
            if jnp.shape(leaf)[-1:] != (n,):
                raise ValueError(
                    f"{name} field {jax.tree_util.keystr(path)} has shape {jnp.shape(leaf)}; its last axis must be "
                    f"the {n} {name}s of the neighbor list (fields are component first, particle last)"
                )


def _number_of_particles(part):
    place = getattr(part, "place", None)
    return part.indices.shape[1] if place is None else place.shape[0]


def _signs(symmetry, out):
    """The stated symmetry of each leaf that physics returns, as a tuple of +1 and -1; None if nothing is stated."""
    if symmetry is None:
        return None
    signs = tuple(jax.tree.leaves(jax.tree.broadcast(symmetry, out)))
    if any(sign not in (1, -1) for sign in signs):
        raise ValueError(f"symmetry is {symmetry}; it must be made of +1 and -1")
    return signs
