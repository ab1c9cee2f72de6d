"""How a fluid gets its density, and the pressure force that belongs to it.

A force derives from the same energy as the density if it is the adjoint of how the density changes: each calculator
brings its own. J. J. Monaghan (2005), Rep. Prog. Phys. 68, 1703, section 3; J. Bonet, T.-S. L. Lok (1999), Comput.
Methods Appl. Mech. Eng. 180, 97.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from jaxsph.checks import check_at_least
from jaxsph.pytree import pytree_dataclass, static


class DensityCalculator(ABC):
    """What `jaxsph.flow` asks: does the density follow from a rate, and what force belongs to it?"""

    summed = False
    """True if the density is a sum over particles now."""

    evolved: str | None = None
    """Field of the state that is integrated in time, "density_deviation" or "pressure"; None if there is none."""

    symmetric = True
    """Whether the pressure force is antisymmetric. If it is not, gradients of a run cost more."""

    averaged_pressure = False
    """Whether the force needs the mean pressure of the neighbors, `mean_pressure`, which takes a pass of its own."""

    def summed_mass(self, a, b):
        """What b adds to the density of a, before the kernel [kg]."""
        return b["mass"]

    divergence: Any
    """divergence(a, b, flux): rate of the density, times the volume of a, from flux = (v_a - v_b) . grad W; symmetric.

    As the next, of calculators that integrate "density_deviation"."""

    of_divergence: Any
    """of_divergence(total, density, volume): rate of the density [kg/(m^3 s)] from the sum of `divergence`."""

    @abstractmethod
    def pressure_force(self, a, b, gradient) -> Any:
        """Force on a from b [N, in 2D per meter], (d,); antisymmetric."""


@pytree_dataclass
class ContinuityDensity(DensityCalculator):
    """The continuity equation, integrated in time. Right at free surfaces.

    Attributes:
        form: "volume": drho_a = rho_a sum_b V_b v_ab . grad W with the force -V_a V_b (p_a + p_b) grad W, which holds
            at jumps of the density too; or "mass": drho_a = sum_b m_b v_ab . grad W, equation (12) of the poster, with
            -m_a m_b (p_a / rho_a^2 + p_b / rho_b^2) grad W, equation (11).
    """

    evolved: ClassVar[str] = "density_deviation"
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

    summed: ClassVar[bool] = True

    def pressure_force(self, a, b, gradient):
        """-m_a m_b (p_a / rho_a^2 + p_b / rho_b^2) grad W [N], equation (11)."""
        return _mass_force(a, b, gradient)


@pytree_dataclass
class EDAC(DensityCalculator):
    """Entropically damped artificial compressibility: the pressure evolves by itself, and diffuses.

        dp_a = rho_a c^2 sum_b V_b v_ab . grad W + nu sum_b 2 V_b (p_a - p_b) F,     nu = alpha h c / 8,

    that is dp/dt = -rho c^2 div v + nu lap p, with the pressure that walls extrapolate. J. R. Clausen (2013), Phys.
    Rev. E 87, 013309; P. Ramachandran, K. Puri (2019), Comput. Fluids 179, 579. The equation of state makes the density
    of the start from a pressure and is not asked again. The force is -(V_a^2 + V_b^2) p_ab grad W with
    p_ab = (rho_b p_a + rho_a p_b) / (rho_a + rho_b): S. Adami, X. Y. Hu, N. A. Adams (2013), J. Comput. Phys. 241, 292.
    With `ParticleShifting` or `TransportVelocity` and no free surface the mean pressure is kept.

    The density, and with it the volume m / rho, is m_a sum_b W_ab, the particle itself included, for particles of one
    size; with `free_surface` it stays what it is at the start.

    Attributes:
        alpha: of the diffusion; .5 is common.
        averaged_pressure: take the mean pressure of its neighbors off both pressures of the force on a, which a
            constant pressure then does not shake. M. Basa, N. J. Quinlan, M. Lastiwka (2009), Int. J. Numer. Methods
            Fluids 60, 1127. The mean is weighted with the kernel here, so that it is smooth. Forces of a pair are then
            no longer opposite, and it takes another pass over the pairs. For flows without a free surface.
        free_surface: whether there is one.
    """

    evolved: ClassVar[str] = "pressure"
    alpha: Any = 0.5
    averaged_pressure: bool = static(default=False)
    free_surface: bool = static(default=False)

    def __post_init__(self):
        check_at_least("EDAC.alpha", self.alpha, 0.0, "no unit")
        if self.averaged_pressure and self.free_surface:
            raise ValueError(
                "averaged_pressure = True of EDAC takes the pressure of a free surface off; with free_surface = True "
                "leave it out"
            )

    @property
    def summed(self):
        """Whether the density is a sum: without a free surface."""
        return not self.free_surface

    @property
    def symmetric(self):
        """Whether the force is antisymmetric."""
        return not self.averaged_pressure

    def summed_mass(self, a, b):
        """The own mass: V_a = 1 / sum_b W_ab, also where another fluid begins."""
        return a["mass"]

    def pressure_flux(self, a, b, pair):
        """What diffusion brings to a, times its volume [J/s, in 2D per meter]; antisymmetric."""
        diffusivity = self.alpha * pair.smoothing_length * pair.sound_speed / 8
        return 2 * (a["volume"] * b["volume"] * pair.slope) * (diffusivity * (a["pressure"] - b["pressure"]))

    def pressure_force(self, a, b, gradient):
        """[N]."""
        total = a["density"] + b["density"]
        mean = (b["density"] * a["pressure"] + a["density"] * b["pressure"]) / total - a.get("mean_pressure", 0.0)
        return -(a["volume"] ** 2 + b["volume"] ** 2) * mean * gradient


def _volume_force(a, b, gradient):
    return -a["volume"] * b["volume"] * (a["pressure"] + b["pressure"]) * gradient


def _mass_force(a, b, gradient):
    # m / rho = V
    per_density = a["pressure"] / a["density"] * a["volume"] * b["mass"]
    return -(per_density + b["pressure"] / b["density"] * b["volume"] * a["mass"]) * gradient
