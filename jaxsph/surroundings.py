"""Who is near whom while fluids move: one neighbor list for every pair of systems that meet.

Lists are built anew at the start of every block of steps, from a template that holds the sizes of their arrays. Nothing
of them is carried from block to block but what went wrong.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.health import BEYOND_SKIN, OUTSIDE, OVERFLOW, Health
from jaxsph.neighbors import Capacity, Domain, NeighborList, moved, neighbor_list
from jaxsph.pytree import replace
from jaxsph.walls import WallSummation

SKIN = 0.1
"""Of the support radius. A larger one makes builds rarer and every pass over the pairs longer."""

CAPACITY_MULTIPLIER = 1.4
"""Room for more neighbors than there are at the start: a lattice that breaks up crowds by a third."""


def pairs_of(scene) -> list[tuple[str, str]]:
    """Names of the systems that meet: receiver and sender."""
    fluids = [fluid.name for fluid in scene.fluids]
    pairs = [(a, b) for i, a in enumerate(fluids) for b in fluids[i:]]
    pairs += [(fluid, wall.name) for fluid in fluids for wall in scene.boundaries]
    return pairs + [(w.name, w.name) for w in scene.boundaries if fluids and isinstance(w.pressure, WallSummation)]


def allocate(scene, positions: dict, *, skin: float | None = None, capacity_multiplier: float = CAPACITY_MULTIPLIER):
    """Lists by "receiver-sender", from concrete positions (d, N) of every system.

    Args:
        scene: with fluids.
        positions: by name.
        skin: [m]; None takes `SKIN` support radii.
        capacity_multiplier: arrays are larger by this factor than these positions need.

    Raises ParticleOutside and ValueError as `NeighborSearch.allocate`.
    """
    cutoff = float(scene.kernel.support_radius(np.asarray(scene.smoothing_length)))
    skin = SKIN * cutoff if skin is None else skin
    domain = scene.domain
    if domain is None:
        everything = np.concatenate([np.asarray(p) for p in positions.values()], axis=1)
        domain = Domain.around(everything, 4.0 * float(np.max(np.ptp(everything, axis=1))) + 4 * cutoff)
    search = neighbor_list(domain, cutoff, skin, capacity_multiplier)
    lists = {}
    for a, b in pairs_of(scene):
        lists[f"{a}-{b}"] = search.template(positions[a], None if a == b else positions[b])
    return lists


def rebuild(scene, templates: dict, positions: dict) -> dict[str, NeighborList]:
    """The lists for new positions (d, N) by system, templates as from `topologies`. Inside jit; no derivatives."""
    positions = jax.lax.stop_gradient(positions)
    lists = {}
    for a, b in pairs_of(scene):
        template = templates[f"{a}-{b}"]
        domain = template.grid.domain
        search = neighbor_list(domain, template.cutoff, template.skin, 1.0, template.builder)
        lists[f"{a}-{b}"] = search.update(positions[a], template, None if a == b else positions[b])
    return lists


def note(health: Health, lists: dict[str, NeighborList], positions: dict, step) -> Health:
    """What is wrong with lists that were used until particles came to these positions."""
    positions = jax.lax.stop_gradient(positions)
    for name, neighbors in lists.items():
        a, b = name.split("-")
        sets = [neighbors] if neighbors.transpose is None else [neighbors, neighbors.transpose]
        outside = jnp.max(jnp.stack([part.outside for part in sets]))
        health = health.note(outside >= 0, OUTSIDE, step, outside, neighbors.indices.shape[1])
        needed = jnp.max(jnp.stack([part.needed_slots for part in sets]))
        health = health.note(neighbors.did_buffer_overflow, OVERFLOW, step, needed, neighbors.capacity.slots)
        closer = moved(neighbors, positions[a], None if a == b else positions[b])
        broken = ~((closer < neighbors.skin) | (closer == 0))
        health = health.note(broken & jnp.isfinite(closer), BEYOND_SKIN, step, closer, neighbors.skin)
    return health


def enlarged(neighbors: NeighborList, factor: float) -> NeighborList:
    """An empty list with arrays larger by a factor, as a template; its flags are cleared."""
    n_receivers = neighbors.indices.shape[1]
    if neighbors.transpose is None:
        return _empty(neighbors, factor, n_receivers)
    n_senders = neighbors.transpose.indices.shape[1]
    return replace(_empty(neighbors, factor, n_senders), transpose=_empty(neighbors.transpose, factor, n_receivers))


def _empty(part: NeighborList, factor: float, n_senders: int) -> NeighborList:
    def grown(n: int) -> int:
        return min(math.ceil(n * factor) + 1, n_senders) if n else 0

    old, n_receivers = part.capacity, part.indices.shape[1]
    capacity = Capacity(grown(old.slots), grown(old.range), grown(old.range_round))
    return replace(
        part,
        capacity=capacity,
        indices=jnp.zeros((capacity.slots, n_receivers), jnp.int32),
        count=jnp.zeros_like(part.count),
        needed_slots=jnp.int32(0),
        needed_range=jnp.zeros(2, jnp.int32),
    )
