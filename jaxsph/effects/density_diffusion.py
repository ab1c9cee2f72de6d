"""Diffusion of density: what takes the noise out of the pressure."""

from __future__ import annotations

from typing import Any, ClassVar

from jaxsph.checks import check_at_least
from jaxsph.effects.flow_effect import FlowEffect
from jaxsph.pair_sum import dot
from jaxsph.pytree import pytree_dataclass


@pytree_dataclass
class DensityDiffusion(FlowEffect):
    """delta h c sum_b 2 (rho_b - rho_a) V_b x_ba . grad W / x_ab^2.

    D. Molteni, A. Colagrossi (2009), Comput. Phys. Commun. 180, 861. Conserves the mass of the volumes. At a free
    surface under gravity it also levels the hydrostatic gradient; there `DeltaDiffusion` is right.

    Attributes:
        coefficient: delta; .1 is common.
    """

    coefficient: Any = 0.1
    partners: ClassVar[frozenset[str]] = frozenset({"fluid"})

    def __post_init__(self):
        check_at_least(f"{type(self).__name__}.coefficient", self.coefficient, 0.0, "no unit")

    def density_flux(self, a, b, pair):
        """[kg/s]."""
        return _flux(self.coefficient, 2 * (b["density"] - a["density"]), a, b, pair)


@pytree_dataclass
class DeltaDiffusion(FlowEffect):
    """As `DensityDiffusion`, less what a linear profile of the density would give.

    delta h c sum_b (2 (rho_b - rho_a) + (grad rho_a + grad rho_b) . x_ab) V_b x_ba . grad W / x_ab^2 with the
    gradients corrected to be exact for linear fields: right at free surfaces under gravity.
    M. Antuono, A. Colagrossi, S. Marrone, D. Molteni (2010), Comput. Phys. Commun. 181, 532, eq. (5).

    Attributes:
        coefficient: delta; .1 is common.
    """

    coefficient: Any = 0.1
    partners: ClassVar[frozenset[str]] = frozenset({"fluid"})

    def __post_init__(self):
        check_at_least(f"{type(self).__name__}.coefficient", self.coefficient, 0.0, "no unit")

    def density_flux(self, a, b, pair):
        """[kg/s]."""
        linear = dot(a["density_gradient"] + b["density_gradient"], pair.offset)
        return _flux(self.coefficient, 2 * (b["density"] - a["density"]) + linear, a, b, pair)


def _flux(coefficient, difference, a, b, pair):
    # x_ba . grad W / x_ab^2 = -F
    strength = coefficient * pair.smoothing_length * pair.sound_speed
    # The slope first: it is as large as the volumes are small, and float32 ends at 1e-38.
    return -(a["volume"] * b["volume"] * pair.slope) * (strength * difference)
