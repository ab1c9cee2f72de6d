"""Rates of change: the sum of what the scene lists, and nothing else."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import surroundings
from jaxsph.effects import BodyForce, Damping, PenaltyForce
from jaxsph.flow import FluidReference, WallReference, forces
from jaxsph.pytree import is_concrete, pytree_dataclass
from jaxsph.structure import Reference, Structure, elastic_acceleration, reference, topology


@pytree_dataclass
class Order:
    """The order of a system's particles in memory: near each other there if near in space.

    Attributes:
        order: (N,) the user's index of each particle in this order.
        rank: (N,) place in this order of each of the user's particles.
    """

    order: Any
    rank: Any

    @classmethod
    def of(cls, order: np.ndarray) -> Order:
        """With the rank that belongs to an order."""
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        return cls(order.astype(np.int32), rank.astype(np.int32))


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

    By structure the neighbors in its reference configuration, by fluid and wall the order of its particles, and by
    pair of systems that meet ("water-tank") a neighbor list, whose sizes are those that a run gets.

    Args:
        scene: with concrete positions.
        state: whose positions decide the sizes of the lists; None takes those of the start.
        skin: of the lists [m]; None takes `surroundings.SKIN` support radii.
        capacity_multiplier: room for more neighbors than there are now.

    Raises ValueError for traced positions, or those that `Structure` and `NeighborSearch.allocate` refuse.
    """
    found: dict[str, Any] = {structure.name: topology(structure) for structure in scene.structures}
    positions: dict[str, Any] = {}
    for system in [*scene.fluids, *scene.walls]:
        here = system.particles.positions
        if state is not None and "position" in state.systems[system.name]:
            here = state.systems[system.name]["position"]
        if not is_concrete(here, scene.smoothing_length):
            raise ValueError(
                f"the positions of {system.name!r} or the smoothing length are traced, so neighbors cannot be found "
                "here; compute jaxsph.topologies(scene) outside of jit/grad and pass it as topologies_of_scene="
            )
        order = in_cell_order(scene, here)
        found[system.name] = Order.of(order)
        positions[system.name] = np.asarray(here)[order].T
    if scene.fluids:
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
        order, volumes = topologies[wall.name].order, wall.particles.volumes
        if is_concrete(volumes) and np.ptp(volumes) <= 1e-6 * np.max(volumes):
            volume = jnp.asarray(np.mean(volumes, dtype=np.float64), scene.dtype)
        else:
            volume = jnp.asarray(volumes)[order]
        ready[wall.name] = WallReference(jnp.asarray(wall.particles.positions)[order].T, volume)
    return ready


def place_walls(scene, references, time) -> dict:
    """Positions, velocities and accelerations (d, N) of all walls at a time [s]."""
    return {wall.name: wall.placed(references[wall.name].positions, time) for wall in scene.walls}


def positions_of(scene, columns, placed) -> dict:
    """Positions (d, N) [m] of all systems that have neighbor lists which are built anew."""
    positions = {fluid.name: columns[fluid.name]["position"] for fluid in scene.fluids}
    return positions | {name: place[0] for name, place in placed.items()}


def accelerations(
    scene, references, columns: dict, time, lists=None, placed=None, *, forward_mode: bool = False
) -> dict:
    """By structure and fluid what a step needs: `acceleration` (d, N) [m/s^2], and what effects remember.

    Zero for clamped particles.

    Args:
        scene: what is in the world.
        references: from `prepare`.
        columns: by system its fields (..., N).
        time: [s].
        lists: neighbor lists of the fluids.
        placed: from `place_walls`.
        forward_mode: see `pair_sum`.
    """
    gravity = jnp.asarray(scene.gravity)[:, None]
    damping, penalty = scene.effect(Damping), scene.effect(PenaltyForce)
    out = {}
    for structure in scene.structures:
        ready, fields = references[structure.name], columns[structure.name]
        displacement = fields["displacement"]
        if "remainder" in fields:
            displacement = (displacement, fields["remainder"])
        total = elastic_acceleration(structure, ready, displacement, penalty, forward_mode=forward_mode)
        total = total + gravity
        if damping is not None:
            total = total + damping.acceleration(fields["velocity"])
        for effect in scene.effects:
            if isinstance(effect, BodyForce):
                total = total + effect.acceleration(ready.positions + fields["displacement"], time)
        out[structure.name] = {"acceleration": ready.moving * total}
    if scene.fluids:
        out |= forces(scene, references, columns, placed, lists, time, forward_mode=forward_mode)
    return out


def constrain(scene, references: dict[str, Any], columns: dict, time) -> dict:
    """Put clamped particles where their prescribed motion wants them at a time [s]."""
    out = dict(columns)
    for structure in scene.structures:
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
SOUND_LIMIT, VISCOUS_LIMIT = 0.8, 0.25
SAFETY = 0.9  # of the stable step: the power iteration comes from below, and stretched bodies get stiffer


def largest_stable_time_step(scene, references: dict[str, Any]):
    """2 / w_max [s]: the limit of the kick-drift-kick step for the fastest vibration of the reference configuration.

    The frequency comes from a power iteration on the linearised elastic forces, so it holds for any kernel,
    arrangement of particles, law and penalty; it is of the order of the spacing over the p-wave speed.
    """
    highest = jnp.zeros((), scene.dtype)
    for structure in scene.structures:
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
    limit = 2 / jnp.sqrt(jnp.maximum(highest, jnp.finfo(highest.dtype).tiny))
    for fluid in scene.fluids:
        limit = jnp.minimum(limit, fluid_time_step(scene, fluid))
    return limit


def fluid_time_step(scene, fluid):
    """Largest stable time step [s] of a fluid: that of sound, or of viscosity if that is shorter.

    Sound: 1.1 h / c, where the fastest standing wave of disordered particles turns by 2 in a step. Viscosity: as the
    explicit diffusion of a wave that alternates from particle to particle, h^2 / (4 nu). Both measured, see
    docs/formulation.md.
    """
    h = scene.smoothing_length
    limit = jnp.asarray(SOUND_LIMIT * h / fluid.sound_speed)
    if fluid.viscosity is not None:
        nu = fluid.viscosity / fluid.density
        limit = jnp.minimum(limit, VISCOUS_LIMIT * h**2 / jnp.maximum(nu, jnp.finfo(scene.dtype).tiny))
    return limit


def largest_stable(scene, found: dict[str, Any]) -> float:
    """`largest_stable_time_step` as a plain number [s]. Outside of transformations.

    Raises ValueError if no particle can move.
    """
    if not scene.fluids and all(np.all(structure.clamped) for structure in scene.structures):
        raise ValueError("no particle of the scene can move: all are clamped")
    return float(_limit(scene, found))


def stable_time_step(scene, found: dict[str, Any] | None = None) -> float:
    """The time step [s] that `simulate` takes by default: .9 of the largest stable one.

    Raises ValueError if no particle can move.
    """
    return SAFETY * largest_stable(scene, topologies(scene) if found is None else found)


@jax.jit
def _limit(scene, found):
    return largest_stable_time_step(scene, prepare(scene, found))
