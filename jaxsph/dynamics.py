"""Rates of change: the sum of what the scene lists, and nothing else."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import surroundings
from jaxsph.checks import check_shape_of_motion
from jaxsph.contact import TOUCHING, bodies, contact_forces, touching
from jaxsph.effects import BodyForce, Contact, Damping, KelvinVoigt, PenaltyForce
from jaxsph.elastic_forces import elastic_acceleration
from jaxsph.flow import FluidReference, WallReference, forces
from jaxsph.pytree import is_concrete, one_if_alike, pytree_dataclass, replace
from jaxsph.rigid_body import RigidBody, RigidReference, rigid_acceleration, rigid_reference
from jaxsph.scene_checks import check_apart
from jaxsph.structure import Reference, Structure, reference, topology
from jaxsph.thin_wall import thin_wall


@pytree_dataclass
class Order:
    """The order of a system's particles in memory: near each other there if near in space.

    Attributes:
        order: (N,) the user's index of each particle in this order.
        rank: (N,) place in this order of each of the user's particles.
        thin: a `ThinWall` if it is a wall thinner than the support radius.
    """

    order: Any
    rank: Any
    thin: Any = None

    @classmethod
    def of(cls, order: np.ndarray, thin: Any = None) -> Order:
        """With the rank that belongs to an order."""
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        return cls(order.astype(np.int32), rank.astype(np.int32), thin)


def in_cell_order(scene, positions) -> np.ndarray:
    """The permutation (N,) that puts known positions (N, d) in the order of cells as wide as the support radius.

    It depends on nothing but where the particles are, so that a run that is continued has the order of one that was not
    interrupted, and the same bits.
    """
    positions = np.asarray(positions, np.float64)
    cells = np.floor(positions / float(scene.kernel.support_radius(np.asarray(scene.smoothing_length))))
    return np.lexsort([*positions.T[::-1], *cells.T[::-1]])


def topologies(scene, state=None, *, skin=None, capacity_multiplier=surroundings.CAPACITY_MULTIPLIER) -> dict[str, Any]:
    """What of the neighborhoods is fixed before any number is traced. Outside jit: it needs concrete positions.

    By structure the neighbors in its reference configuration, by other system the order of its particles, and by
    pair of systems that meet ("water-tank") a neighbor list, whose sizes are those that a run gets.

    Args:
        scene: with concrete positions.
        state: whose positions decide the sizes of the lists; None takes those of the start.
        skin: of the lists within a set [m]; None takes that of `surroundings.SKIN`. Lists between two sets take
            `surroundings.SKIN_BETWEEN_SETS` times as much.
        capacity_multiplier: room for more neighbors than there are now.

    Raises ValueError for traced positions, for fluids that start in walls, solids or each other, or for positions that
    `Structure` and `NeighborSearch.allocate` refuse.
    """
    found: dict[str, Any] = {structure.name: topology(structure) for structure in scene.structures}
    positions: dict[str, Any] = {}
    if state is None and is_concrete([system.particles.positions for system in scene.systems]):
        check_apart(scene)
    meeting = [*scene.fluids, *scene.boundaries] if scene.meets else scene.rigid_bodies
    for system in meeting:
        here, fields = system.particles.positions, {} if state is None else state.systems[system.name]
        if "position" in fields:
            here = fields["position"]
        elif "displacement" in fields:
            here = here + fields["displacement"]
        if not is_concrete(here, scene.smoothing_length if scene.fluids else None):
            raise ValueError(
                f"the positions of {system.name!r} or the smoothing length are traced, so neighbors cannot be found "
                "here; compute jaxsph.topologies(scene) outside of jit/grad and pass it as topologies_of_scene="
            )
        thin = None
        if scene.fluids and getattr(system, "thickness", None) is not None:
            # fluids meet whole cells, of which half is outside on either side
            beyond = system.particles.spacing if system.particles.on_surface else 0.0
            h = float(scene.smoothing_length)
            thin = thin_wall(scene.kernel, scene.dimension, system.thickness + beyond, h)
        if isinstance(system, Structure):
            order = found[system.name].order  # that of its reference configuration
            found[system.name] = replace(found[system.name], thin=thin)
        else:
            place = system.particles.positions if isinstance(system, RigidBody) else here
            order = in_cell_order(scene, place) if scene.fluids else np.arange(system.n_particles)
            found[system.name] = Order.of(order, thin)
        positions[system.name] = np.asarray(here)[order].T
    if scene.effect(Contact) is not None:
        found[TOUCHING] = touching(scene, found)
        positions[TOUCHING] = np.concatenate([positions[body.name] for body in bodies(scene)], axis=1)
    if scene.meets:
        # Known positions stay known inside jit too.
        with jax.ensure_compile_time_eval():
            positions = {name: jnp.asarray(place) for name, place in positions.items()}
            found |= surroundings.allocate(scene, positions, skin=skin, capacity_multiplier=capacity_multiplier)
    return found


def prepare(scene, topologies: dict[str, Any]) -> dict[str, Any]:
    """What of all systems does not change during a run, differentiable in every number of the scene."""
    penalty = scene.effect(PenaltyForce) is not None
    ready: dict[str, Any] = {s.name: reference(s, topologies[s.name], penalty=penalty) for s in scene.structures}
    for fluid in scene.fluids:
        mass = fluid.mass()
        ready[fluid.name] = FluidReference(mass[topologies[fluid.name].order] if jnp.ndim(mass) else mass)
    for wall in scene.walls:
        order, cells = topologies[wall.name].order, jnp.asarray(one_if_alike(wall.particles.cells))
        cells = cells[order] if cells.ndim else cells
        ready[wall.name] = WallReference(
            jnp.asarray(wall.particles.positions)[order].T, cells, topologies[wall.name].thin
        )
    for body in scene.rigid_bodies:
        ready[body.name] = rigid_reference(body, topologies[body.name].order, topologies[body.name].thin)
    if TOUCHING in topologies:
        ready[TOUCHING] = topologies[TOUCHING]
    return ready


def shared_if_alike(references: dict[str, Any]) -> dict[str, Any]:
    """References in which masses and cells that are alike are one number, which pair sums need not gather.

    `prepare` sees that they are if it runs where they are known; of a scene that is an argument of a compiled function
    it can't.
    """
    out = dict(references)
    for name, ready in references.items():
        if isinstance(ready, FluidReference):
            out[name] = replace(ready, mass=one_if_alike(ready.mass))
        elif isinstance(ready, WallReference):
            out[name] = replace(ready, cells=one_if_alike(ready.cells))
    return out


def place_boundaries(scene, references, columns, time) -> dict:
    """Positions, velocities and accelerations (d, N) of walls at a time [s], and of solids as they are.

    The acceleration of a solid counts as zero. Extrapolating the pressure with the one that it has would add mass
    to it, with a delay that makes light structures unstable.
    """
    placed = {wall.name: wall.placed(references[wall.name].positions, time) for wall in scene.walls}
    for solid in scene.solids:
        fields, positions = columns[solid.name], references[solid.name].positions
        velocity = fields.get("mean_velocity", fields["velocity"])
        placed[solid.name] = (positions + fields["displacement"], velocity, jnp.zeros_like(positions))
    return placed


def positions_of(scene, columns, placed) -> dict:
    """Positions (d, N) [m] of all systems whose neighbor lists are built anew; placed by `place_boundaries`."""
    positions = {fluid.name: columns[fluid.name]["position"] for fluid in scene.fluids}
    positions |= {name: place[0] for name, place in placed.items()}
    if scene.effect(Contact) is not None:
        positions[TOUCHING] = jnp.concatenate([positions[body.name] for body in bodies(scene)], axis=1)
    return positions


def velocities_of(scene, columns, placed) -> dict:
    """Velocities (d, N) [m/s] at which the particles of the systems of `positions_of` that move change their places."""
    velocities = {fluid.name: columns[fluid.name]["velocity"] for fluid in scene.fluids}
    velocities = {name: v + columns[name].get("shift", 0.0) for name, v in velocities.items()}
    velocities |= {wall.name: placed[wall.name][1] for wall in scene.walls if wall.moves}  # else it slides at most
    velocities |= {solid.name: placed[solid.name][1] for solid in scene.solids}
    if scene.effect(Contact) is not None:
        of_all = [velocities.get(body.name, jnp.zeros_like(placed[body.name][1])) for body in bodies(scene)]
        velocities[TOUCHING] = jnp.concatenate(of_all, axis=1)
    return velocities


def accelerations(
    scene, references, columns: dict, time, lists=None, placed=None, *, forward_mode: bool = False
) -> dict:
    """By solid and fluid what a step needs: `acceleration` (d, N) [m/s^2], and what effects remember.

    Of solids that meet something also `surface_acceleration`, the force per mass by fluids and contact. Zero for
    clamped particles.

    Args:
        scene: what is in the world.
        references: from `prepare`.
        columns: by system its fields (..., N).
        time: [s].
        lists: neighbor lists of the systems that meet.
        placed: from `place_boundaries`.
        forward_mode: see `pair_sum`.
    """
    out = meeting_forces(scene, references, columns, placed, lists, time, forward_mode=forward_mode)
    for structure in scene.structures:
        ready, fields = references[structure.name], columns[structure.name]
        own = structure_acceleration(scene, structure, ready, fields, time, forward_mode=forward_mode)
        met = out.get(structure.name, {})
        out[structure.name] = {**met, "acceleration": own + met.get("surface_acceleration", 0.0)}
    for body in scene.rigid_bodies:
        met = out.get(body.name, {})
        own = body_acceleration(scene, references[body.name], columns[body.name], time, met)
        out[body.name] = {**met, "acceleration": own}
    return out


def meeting_forces(scene, references, columns, placed, lists, time, *, forward_mode: bool = False) -> dict:
    """What systems do to each other: `flow.forces`, and contact in the `surface_acceleration` of solids."""
    out = {}
    if scene.fluids:
        out |= forces(scene, references, columns, placed, lists, time, forward_mode=forward_mode)
    if scene.effect(Contact) is not None:
        for name, force in contact_forces(scene, references, placed, lists, forward_mode=forward_mode).items():
            ready = references[name]
            before = out.get(name, {}).get("surface_acceleration", 0.0)
            out[name] = {"surface_acceleration": before + ready.moving * force / ready.mass}
    return out


def body_acceleration(scene, ready: RigidReference, fields, time, met: dict):
    """Acceleration (d, N) [m/s^2] of the particles of a rigid body by gravity, effects, and what it meets."""
    total = met.get("surface_acceleration", jnp.zeros_like(fields["velocity"]))
    total = _and_from_outside(scene, ready, fields, time, total)
    return rigid_acceleration(ready, fields, total)


def _and_from_outside(scene, ready, fields, time, total):
    damping = scene.effect(Damping)
    total = total + jnp.asarray(scene.gravity)[:, None]
    if damping is not None:
        total = total + damping.acceleration(fields["velocity"])
    for effect in scene.effects:
        if isinstance(effect, BodyForce):
            total = total + effect.acceleration(ready.positions + fields["displacement"], time)
    return total


def structure_acceleration(scene, structure, ready: Reference, fields, time, *, forward_mode: bool = False):
    """Acceleration (d, N) [m/s^2] of a structure by its stresses and what acts from outside, without fluids."""
    penalty = scene.effect(PenaltyForce)
    displacement = fields["displacement"]
    if "remainder" in fields:
        displacement = (displacement, fields["remainder"])
    friction = scene.effect(KelvinVoigt)
    if friction is not None:
        displacement = friction.ahead(displacement, fields["velocity"])
    total = elastic_acceleration(structure, ready, displacement, penalty, forward_mode=forward_mode)
    return ready.moving * _and_from_outside(scene, ready, fields, time, total)


def constrain(scene, references: dict[str, Any], columns: dict, time) -> dict:
    """Put clamped particles where their prescribed motion wants them at a time [s]."""
    out = dict(columns)
    for structure in scene.structures:
        out[structure.name] = held(structure, references[structure.name], columns[structure.name], time)
    return out


def held(structure: Structure, ready: Reference, fields: dict, time) -> dict:
    """The fields of a structure with its clamped particles where their motion wants them at a time [s]."""
    if structure.motion is None:
        return fields
    place, speed = prescribed(structure, ready, time)
    moving = ready.moving
    if "remainder" in fields:
        fields = {**fields, "remainder": moving * fields["remainder"]}
    return {
        **fields,
        "displacement": moving * fields["displacement"] + (1 - moving) * place,
        "velocity": moving * fields["velocity"] + (1 - moving) * speed,
    }


def prescribed(structure: Structure, ready: Reference, time):
    """Displacement and velocity (d, N) that a structure's motion prescribes at a time [s]."""
    motion, positions = structure.motion, ready.positions.T
    assert motion is not None
    place, speed = jax.jvp(lambda t: motion(t, positions), (time,), (jnp.ones_like(time),))
    check_shape_of_motion(structure.name, place, positions)
    return place.T, speed.T
