"""Forces in elastic structures: equations (15) and (17) of the poster, and the penalty force.

Sources as in `jaxsph.structure`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name

from jaxsph.pair_sum import apply, pair_sum
from jaxsph.structure import Reference, Structure
from jaxsph.tensors import multiply, transpose


def difference(a, b):
    """a - b for displacements, or for pairs (displacement, remainder), whose high parts are subtracted first."""
    return jax.tree.reduce(jnp.add, jax.tree.map(jnp.subtract, a, b))


def displacement_gradient(reference: Reference, displacement, *, forward_mode: bool = False):
    """H = F - I, (d, d, N), from displacements (d, N) [m], or (displacement, remainder): equation (17)."""

    def of_pair(a, b, edge):
        return difference(b, a)[:, None] * edge["gradient"][None, :]

    uncorrected = pair_sum(
        of_pair, displacement, displacement, reference.neighbors, reference.edges, symmetry=1, forward_mode=forward_mode
    )
    return multiply(uncorrected, transpose(reference.correction) / reference.volume)


def elastic_acceleration(structure: Structure, reference: Reference, displacement, penalty=None, *, forward_mode=False):
    """Acceleration by the stresses, and by the penalty force if there is one: equation (15), (d, N) [m/s^2].

    displacement: (d, N) [m], or the pair (displacement, remainder).

    With volumes, m_a a_a = V_a sum_b V_b (P_a K_a + P_b K_b) grad W, in place of masses over densities squared. Where
    the density is uniform both are the same; where it is not, this one remains the gradient of the stored energy.
    """
    gradient = displacement_gradient(reference, displacement, forward_mode=forward_mode)
    gradient = checkpoint_name(gradient, "displacement_gradient")
    material = {**reference.uniform, **reference.varying}
    stress = structure.law.stress(gradient, material["lam"], material["mu"])
    direct = 0.0
    if penalty is not None:
        pulls = _over_penalty_pairs(
            penalty.pair, reference, displacement, gradient, {"force": -1, "stress": 1}, forward_mode
        )
        stress, direct = stress + pulls["stress"] / reference.volume, pulls["force"]
    traction = multiply(stress, reference.correction)

    def force(a, b, edge):
        return apply(a + b, edge["gradient"])

    total = pair_sum(
        force, traction, traction, reference.neighbors, reference.edges, symmetry=-1, forward_mode=forward_mode
    )
    return (total + direct) / (material["density"] * reference.volume)


def penalty_energy(reference: Reference, displacement, gradient, penalty):
    """Energy stored by the penalty force [J, in 2D per meter]."""
    return 0.5 * jnp.sum(_over_penalty_pairs(penalty.pair_energy, reference, displacement, gradient, 1, False))


def _over_penalty_pairs(of_pair, reference, displacement, gradient, symmetry, forward_mode):
    fields, uniform = {"displacement": displacement, "displacement_gradient": gradient}, {}
    of_modulus = fields if "youngs_modulus" in reference.varying else uniform
    of_modulus["youngs_modulus"] = {**reference.uniform, **reference.varying}["youngs_modulus"]

    def physics(a, b, edge):
        return of_pair({**uniform, **a}, {**uniform, **b}, difference(a["displacement"], b["displacement"]), edge)

    return pair_sum(
        physics, fields, fields, reference.neighbors, reference.edges, symmetry=symmetry, forward_mode=forward_mode
    )
