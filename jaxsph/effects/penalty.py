"""The force against zero-energy modes of total-Lagrangian SPH."""

from __future__ import annotations

import jax.numpy as jnp

from jaxsph.checks import check_at_least
from jaxsph.pair_sum import apply, dot
from jaxsph.pytree import pytree_dataclass


@pytree_dataclass
class PenaltyForce:
    """Pulls pairs back to where the deformation gradients of both particles say they should be.

    One point of integration for each particle does not see displacements that alternate from particle to
    particle. As in G. C. Ganzenmueller (2015), Comput. Methods Appl. Mech. Eng. 286, 87, every pair resists the
    difference e between what the deformation gradients predict and where the particles are, along x_ab. His force
    (eq. 28) leaves out the reaction on the deformation gradients, so it does not derive from an energy. Here the
    force is the derivative of the energy of all pairs,

        sum_pairs alpha/2  E_ab  V_a V_b W(X_ab) / |X_ab|^2  (e_ab . x_ab / |x_ab|)^2,
        e_ab = (F_a + F_b) X_ab / 2 - x_ab,     E_ab = (E_a + E_b) / 2,

    with X_ab = X_a - X_b and x_ab = x_a - x_b: a direct force between a and b, and a stress through F. For small e the
    direct force is his. It vanishes for affine deformations, and conserves energy, linear and angular momentum. Not
    smooth where two particles meet (x_ab = 0).

    Attributes:
        coefficient: alpha, not negative; .01 to .1 are common.
    """

    coefficient: float

    def __post_init__(self):
        check_at_least("PenaltyForce.coefficient", self.coefficient, 0.0, "(no unit)")

    def _stretch(self, a, b, moved, edge):
        """Stiffness of the pair, e, x_ab, and e . x_ab / |x_ab|^2."""
        stiffness = 0.5 * self.coefficient * edge["penalty_weight"] * (a["youngs_modulus"] + b["youngs_modulus"])
        # F X - x = H X - u, without the rounding of positions.
        error = 0.5 * apply(a["displacement_gradient"] + b["displacement_gradient"], edge["reference"]) - moved
        current = edge["reference"] + moved
        squared = dot(current, current)
        return stiffness, error, current, dot(error, current) / jnp.where(squared > 0, squared, 1.0)

    def pair(self, a, b, moved, edge):
        """What a gets from b: a `force` (d,) [N], and a `stress` times volume (d, d) [N m]. In 2D per meter.

        Args:
            a, b: `displacement_gradient` H (d, d), `youngs_modulus` E.
            moved: u_a - u_b (d,).
            edge: `reference` X_ab (d,) and `penalty_weight` V_a V_b W(X_ab) / |X_ab|^2.
        """
        stiffness, error, current, along = self._stretch(a, b, moved, edge)
        pull = stiffness * along
        stress = (0.5 * pull * current)[:, None] * edge["reference"][None, :]
        return {"force": pull * ((1 + along) * current - error), "stress": stress}

    def pair_energy(self, a, b, moved, edge):
        """Energy of a pair [J, in 2D per meter]; arguments as of `pair`."""
        stiffness, _, current, along = self._stretch(a, b, moved, edge)
        return 0.5 * stiffness * along**2 * dot(current, current)
