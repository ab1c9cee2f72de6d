"""Building neighbor lists: ours beside jax-md's, and beside one right-hand side.

Particles were in cell order and have then moved by a tenth of the spacing, as between two rebuilds of a run. A
rebuild of ours is all that such a run does: find the order, permute all fields, find the neighbors. Both
builders get the same box around the particles, the same cutoff without skin, and arrays a quarter larger than needed.
jax-md's is called as it is, without the conversion to our list.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pair_sum
from measure import Timing, compiled, interleaved, row

from jaxsph.neighbors import Domain, neighbor_list, raise_if_wrong
from jaxsph.neighbors.jax_md import load

RESERVE = 1.25  # jax-md's default


def rebuild(search, fields, neighbors):
    """What a run does between blocks of steps: fields in the new cell order, and their list."""
    order = search.sort(fields["position"])
    fields = jax.tree.map(lambda field: field[..., order], fields)
    return fields, search.update(fields["position"], neighbors, in_cell_order=True)


def jax_md_build(domain: Domain, cutoff: float, positions):
    """jax-md's update of a list of format Dense, and its arguments. Its boxes begin at the origin."""
    partition = load()

    def displacement(a, b, **_):
        return a - b  # what jax_md.space.free() gives

    functions = partition.neighbor_list(
        displacement,
        np.asarray(domain.lengths),
        cutoff,
        dr_threshold=0.0,
        capacity_multiplier=RESERVE,
        format=partition.NeighborListFormat.Dense,
    )
    shifted = positions.T - jnp.asarray(domain.lower, positions.dtype)
    built = functions.allocate(shifted)
    return lambda positions, built: functions.update(positions, built), (shifted, built)


def agree(ours, theirs) -> None:
    """Both lists hold the same pairs, or their times mean nothing.

    A pair whose distance is the cutoff to within rounding may be in one and not in the other: positions count from
    different origins. In float32 that is one pair in a million, in float64 none.

    Raises AssertionError with the number of particles whose neighbors differ.
    """
    raise_if_wrong(ours)
    if bool(theirs.did_buffer_overflow):
        raise AssertionError("jax-md's list overflowed")
    n = ours.count.shape[0]
    difference = np.abs(np.asarray(jnp.sum(theirs.idx < n, axis=1)) - np.asarray(ours.count))
    if np.sum(difference) > 50 * jnp.finfo(ours.reference.dtype).eps * np.sum(ours.count):
        raise AssertionError(f"the lists differ for {np.sum(difference > 0)} of {n} particles")


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """Rows of one size after the other."""
    for dimension, sides in (pair_sum.QUICK_SIDES if quick else pair_sum.SIDES).items():
        for side in sides:
            yield rows_of(dimension, side, precision, budget=0.5 if quick else 8.0)


def rows_of(dimension: int, side: int, precision: str, budget: float) -> list[dict]:
    """Build times of one set of particles, and what they are in right-hand sides."""
    case = pair_sum.fluid(dimension, side, precision)
    step = np.random.default_rng(1).normal(0, 0.1 * case.spacing, case.fields["position"].shape)
    fields = {**case.fields, "position": case.fields["position"] + jnp.asarray(step, precision)}
    domain = Domain.around(fields["position"], margin=0.1 * case.cutoff)
    search = neighbor_list(domain, case.cutoff, capacity_multiplier=RESERVE)
    neighbors = search.allocate(fields["position"])
    theirs, their_arguments = jax_md_build(domain, case.cutoff, fields["position"])
    agree(neighbors, their_arguments[1])
    ordered, in_order = jax.jit(partial(rebuild, search))(fields, neighbors)
    viscosity = jnp.asarray(pair_sum.VISCOSITY, precision)
    calls = {
        ("jaxsph", "rebuild"): compiled(partial(rebuild, search), fields, neighbors),
        ("jaxsph", "build, any order"): compiled(search.update, fields["position"], neighbors),
        ("jax-md", "build, any order"): compiled(theirs, *their_arguments),
        ("jaxsph", "right-hand side"): compiled(partial(pair_sum.ours, case), ordered, viscosity, in_order),
    }
    n, slots = case.n_particles, neighbors.capacity.slots
    mean = float(jnp.mean(neighbors.count))
    about: dict[str, Any] = {
        "identity": f"neighbors.{dimension}d.{n}.{precision}",
        "case": f"neighbor list, {dimension}D",
        "resolution": f"{n:,} particles, {mean:.0f} neighbors, {slots} slots",
        "precision": precision,
    }
    print(f"{about['case']}, {about['resolution']}, {precision}", flush=True)
    return list(figures(interleaved(calls, budget), about))


def figures(timings: dict[tuple[str, str], Timing], about: dict[str, Any]) -> Iterator[dict]:
    """Milliseconds of each call, and each build in right-hand sides."""
    right_hand_side = timings["jaxsph", "right-hand side"]
    for (peer, figure), timing in timings.items():
        print(timing.line(f"{peer}: {figure}"), flush=True)
        yield row(**about, figure=figure, value=timing.seconds * 1e3, unit="ms", peer=peer, timing=timing)
    for (peer, figure), timing in timings.items():
        if figure != "right-hand side":
            ratio = timing.over(right_hand_side)
            yield row(**about, figure=f"{figure} / right-hand side", value=ratio, unit="times", peer=peer)
