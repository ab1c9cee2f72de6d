"""The sum over pairs of particles of different solids, and of solids and walls, that touch.

All solids and walls are one set of particles with one neighbor list; pairs within a body, or of two walls, do nothing.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxsph.effects import Contact
from jaxsph.materials.elastic import lame_parameters
from jaxsph.pair_sum import pair_sum
from jaxsph.pytree import pytree_dataclass

TOUCHING = "(solids)"
"""What the set of all solids and walls is called among the systems that have neighbor lists."""

LIST = f"{TOUCHING}-{TOUCHING}"

CROWDING = 2.2
"""Largest stiffness of a lattice of spacing r_0 in one direction, in that of a pair: between two particles 2, in the
middle of a cell 1.9 in 2D (4 pairs at 45 degrees) and 2.2 in 3D (8 pairs)."""


@pytree_dataclass
class Touching:
    """What of the particles that may touch does not change, (N,) each: those of all solids, then of all walls.

    Attributes:
        body: number of the solid; -1 for walls.
        spacing: of the particle's body [m].
        reach: distance to the nearest particle of another body at the start [m].
    """

    body: np.ndarray
    spacing: np.ndarray
    reach: np.ndarray


def bodies(scene) -> list:
    """What may touch: solids and walls."""
    return [*scene.solids, *scene.walls]


def largest_reach(scene) -> float:
    """The distance at which particles may begin to touch [m]."""
    return max(body.particles.spacing for body in bodies(scene))


def touching(scene, found: dict) -> Touching:
    """From the positions at the start. Outside jit."""
    from scipy.spatial import KDTree  # half a second of import, for scenes that need it

    orders = [found[body.name].order for body in bodies(scene)]
    places = [np.asarray(b.particles.positions, np.float64)[o] for b, o in zip(bodies(scene), orders, strict=True)]
    n_solids, counts = len(scene.solids), [len(place) for place in places]
    numbers = np.concatenate([np.arange(n_solids), np.full(len(scene.walls), -1)])
    body = np.repeat(numbers, counts)
    everything, period = np.concatenate(places), None
    if scene.domain is not None:
        everything, period = scene.domain.for_tree(everything)
    reach = np.full(len(everything), np.inf)
    for number in np.unique(body):
        own = body == number
        if not own.all():
            reach[own] = KDTree(everything[~own], boxsize=period).query(everything[own])[0]
    spacing = np.repeat([b.particles.spacing for b in bodies(scene)], counts)
    real = scene.dtype
    # An infinite one would be a NaN in a derivative.
    return Touching(body.astype(np.int32), spacing.astype(real), np.minimum(reach, largest_reach(scene)).astype(real))


def contact_strength(scene):
    """C M [Pa] of the scene's `Contact`."""
    contact = scene.effect(Contact)
    if contact.modulus is not None:
        modulus = contact.modulus
    elif scene.fluids:
        modulus = jnp.max(jnp.stack([jnp.asarray(f.density * f.sound_speed**2) for f in scene.fluids]))
    else:
        moduli = []
        for structure in scene.structures:
            lam, mu = lame_parameters(structure.youngs_modulus, structure.poisson_ratio)
            moduli.append(jnp.min(jnp.asarray(lam + 2 * mu)))
        modulus = jnp.min(jnp.stack(moduli))
    return jnp.asarray(contact.coefficient * modulus, scene.dtype)


def contact_forces(scene, references, placed, lists, *, forward_mode: bool = False) -> dict:
    """Force (d, N) [N, in 2D per meter] on the particles of every solid by what they touch."""
    of_pair, fields = _pairs(scene, references, placed, scene.effect(Contact).pair)
    total = pair_sum(of_pair, fields, fields, lists[LIST], symmetry=-1, forward_mode=forward_mode)
    ends = np.cumsum([body.n_particles for body in bodies(scene)])
    parts = jnp.split(total, ends[:-1].tolist(), axis=1)
    return {solid.name: part for solid, part in zip(scene.solids, parts, strict=False)}


def contact_energy(scene, references, placed, lists):
    """Energy stored by contact [J, in 2D per meter]."""
    of_pair, fields = _pairs(scene, references, placed, scene.effect(Contact).pair_energy)
    return 0.5 * jnp.sum(pair_sum(of_pair, fields, fields, lists[LIST], symmetry=1))


def _pairs(scene, references, placed, physics):
    """Physics of a pair of the whole set, and its fields."""
    strength, fixed = contact_strength(scene), references[TOUCHING]
    positions = jnp.concatenate([placed[body.name][0] for body in bodies(scene)], axis=1)
    volume = jnp.concatenate([_volume(references, body) for body in bodies(scene)])
    fields = {"position": positions, "volume": volume, "body": jnp.asarray(fixed.body, scene.dtype)}
    fields |= {"spacing": jnp.asarray(fixed.spacing), "reach": jnp.asarray(fixed.reach)}

    def of_pair(a, b):
        value = physics(a, b, scene.displacement(a["position"], b["position"]), strength)
        return jnp.where(a["body"] == b["body"], jnp.zeros_like(value), value)

    return of_pair, fields


def _volume(references, body):
    return jnp.broadcast_to(jnp.asarray(references[body.name].volume), (body.n_particles,))


def contact_time_step(scene, references):
    """Largest step [s] at which kicks by contact are stable, 2 / w; infinite without `Contact`.

    With masses m_a and springs k_ab, w^2 is at most max 2 sum_b k_ab / m_a. In a lattice of spacing s the sum in one
    direction is at most 2.2 max(1, r_0 / s)^d springs: as much as two bodies half a spacing deep give to a particle.
    """
    limit = jnp.asarray(jnp.inf, scene.dtype)
    if scene.effect(Contact) is None:
        return limit
    strength = contact_strength(scene)
    for solid in scene.solids:
        for other in bodies(scene):
            if other is solid:
                continue
            spacing = 0.5 * (solid.particles.spacing + other.particles.spacing)
            volume, beside = references[solid.name].volume, jnp.max(_volume(references, other))
            crowd = CROWDING * max(1.0, spacing / other.particles.spacing) ** scene.dimension
            springs = strength / spacing**2 * crowd * 2 * volume * beside / (volume + beside)
            squared = jnp.max(2 * springs / references[solid.name].mass)
            limit = jnp.minimum(limit, 2 / jnp.sqrt(jnp.maximum(squared, jnp.finfo(scene.dtype).tiny)))
    return limit
