"""The force against zero-energy modes of total-Lagrangian SPH."""

from __future__ import annotations

from jaxsph.checks import check_at_least
from jaxsph.pair_sum import apply, dot
from jaxsph.pytree import pytree_dataclass


@pytree_dataclass
class PenaltyForce:
    """Pulls pairs back to where the deformation gradients of both particles say they should be.

    One point of integration for each particle does not see displacements that alternate from particle to
    particle. As in G. C. Ganzenmueller (2015), Comput. Methods Appl. Mech. Eng. 286, 87, every pair resists the
    difference e between what the deformation gradients predict and where the particles are. His force (eq. 28) counts
    the part of e along x_ab only, and leaves out the reaction on the deformation gradients, so it does not derive from
    an energy. Here all of e counts, as in the energy of S. A. Silling (2017), Comput. Methods Appl. Mech. Eng. 322, 42,
    and the force is the derivative of the energy of all pairs,

        sum_pairs alpha/2  E_ab  V_a V_b W(X_ab) / |X_ab|^2  |e_ab|^2,
        e_ab = (F_a + F_b) X_ab / 2 - x_ab,     E_ab = (E_a + E_b) / 2,

    with X_ab = X_a - X_b and x_ab = x_a - x_b: a direct force between a and b, and a stress through F. It vanishes for
    affine deformations, and conserves energy, linear and angular momentum. Linear in the displacements, so smooth, and
    as stiff in a body that is bent or torn as in one at rest.

    Attributes:
        coefficient: alpha, not negative; .01 to .1 for what bends and swings, 1 for what water strikes. What is twisted
            or pressed together by much needs 3 to 20: pressure within the body works against the force (see
            docs/formulation.md).
    """

    coefficient: float

    def __post_init__(self):
        check_at_least("PenaltyForce.coefficient", self.coefficient, 0.0, "(no unit)")

    def _mismatch(self, a, b, moved, edge):
        """Stiffness of the pair, and e."""
        stiffness = 0.5 * self.coefficient * edge["penalty_weight"] * (a["youngs_modulus"] + b["youngs_modulus"])
        # F X - x = H X - u, without the rounding of positions.
        error = 0.5 * apply(a["displacement_gradient"] + b["displacement_gradient"], edge["reference"]) - moved
        return stiffness, error

    def pair(self, a, b, moved, edge):
        """What a gets from b: a `force` (d,) [N], and a `stress` times volume (d, d) [N m]. In 2D per meter.

        Args:
            a, b: `displacement_gradient` H (d, d), `youngs_modulus` E.
            moved: u_a - u_b (d,).
            edge: `reference` X_ab (d,) and `penalty_weight` V_a V_b W(X_ab) / |X_ab|^2.
        """
        stiffness, error = self._mismatch(a, b, moved, edge)
        pull = stiffness * error
        return {"force": pull, "stress": 0.5 * pull[:, None] * edge["reference"][None, :]}

    def pair_energy(self, a, b, moved, edge):
        """Energy of a pair [J, in 2D per meter]; arguments as of `pair`."""
        stiffness, error = self._mismatch(a, b, moved, edge)
        return 0.5 * stiffness * dot(error, error)
