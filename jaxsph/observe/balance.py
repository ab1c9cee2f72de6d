"""What mechanics conserves: energies and momenta of a whole scene. Walls have none, they are moved from outside."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxsph.contact import LIST, TOUCHING, contact_energy
from jaxsph.dynamics import place_boundaries, positions_of, prepare, topologies
from jaxsph.effects import Contact, PenaltyForce
from jaxsph.elastic_forces import displacement_gradient, penalty_energy
from jaxsph.materials.elastic import lame_parameters
from jaxsph.observe.structures import of_structure
from jaxsph.state import to_columns
from jaxsph.surroundings import rebuild


def energies(scene, state, found=None) -> dict:
    """Energies of all structures, rigid bodies and fluids [J, in 2D per meter].

    Args:
        scene, state: one state.
        found: from `topologies`, if it is at hand; needed if positions of structures are traced.

    Returns:
        `kinetic`: without clamped particles.
        `elastic`: of structures, with that of the penalty force.
        `contact`: what `Contact` stores.
        `internal`: of fluids, what their compression stores: `StateEquation.energy`.
        `gravitational`: of solids -m g . u, from the reference configuration; of fluids -m g . x, from the origin.
            In a periodic domain with gravity along a periodic axis it jumps where a particle leaves the box.
        `total`: their sum. What `WallRepulsion` stores while particles are close to a wall is not in it.
    """
    penalty, gravity = scene.effect(PenaltyForce), jnp.asarray(scene.gravity)
    kinetic = elastic = internal = gravitational = jnp.zeros((), scene.dtype)
    for structure in scene.structures:
        _, ready, fields = of_structure(scene, state, structure, found, penalty=penalty is not None)
        material = {**ready.uniform, **ready.varying}
        mass = material["density"] * ready.volume
        gradient = displacement_gradient(ready, fields["displacement"])
        lam, mu = lame_parameters(material["youngs_modulus"], material["poisson_ratio"])
        kinetic += 0.5 * jnp.sum(ready.moving * mass * jnp.sum(fields["velocity"] ** 2, axis=0))
        elastic += jnp.sum(ready.volume * structure.law.energy_density(gradient, lam, mu))
        if penalty is not None:
            elastic += penalty_energy(ready, fields["displacement"], gradient, penalty)
        gravitational -= jnp.sum(mass * jnp.sum(gravity[:, None] * fields["displacement"], axis=0))
    for body in scene.rigid_bodies:
        fields, mass = state.systems[body.name], jnp.asarray(body.density * body.particles.volumes)
        kinetic += 0.5 * jnp.sum(mass * jnp.sum(fields["velocity"] ** 2, axis=1))
        gravitational -= jnp.sum(mass * jnp.sum(gravity * fields["displacement"], axis=1))
    for fluid in scene.fluids:
        fields, mass = state.systems[fluid.name], fluid.mass()
        if "pressure" in fields:
            stored = 0.5 * (fields["pressure"] / (fluid.density * fluid.sound_speed)) ** 2
        else:
            stored = fluid.state_equation.energy(fields["density_deviation"], fluid.density, fluid.sound_speed)
        kinetic += 0.5 * jnp.sum(mass * jnp.sum(fields["velocity"] ** 2, axis=1))
        internal += jnp.sum(mass * stored)
        gravitational -= jnp.sum(mass * jnp.sum(gravity * fields["position"], axis=1))
    contact = _contact(scene, state, found)
    return {
        "kinetic": kinetic,
        "elastic": elastic,
        "contact": contact,
        "internal": internal,
        "gravitational": gravitational,
        "total": kinetic + elastic + contact + internal + gravitational,
    }


def _contact(scene, state, found):
    """Energy of contact; not a number if the neighbor lists are too small for a state."""
    if scene.effect(Contact) is None:
        return jnp.zeros((), scene.dtype)
    found = topologies(scene, capacity_multiplier=2.0) if found is None else found
    references, columns = prepare(scene, found), to_columns(state.systems, found)
    placed = place_boundaries(scene, references, columns, state.time)
    lists = rebuild(scene, found, positions_of(scene, columns, placed), [(TOUCHING, TOUCHING)])
    return jnp.where(lists[LIST].is_wrong, jnp.nan, contact_energy(scene, references, placed, lists))


def linear_momentum(scene, state) -> jax.Array:
    """Linear momentum of all particles of solids and fluids (d,) [kg m/s, in 2D per meter], clamped ones too."""
    total = jnp.zeros((scene.dimension,), scene.dtype)
    for mass, _, velocity in _moving(scene, state):
        total += jnp.sum(mass[:, None] * velocity, axis=0)
    return total


def angular_momentum(scene, state, about=None) -> jax.Array:
    """Angular momentum of all solids and fluids [kg m^2/s, in 2D per meter]: sum m (x - x_0) x v.

    Args:
        scene, state: one state. In a periodic domain angular momentum is not defined.
        about: x_0 (d,) [m]; None is the origin.

    Returns: in 2D one number, counterclockwise; in 3D (3,).

    Raises ValueError if the domain is periodic.
    """
    if scene.domain is not None and any(scene.domain.periodic):
        raise ValueError("angular momentum needs a point to count from, and a periodic domain has none")
    about = jnp.zeros((scene.dimension,), scene.dtype) if about is None else jnp.asarray(about, scene.dtype)
    total = jnp.zeros(() if scene.dimension == 2 else (3,), scene.dtype)
    for mass, position, velocity in _moving(scene, state):
        spin = jnp.cross(position - about, velocity)
        total += jnp.sum(mass * spin if scene.dimension == 2 else mass[:, None] * spin, axis=0)
    return total


def _moving(scene, state):
    """Masses (N,), positions and velocities (N, d) of every solid and fluid, clamped particles included."""
    for system in [*scene.solids, *scene.fluids]:
        fields, particles = state.systems[system.name], system.particles
        fluid = "position" in fields
        position = fields["position"] if fluid else jnp.asarray(particles.positions) + fields["displacement"]
        mass = system.mass() if fluid else jnp.asarray(system.density * particles.volumes)
        yield jnp.broadcast_to(mass, position.shape[:1]), position, fields["velocity"]
