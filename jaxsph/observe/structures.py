"""Observers: pure functions of a scene and a state."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxsph.dynamics import prepare, topologies
from jaxsph.effects import PenaltyForce
from jaxsph.materials.elastic import cauchy_stress, lame_parameters, von_mises
from jaxsph.state import to_columns
from jaxsph.structure import displacement_gradient, penalty_energy


def _columns(scene, state, found):
    found = topologies(scene) if found is None else found
    return found, prepare(scene, found), to_columns(state.systems, found)


def stresses(scene, state, name: str, found=None) -> dict:
    """Stresses and deformation of a structure, in the user's order.

    Args:
        scene, state: one state (not a trajectory; use jax.vmap over its states).
        name: of the structure.
        found: from `topologies`, if it is at hand.

    Returns:
        `deformation_gradient`, `pk1`, `cauchy` (N, d, d) and `von_mises` (N,); stresses in Pa.
    """
    structure = scene[name]
    found, references, columns = _columns(scene, state, found)
    material = {**references[name].uniform, **references[name].varying}
    gradient = displacement_gradient(references[name], columns[name]["displacement"])
    pk1 = structure.law.stress(gradient, material["lam"], material["mu"])
    cauchy = cauchy_stress(gradient, pk1)
    columns_out = {
        "deformation_gradient": gradient + jnp.eye(scene.dimension, dtype=gradient.dtype)[:, :, None],
        "pk1": pk1,
        "cauchy": cauchy,
        "von_mises": von_mises(cauchy, material["poisson_ratio"]),
    }
    return {key: jnp.moveaxis(value, -1, 0)[found[name].rank] for key, value in columns_out.items()}


def energies(scene, state, found=None) -> dict:
    """Kinetic, elastic and gravitational energy of all structures [J, or J/m in 2D], and their sum `total`.

    The elastic energy includes that of the penalty force. The gravitational energy counts from the reference
    configuration. Clamped particles do not count as kinetic.
    """
    found, references, columns = _columns(scene, state, found)
    penalty = scene.effect(PenaltyForce)
    kinetic = elastic = gravitational = jnp.zeros((), scene.dtype)
    for structure in scene.structures:
        ready, fields = references[structure.name], columns[structure.name]
        material = {**ready.uniform, **ready.varying}
        mass = material["density"] * ready.volume
        gradient = displacement_gradient(ready, fields["displacement"])
        lam, mu = lame_parameters(material["youngs_modulus"], material["poisson_ratio"])
        kinetic += 0.5 * jnp.sum(ready.moving * mass * jnp.sum(fields["velocity"] ** 2, axis=0))
        elastic += jnp.sum(ready.volume * structure.law.energy_density(gradient, lam, mu))
        if penalty is not None:
            elastic += penalty_energy(ready, fields["displacement"], gradient, penalty)
        height = jnp.sum(jnp.asarray(scene.gravity)[:, None] * fields["displacement"], axis=0)
        gravitational -= jnp.sum(mass * height)
    return {
        "kinetic": kinetic,
        "elastic": elastic,
        "gravitational": gravitational,
        "total": kinetic + elastic + gravitational,
    }


def linear_momentum(scene, state) -> jax.Array:
    """Linear momentum of all structures (d,) [kg m/s, or per m in 2D]."""
    total = jnp.zeros((scene.dimension,), scene.dtype)
    for structure in scene.systems:
        mass = jnp.asarray(structure.density * structure.particles.volumes)
        total += jnp.sum(mass[:, None] * state.systems[structure.name]["velocity"], axis=0)
    return total
