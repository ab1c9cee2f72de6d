"""Rates of change: the sum of what the scene lists, and nothing else."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.effects import Damping, PenaltyForce
from jaxsph.structure import Reference, Structure, Topology, elastic_acceleration, reference, topology


def topologies(scene) -> dict[str, Topology]:
    """Neighbors of every structure in its reference configuration. Outside jit: it needs concrete positions."""
    return {structure.name: topology(structure) for structure in scene.systems}


def prepare(scene, topologies: dict[str, Topology]) -> dict[str, Reference]:
    """The reference configurations of all structures, differentiable in every number of the scene."""
    penalty = scene.effect(PenaltyForce) is not None
    return {s.name: reference(s, topologies[s.name], penalty=penalty) for s in scene.systems}


def accelerations(scene, references: dict[str, Reference], columns: dict, *, forward_mode: bool = False) -> dict:
    """Accelerations (d, N) [m/s^2] of all systems; zero for clamped particles.

    Args:
        scene: what is in the world.
        references: from `prepare`.
        columns: by system `displacement` and `velocity` (d, N).
        forward_mode: see `pair_sum`.
    """
    gravity = jnp.asarray(scene.gravity)[:, None]
    damping, penalty = scene.effect(Damping), scene.effect(PenaltyForce)
    out = {}
    for structure in scene.systems:
        ready, fields = references[structure.name], columns[structure.name]
        displacement = fields["displacement"]
        if "remainder" in fields:
            displacement = (displacement, fields["remainder"])
        total = elastic_acceleration(structure, ready, displacement, penalty, forward_mode=forward_mode)
        total = total + gravity
        if damping is not None:
            total = total + damping.acceleration(fields["velocity"])
        out[structure.name] = ready.moving * total
    return out


def constrain(scene, references: dict[str, Reference], columns: dict, time) -> dict:
    """Put clamped particles where their prescribed motion wants them at a time [s]."""
    out = dict(columns)
    for structure in scene.systems:
        if structure.motion is not None:
            ready, fields = references[structure.name], columns[structure.name]
            place, speed = prescribed(structure, ready, time)
            moving = ready.moving
            if "remainder" in fields:
                fields = {**fields, "remainder": moving * fields["remainder"]}
            out[structure.name] = {
                **fields,
                "displacement": moving * fields["displacement"] + (1 - moving) * place,
                "velocity": moving * fields["velocity"] + (1 - moving) * speed,
            }
    return out


def prescribed(structure: Structure, ready: Reference, time):
    """Displacement and velocity (d, N) that a structure's motion prescribes at a time [s]."""
    motion, positions = structure.motion, ready.positions.T
    assert motion is not None
    place, speed = jax.jvp(lambda t: motion(t, positions), (time,), (jnp.ones_like(time),))
    if place.shape != positions.shape:
        raise ValueError(f"motion of {structure.name!r} returned the shape {place.shape}; it must be {positions.shape}")
    return place.T, speed.T


POWER_ITERATIONS = 60
SAFETY = 0.9  # of the stable step: the power iteration comes from below, and stretched bodies get stiffer


def largest_stable_time_step(scene, references: dict[str, Reference]):
    """2 / w_max [s]: the limit of the kick-drift-kick step for the fastest vibration of the reference configuration.

    The frequency comes from a power iteration on the linearised elastic forces, so it holds for any kernel,
    arrangement of particles, law and penalty; it is of the order of the spacing over the p-wave speed.
    """
    highest = jnp.zeros((), scene.dtype)
    for structure in scene.systems:
        ready, penalty = references[structure.name], scene.effect(PenaltyForce)

        def stiffness(direction, structure=structure, ready=ready, penalty=penalty):
            force = lambda u: elastic_acceleration(structure, ready, u, penalty, forward_mode=True)  # noqa: E731
            return -ready.moving * jax.jvp(force, (jnp.zeros_like(direction),), (direction,))[1]

        start = np.random.default_rng(0).standard_normal(ready.positions.shape)
        vector = ready.moving * jnp.asarray(start, ready.positions.dtype)

        def iterate(carry, _, stiffness=stiffness):
            vector, _ = carry
            vector = vector / jnp.sqrt(jnp.maximum(jnp.sum(vector**2), jnp.finfo(vector.dtype).tiny))
            image = stiffness(vector)
            return (image, jnp.sqrt(jnp.sum(image**2))), None

        (_, squared), _ = jax.lax.scan(iterate, (vector, jnp.zeros((), vector.dtype)), length=POWER_ITERATIONS)
        highest = jnp.maximum(highest, squared)
    return 2 / jnp.sqrt(jnp.maximum(highest, jnp.finfo(highest.dtype).tiny))


def largest_stable(scene, found: dict[str, Topology]) -> float:
    """`largest_stable_time_step` as a plain number [s]. Outside of transformations.

    Raises ValueError if no particle can move.
    """
    if all(np.all(structure.clamped) for structure in scene.systems):
        raise ValueError("no particle of the scene can move: all are clamped")
    return float(_limit(scene, found))


def stable_time_step(scene, found: dict[str, Topology] | None = None) -> float:
    """The time step [s] that `simulate` takes by default: .9 of the largest stable one.

    Raises ValueError if no particle can move.
    """
    return SAFETY * largest_stable(scene, topologies(scene) if found is None else found)


@jax.jit
def _limit(scene, found):
    return largest_stable_time_step(scene, prepare(scene, found))
