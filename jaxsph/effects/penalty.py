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
    particle. G. C. Ganzenmueller (2015), Comput. Methods Appl. Mech. Eng. 286, 87, eq. (28), adds between a and b

        f_ab = alpha/2  V_a V_b W(X_ab) / |X_ab|^2  (E_a d_ab^a + E_b d_ab^b)  x_ab / |x_ab|,
        d_ab^a = (F_a X_ab - x_ab) . x_ab / |x_ab|,

    with x_ab = x_a - x_b, antisymmetric in a and b, so that momentum is conserved to round-off. It vanishes
    for affine deformations. Not smooth where two particles meet (x_ab = 0).

    Attributes:
        coefficient: alpha, not negative; .01 to .1 are common.
    """

    coefficient: float

    def __post_init__(self):
        check_at_least("PenaltyForce.coefficient", self.coefficient, 0.0, "(no unit)")

    def pair_force(self, a, b, edge):
        """Force on a from b [N, or N/m in 2D], (d,).

        a, b: `displacement` (d,), `scaled_gradient` E H (d, d), `youngs_modulus` E.
        edge: `reference` X_ab (d,) and `penalty_weight` V_a V_b W(X_ab) / |X_ab|^2.
        """
        moved = a["displacement"] - b["displacement"]
        current = edge["reference"] + moved
        length_squared = dot(current, current)
        # E (F X - x) = E (H X - u) for a and b together, without the rounding of positions.
        predicted = apply(a["scaled_gradient"] + b["scaled_gradient"], edge["reference"])
        error = dot(predicted - (a["youngs_modulus"] + b["youngs_modulus"]) * moved, current)
        weight = 0.5 * self.coefficient * edge["penalty_weight"]
        safe = jnp.where(length_squared > 0, length_squared, 1.0)
        return (weight * error / safe) * current
