"""What is observed of elastic structures."""

from __future__ import annotations

import jax.numpy as jnp

from jaxsph.elastic_forces import displacement_gradient
from jaxsph.materials.elastic import cauchy_stress, von_mises
from jaxsph.structure import Structure, reference, topology


def of_structure(scene, state, structure, found=None, *, penalty: bool = False):
    """The order of a structure's particles, its reference, and its fields in that order (..., N)."""
    order = topology(structure) if found is None else found[structure.name]
    fields = {name: jnp.moveaxis(v[order.order], 0, -1) for name, v in state.systems[structure.name].items()}
    return order, reference(structure, order, penalty=penalty), fields


def stresses(scene, state, name: str, found=None) -> dict:
    """Stresses and deformation of a structure, in the user's order.

    Args:
        scene, state: one state (not a trajectory; see `Trajectory.observe`).
        name: of the structure.
        found: from `topologies`, if it is at hand; needed if positions are traced.

    Returns:
        `deformation_gradient`, `pk1`, `cauchy` (N, d, d) and `von_mises` (N,); stresses in Pa.

    Raises ValueError for a system that is not a `Structure`.
    """
    structure = scene[name]
    if not isinstance(structure, Structure):
        raise ValueError(f"{name!r} is a {type(structure).__name__}; stresses are those of a Structure")
    order, ready, fields = of_structure(scene, state, structure, found)
    material = {**ready.uniform, **ready.varying}
    gradient = displacement_gradient(ready, fields["displacement"])
    pk1 = structure.law.stress(gradient, material["lam"], material["mu"])
    cauchy = cauchy_stress(gradient, pk1)
    columns = {
        "deformation_gradient": gradient + jnp.eye(scene.dimension, dtype=gradient.dtype)[:, :, None],
        "pk1": pk1,
        "cauchy": cauchy,
        "von_mises": von_mises(cauchy, material["poisson_ratio"]),
    }
    return {key: jnp.moveaxis(value, -1, 0)[order.rank] for key, value in columns.items()}
