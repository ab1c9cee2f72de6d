"""How a fluid gets its density, and the pressure force that belongs to it.

A force derives from the same energy as the density if it is the adjoint of how the density changes: each calculator
brings its own. J. J. Monaghan (2005), Rep. Prog. Phys. 68, 1703, section 3; J. Bonet, T.-S. L. Lok (1999), Comput.
Methods Appl. Mech. Eng. 180, 97.
"""

from __future__ import annotations

from jaxsph.pytree import pytree_dataclass, static


class DensityCalculator:
    """What `jaxsph.flow` asks: does the density follow from a rate, and what force belongs to it?"""

    summed = False
    """True if the density is a sum over particles now, False if it is integrated in time."""

    def divergence(self, a, b, flux):
        """Rate of the density, times the volume of a, from flux = (v_a - v_b) . grad W: symmetric in a and b."""
        raise NotImplementedError

    def of_divergence(self, total, density, volume):
        """Rate of the density [kg/(m^3 s)] from the sum of `divergence` over all neighbors."""
        raise NotImplementedError

    def pressure_force(self, a, b, gradient):
        """Force on a from b [N, in 2D per meter], (d,); antisymmetric."""
        raise NotImplementedError


@pytree_dataclass
class ContinuityDensity(DensityCalculator):
    """The continuity equation, integrated in time. Right at free surfaces.

    Attributes:
        form: "volume": drho_a = rho_a sum_b V_b v_ab . grad W with the force -V_a V_b (p_a + p_b) grad W, which holds
            at jumps of the density too; or "mass": drho_a = sum_b m_b v_ab . grad W, equation (12) of the poster, with
            -m_a m_b (p_a / rho_a^2 + p_b / rho_b^2) grad W, equation (11).
    """

    form: str = static(default="volume")

    def __post_init__(self):
        if self.form not in ("volume", "mass"):
            raise ValueError(f"form = {self.form!r} of ContinuityDensity must be 'volume' or 'mass'")

    def divergence(self, a, b, flux):
        """Symmetric."""
        return (a["volume"] * b["volume"] if self.form == "volume" else a["mass"] * b["mass"]) * flux

    def of_divergence(self, total, density, volume):
        """[kg/(m^3 s)]."""
        return total * density / volume if self.form == "volume" else total / (density * volume)

    def pressure_force(self, a, b, gradient):
        """[N]."""
        return _volume_force(a, b, gradient) if self.form == "volume" else _mass_force(a, b, gradient)


@pytree_dataclass
class SummationDensity(DensityCalculator):
    """rho_a = sum_b m_b W_ab, equation (5) of the poster, the particle itself included, at every step.

    For flows without a free surface: there the sum lacks the particles outside.
    """

    summed = True

    def pressure_force(self, a, b, gradient):
        """-m_a m_b (p_a / rho_a^2 + p_b / rho_b^2) grad W [N], equation (11)."""
        return _mass_force(a, b, gradient)


def _volume_force(a, b, gradient):
    return -a["volume"] * b["volume"] * (a["pressure"] + b["pressure"]) * gradient


def _mass_force(a, b, gradient):
    # m / rho = V
    per_density = a["pressure"] / a["density"] * a["volume"] * b["mass"]
    return -(per_density + b["pressure"] / b["density"] * b["volume"] * a["mass"]) * gradient
