"""Who is near whom while systems move: one neighbor list for every pair of systems that meet.

Lists are built anew at the start of every block of steps, from a template that holds the sizes of their arrays. Nothing
of them is carried from block to block but what went wrong.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.contact import TOUCHING, largest_reach
from jaxsph.effects import Contact
from jaxsph.health import BEYOND_SKIN, NOT_FINITE, OUTSIDE, OVERFLOW, Health
from jaxsph.neighbors import Capacity, Domain, NeighborList, closing, far_enough, moved, neighbor_list, search_of
from jaxsph.pytree import replace
from jaxsph.walls import WallSummation

SKIN = {1: 0.15, 2: 0.15, 3: 0.12}
"""Of the support radius, by dimension. A larger one makes builds rarer and every pass over the pairs longer,
and that by more the more dimensions there are."""

SKIN_BETWEEN_SETS = 2.0
"""Times the skin of lists within a set. Water runs along a wall faster than its particles pass each other, and only few
of it are near one: where it does, a step of a dam break takes a tenth less."""

CAPACITY_MULTIPLIER = 1.4
"""Room for more neighbors than there are at the start: a lattice that breaks up crowds by a third."""


def pairs_of(scene) -> list[tuple[str, str]]:
    """Names of the systems that meet: receiver and sender."""
    fluids = [fluid.name for fluid in scene.fluids]
    pairs = [(a, b) for i, a in enumerate(fluids) for b in fluids[i:]]
    pairs += [(fluid, wall.name) for fluid in fluids for wall in scene.boundaries]
    pairs += [(TOUCHING, TOUCHING)] if scene.effect(Contact) is not None else []
    return pairs + [(w.name, w.name) for w in scene.boundaries if fluids and isinstance(w.pressure, WallSummation)]


def allocate(
    scene,
    positions: dict,
    *,
    skin: float | None = None,
    capacity_multiplier: float = CAPACITY_MULTIPLIER,
    near_only: bool = True,
):
    """Lists by "receiver-sender", from concrete positions (d, N) of every system.

    Args:
        scene: with fluids, or solids and `Contact`.
        positions: by name.
        skin: of lists within a set [m]; None takes the `SKIN` of the fluids, without fluids half the largest
            spacing. Lists of two sets take `SKIN_BETWEEN_SETS` times as much.
        capacity_multiplier: arrays are larger by this factor than these positions need.
        near_only: whether particles that are far from all of the other set are left out of the lists of two sets.

    Raises ParticleOutside and ValueError as `NeighborSearch.allocate`.
    """
    reach = largest_reach(scene) if scene.effect(Contact) is not None else 0.0
    cutoff, usual = reach, 0.5 * reach
    if scene.fluids:
        cutoff = float(scene.kernel.support_radius(np.asarray(scene.smoothing_length)))
        usual = SKIN[scene.dimension] * cutoff
    skin = usual if skin is None else skin
    domain = scene.domain
    # Of the start, so that a run that is continued has the same cells, and with them the same order of sums.
    at_start = [np.asarray(scene[name].particles.positions).T for name in positions if name != TOUCHING]
    everything = np.concatenate(at_start, axis=1)
    if domain is None:
        domain = Domain.around(everything, 4.0 * float(np.max(np.ptp(everything, axis=1))) + 4 * cutoff)
    box = tuple(everything.min(axis=1).tolist()), tuple(everything.max(axis=1).tolist())
    lists = {}
    for a, b in pairs_of(scene):
        wide = skin if a == b else max(skin, min(SKIN_BETWEEN_SETS * skin, _widest_skin(domain, cutoff)))
        search = neighbor_list(domain, reach if a == TOUCHING else cutoff, wide, capacity_multiplier, box=box)
        crowd = None
        if near_only and a != b and getattr(scene[b], "thickness", None) is not None:
            crowd = _around(np.asarray(positions[b]), search.grid.reach, float(scene[a].particles.spacing), domain)
        senders = None if a == b else positions[b]
        lists[f"{a}-{b}"] = search.template(positions[a], senders, near_only=near_only, crowd=crowd)
    return lists


def _widest_skin(domain: Domain, cutoff: float) -> float:
    """With which pairs within a cutoff meet only one image of each other in a periodic domain [m]."""
    periods = [length for length, goes_round in zip(domain.lengths, domain.periodic, strict=True) if goes_round]
    return min((0.499 * period for period in periods), default=math.inf) - cutoff


def _around(plate: np.ndarray, reach: float, spacing: float, domain: Domain) -> np.ndarray | None:
    """A lattice (d, M) [m] around and through a plate (d, N): the fluid that can be near it at once, on all sides."""
    axes = [
        np.arange(max(low - reach, least), min(high + reach, most), spacing)
        for low, high, least, most in zip(plate.min(1), plate.max(1), domain.lower, domain.upper, strict=True)
    ]
    lattice = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")])
    return lattice.astype(plate.dtype) if lattice.size else None


def smallest_skin(scene, templates: dict) -> float:
    """That of the lists within a set [m]."""
    return min(templates[f"{a}-{b}"].skin for a, b in pairs_of(scene))


def rebuild(scene, templates: dict, positions: dict, pairs=None) -> dict[str, NeighborList]:
    """The lists for new positions (d, N) by system, templates as from `topologies`. Inside jit; no derivatives.

    pairs: of which; None takes all of the scene.
    """
    positions = jax.lax.stop_gradient(positions)
    lists = {}
    for a, b in pairs_of(scene) if pairs is None else pairs:
        template = templates[f"{a}-{b}"]
        lists[f"{a}-{b}"] = search_of(template).update(positions[a], template, None if a == b else positions[b])
    return lists


class Left(NamedTuple):
    """What is left of a list.

    Attributes:
        steps: for how many more it holds; below zero if it does not any more.
        closer: how much closer pairs can have come [m].
        limit: how much they may have [m].
    """

    steps: Any
    closer: Any
    limit: Any


def support_radius(scene):
    """Of the fluids [m], 0 without; no derivatives."""
    if not scene.fluids:
        return jnp.zeros((), scene.dtype)
    return jax.lax.stop_gradient(jnp.asarray(scene.kernel.support_radius(scene.smoothing_length)))


def steps_left(lists: dict[str, NeighborList], positions: dict, steps: dict, reserve) -> dict[str, Left]:
    """For how many more steps each list holds, if particles go on as in `steps` (d, N) [m], and by how much it broke.

    Args:
        lists: by name.
        positions: (d, N) by system [m].
        steps: how far the particles of each system that moves go in a step (d, N) [m].
        reserve: how many times as fast as that they may come closer.
    """
    left = {}
    for name, neighbors in lists.items():
        a, b = name.split("-")
        parts = [(neighbors, a)] if neighbors.transpose is None else [(neighbors, a), (neighbors.transpose, b)]
        if not any(own in steps for _, own in parts):
            dtype = neighbors.reference.dtype
            left[name] = Left(jnp.asarray(jnp.inf, dtype), jnp.zeros((), dtype), neighbors.skin)
            continue
        domain = neighbors.grid.domain
        so_far_and_in_a_step = [
            jnp.stack([domain.displacement(positions[own], part.reference), steps[own]], axis=1) if own in steps else 0
            for part, own in parts
        ]
        near, far = closing(neighbors, *so_far_and_in_a_step)
        skin, apart, tiny = neighbors.skin, far_enough(neighbors), jnp.finfo(far.dtype).tiny
        steps_near = (skin - near[0]) / (reserve * near[1] + tiny)
        steps_far = (apart - far[0]) / (reserve * far[1] + tiny)
        closest = jnp.max(near[0])
        is_near = closest * apart >= far[0] * skin if math.isfinite(apart) else True  # which is the closer call
        left[name] = Left(
            jnp.minimum(jnp.min(steps_near), steps_far),
            jnp.where(is_near, closest, far[0]),
            jnp.where(is_near, skin, apart),
        )
    return left


def note(scene, health: Health, lists: dict[str, NeighborList], positions: dict, step, left: dict | None = None):
    """What is wrong with lists that were used until particles came to these positions.

    By as much as the support radius is longer than that for which lists were made, their skin is thinner.

    left: from `steps_left` there, judged by region; without it pairs are taken to have come closer by as much as the
    farthest particles went.
    """
    positions, support = jax.lax.stop_gradient(positions), support_radius(scene)
    for name, neighbors in lists.items():
        a, b = name.split("-")
        sets = [neighbors] if neighbors.transpose is None else [neighbors, neighbors.transpose]
        known = jnp.all(jnp.isfinite(positions[a])) & jnp.all(jnp.isfinite(positions[b]))
        health = health.note(~known, NOT_FINITE, step)  # what is nowhere did not leave
        outside = jnp.any(jnp.stack([part.outside for part in sets]) >= 0)
        since = ~jnp.all(neighbors.grid.domain.contains(positions[a]))  # since the lists were built
        health = health.note(outside | since, OUTSIDE, step)
        needed, limit = neighbors.needed_slots, jnp.int32(neighbors.capacity.slots)
        for part in sets:
            for number, room in part.needed_and_room:
                needed, limit = jnp.where(number > room, number, needed), jnp.where(number > room, room, limit)
        health = health.note(neighbors.did_buffer_overflow, OVERFLOW, step, needed, limit)
        if left is None:
            closer, limit = moved(neighbors, positions[a], None if a == b else positions[b]), neighbors.skin
        else:
            closer, limit = left[name].closer, left[name].limit
        if a != TOUCHING:
            limit = limit - jnp.maximum(support - neighbors.cutoff, 0.0)
        broken = ~((closer < limit) | ((closer == 0) & (limit >= 0)))
        health = health.note(broken & jnp.isfinite(closer), BEYOND_SKIN, step, closer, limit)
    return health


def enlarged(neighbors: NeighborList, factor: float) -> NeighborList:
    """An empty list with arrays larger by a factor, and at least twice the rows; a template, its flags are cleared."""
    n_receivers = neighbors.reference.shape[1]
    if neighbors.transpose is None:
        return _empty(neighbors, factor, n_receivers)
    n_senders = neighbors.transpose.reference.shape[1]
    return replace(_empty(neighbors, factor, n_senders), transpose=_empty(neighbors.transpose, factor, n_receivers))


def _empty(part: NeighborList, factor: float, n_senders: int) -> NeighborList:
    def grown(n: int, most: int = n_senders) -> int:
        return min(math.ceil(n * factor) + 1, most) if n else 0

    old, rows, n_receivers = part.capacity, part.indices.shape[1], part.reference.shape[1]
    chosen = {}
    if part.place is not None:
        # Water that spreads wets more and more of the walls: twice the rows, rather than compile a little later again.
        rows = min(max(grown(rows, n_receivers), 2 * rows), n_receivers)
        chosen = {"members": jnp.full(rows, n_receivers, jnp.int32), "place": jnp.full(n_receivers, rows, jnp.int32)}
    capacity = Capacity(grown(old.slots), grown(old.range), grown(old.range_round), rows if chosen else None)
    return replace(
        part,
        capacity=capacity,
        indices=jnp.zeros((capacity.slots, rows), jnp.int32),
        count=jnp.zeros(rows, jnp.int32),
        needed_slots=jnp.int32(0),
        needed_range=jnp.zeros(2, jnp.int32),
        needed_members=jnp.int32(0),
        **chosen,
    )
