"""Rates of change: the sum of what the scene lists, and nothing else."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import surroundings
from jaxsph.contact import TOUCHING, bodies, contact_forces, contact_time_step, touching
from jaxsph.effects import AcousticDamper, ArtificialViscosity, BodyForce, Contact, Damping, KelvinVoigt, PenaltyForce
from jaxsph.flow import FluidReference, WallReference, forces
from jaxsph.pytree import is_concrete, pytree_dataclass, replace
from jaxsph.rigid_body import RigidBody, RigidReference, rigid_acceleration, rigid_reference
from jaxsph.state import State, to_columns
from jaxsph.structure import Reference, Structure, elastic_acceleration, reference, topology
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
        skin: of the lists within a set [m]; None takes `surroundings.SKIN` support radii. Lists between two sets take
            `surroundings.SKIN_BETWEEN_SETS` times as much.
        capacity_multiplier: room for more neighbors than there are now.

    Raises ValueError for traced positions, or those that `Structure` and `NeighborSearch.allocate` refuse.
    """
    found: dict[str, Any] = {structure.name: topology(structure) for structure in scene.structures}
    positions: dict[str, Any] = {}
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
        order, cells = topologies[wall.name].order, wall.particles.cells
        if is_concrete(cells) and np.ptp(cells) <= 1e-6 * np.max(cells):
            cells = jnp.asarray(np.mean(cells, dtype=np.float64), scene.dtype)
        else:
            cells = jnp.asarray(cells)[order]
        ready[wall.name] = WallReference(
            jnp.asarray(wall.particles.positions)[order].T, cells, topologies[wall.name].thin
        )
    for body in scene.rigid_bodies:
        ready[body.name] = rigid_reference(body, topologies[body.name].order, topologies[body.name].thin)
    if TOUCHING in topologies:
        ready[TOUCHING] = topologies[TOUCHING]
    return ready


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
    """Velocities (d, N) [m/s] at which the particles of every system of `positions_of` change their places."""
    velocities = {fluid.name: columns[fluid.name]["velocity"] for fluid in scene.fluids}
    velocities = {name: v + columns[name].get("shift", 0.0) for name, v in velocities.items()}
    # A wall that only slides does not move.
    velocities |= {
        wall.name: placed[wall.name][1] if wall.moves else jnp.zeros_like(placed[wall.name][0]) for wall in scene.walls
    }
    velocities |= {solid.name: placed[solid.name][1] for solid in scene.solids}
    if scene.effect(Contact) is not None:
        velocities[TOUCHING] = jnp.concatenate([velocities[body.name] for body in bodies(scene)], axis=1)
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
    if place.shape != positions.shape:
        raise ValueError(f"motion of {structure.name!r} returned the shape {place.shape}; it must be {positions.shape}")
    return place.T, speed.T


POWER_ITERATIONS = 60
SOUND_LIMIT, VISCOUS_LIMIT, SOUND_RINGS = 0.8, 0.25, 1.1  # of h / c, of h^2 / nu; the h / c at which sound is unstable
SAFETY = 0.9  # of the stable step: the power iteration comes from below, and stretched bodies get stiffer


def largest_stable_time_step(
    scene, references: dict[str, Any], substeps: tuple | None = None, columns: dict | None = None
):
    """Largest stable step [s] of a scene: of its structures, `structure_time_step`; with fluids, `fluid_time_step`.

    columns: by structure the fields of a state, in which they are deformed; None takes the reference configuration.

    In a scene with fluids structures take many small steps in one of the fluids: they limit it only if it is known how
    many, substeps = (("plate", 12), ...).
    """
    limit = jnp.asarray(jnp.inf, scene.dtype)
    for structure in scene.structures:
        steps = 1 if not scene.fluids else dict(substeps or ()).get(structure.name)
        if steps is not None:
            here = None if columns is None else columns[structure.name]["displacement"]
            limit = jnp.minimum(limit, steps * structure_time_step(scene, structure, references[structure.name], here))
    touching = contact_time_step(scene, references)
    if not scene.fluids:
        # Both act on the same particles in one step: the squares of the frequencies add up.
        return limit if scene.effect(Contact) is None else 1 / jnp.sqrt(1 / limit**2 + 1 / touching**2)
    for fluid in scene.fluids:
        limit = jnp.minimum(limit, fluid_time_step(scene, fluid))
        for solid in scene.solids:
            if solid.thickness is not None:
                limit = jnp.minimum(limit, plate_time_step(scene, fluid, solid))
    return jnp.minimum(limit, touching)


def plate_time_step(scene, fluid, structure):
    """Largest stable time step [s] for a plate beside a fluid: that of its mass on the spring of the fluid.

    The layer of fluid at a plate resists its motion with the stiffness rho c^2 / dx, per area and per length; with the
    mass rho_s t per area of the plate the frequency is c sqrt(rho / (rho_s t dx)). The step is 1 over that, half of
    what one side of the plate would allow: both sides may be wet, and the fluid be denser for a moment.
    """
    ratio = jnp.min(structure.density) / fluid.density
    return jnp.sqrt(ratio * structure.thickness * scene.spacing) / fluid.sound_speed


def structure_time_step(scene, structure, ready: Reference, displacement=None):
    """2 / w_max [s], less with friction: the limit of kick-drift-kick for the fastest vibration about a displacement.

    The frequency comes from a power iteration on the linearised elastic forces, so it holds for any kernel,
    arrangement of particles, law and penalty; it is of the order of the spacing over the p-wave speed. Bodies that are
    stretched by a part of their length vibrate faster.

    displacement: (d, N) [m]; None takes the reference configuration.
    """
    penalty = scene.effect(PenaltyForce)
    here = jnp.zeros_like(ready.positions) if displacement is None else displacement

    def stiffness(direction):
        force = lambda u: elastic_acceleration(structure, ready, u, penalty, forward_mode=True)  # noqa: E731
        return -ready.moving * jax.jvp(force, (here,), (direction,))[1]

    start = np.random.default_rng(0).standard_normal(ready.positions.shape)
    vector = ready.moving * jnp.asarray(start, ready.positions.dtype)

    def iterate(carry, _):
        vector, _ = carry
        vector = vector / jnp.sqrt(jnp.maximum(jnp.sum(vector**2), jnp.finfo(vector.dtype).tiny))
        image = stiffness(vector)
        return (image, jnp.sqrt(jnp.sum(image**2))), None

    (_, squared), _ = jax.lax.scan(iterate, (vector, jnp.zeros((), vector.dtype)), length=POWER_ITERATIONS)
    limit, friction = 2 / jnp.sqrt(jnp.maximum(squared, jnp.finfo(squared.dtype).tiny)), scene.effect(KelvinVoigt)
    return limit if friction is None else friction.stable(limit)


def fluid_time_step(scene, fluid):
    """Largest stable time step [s] of a fluid: that of sound, or of what damps it or of viscosity if that is shorter.

    Sound: 1.1 h / c, where the fastest standing wave of disordered particles turns by 2 in a step. Viscosity: as the
    explicit diffusion of a wave that alternates from particle to particle, h^2 / (4 nu). SOUND_LIMIT leaves room below
    the first: a rotating square whose arms are under tension gains energy at 1.1 h / c, four other scenes none up to
    1.4 (F35 in docs/validation.md). The second is not swept.

    A damper takes the share alpha (h / c) w^2 of its speed from a standing wave of the frequency w, by the rate of the
    step before. With that a kick-drift-kick of the step dt is stable while (w dt)^2 + 2 alpha (h / c) w^2 dt < 4; if
    the fastest wave allows dt = S h / c without a damper, that is dt = (sqrt(alpha^2 + S^2) - alpha) h / c. Artificial
    viscosity damps it by three times its kinematic viscosity, alpha h c / (2 (d + 2)), while all pairs approach: it counts
    as that much more of a damper, with S = 1.1, so that it limits the step from about 1 on. Its beta is not counted.
    """
    h = scene.smoothing_length
    limit, share = jnp.asarray(SOUND_LIMIT * h / fluid.sound_speed), 0.0
    damper, artificial = scene.effect(AcousticDamper), scene.effect(ArtificialViscosity)
    if damper is not None:
        share = damper.alpha
        limit = _damped(share, SOUND_LIMIT) * h / fluid.sound_speed
    if artificial is not None:
        share = share + 1.5 * artificial.alpha / (scene.dimension + 2)
        limit = jnp.minimum(limit, _damped(share, SOUND_RINGS) * h / fluid.sound_speed)
    if fluid.viscosity is not None:
        nu = fluid.viscosity / fluid.density
        limit = jnp.minimum(limit, VISCOUS_LIMIT * h**2 / jnp.maximum(nu, jnp.finfo(scene.dtype).tiny))
    return limit


def _damped(share, undamped):
    return jnp.sqrt(share**2 + undamped**2) - share


def largest_stable(scene, found: dict[str, Any], columns: dict | None = None) -> float:
    """`largest_stable_time_step` as a plain number [s], infinite for rigid bodies alone. Of plain numbers.

    Raises ValueError if no particle can move.
    """
    free = bool(scene.fluids or scene.rigid_bodies)
    if not free and all(np.all(structure.clamped) for structure in scene.structures):
        raise ValueError("no particle of the scene can move: all are clamped")
    with jax.ensure_compile_time_eval():  # inside of jit too, where another argument is traced
        return float(_limit(scene, found, columns))


def safe(limit: float) -> float:
    """`SAFETY` of the largest stable step [s]. Raises ValueError if there is none."""
    if not math.isfinite(limit):
        raise ValueError("nothing in the scene limits the time step, rigid bodies alone do not; pass time_step=")
    return SAFETY * limit


def stable_time_step(scene, found: dict[str, Any] | None = None, state: State | None = None) -> float:
    """The time step [s] that `simulate` takes by default: .9 of the largest stable one.

    With fluids that is theirs; `stable_substeps` says into how many steps structures divide it.

    state: whose deformation decides, of a scene without fluids; None takes the reference configuration, as `simulate`
        does. For a run in which bodies stretch by much, the step of its most stretched state is the one to pass.

    Raises ValueError if no particle can move, nothing limits the step, or a state is given of a scene with fluids.
    """
    found = topologies(scene) if found is None else found
    if state is not None and scene.fluids:
        raise ValueError("state= is for scenes without fluids: beside a fluid structures take substeps of its step")
    columns = None if state is None else to_columns(state.systems, found)
    return safe(largest_stable(scene, found, columns))


def stable_substeps(scene, time_step: float, found: dict[str, Any] | None = None) -> dict[str, int]:
    """By structure the number of steps that it takes within one of the fluids [s]: .9 of its largest stable, or less.

    Of a scene without fluids all are 1. For a fit take the stiffest and lightest scene that can occur.
    """
    if not scene.fluids:
        return {structure.name: 1 for structure in scene.structures}
    limits = structure_limits(scene, topologies(scene) if found is None else found)
    return {name: max(1, math.ceil(float(time_step) / (SAFETY * limit))) for name, limit in limits.items()}


def structure_limits(scene, found: dict[str, Any]) -> dict[str, float]:
    """By structure its largest stable step [s], as a plain number. Of plain numbers."""
    with jax.ensure_compile_time_eval():
        return {name: float(limit) for name, limit in _structure_limits(scene, found).items()}


@jax.jit
def _limit(scene, found, columns=None):
    return largest_stable_time_step(scene, prepare(scene, found), None, columns)


@jax.jit
def _structure_limits(scene, found):
    references = prepare(scene, found)
    return {s.name: structure_time_step(scene, s, references[s.name]) for s in scene.structures}
