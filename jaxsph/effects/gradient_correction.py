"""Pressure forces with a gradient that is exact for linear fields."""

from __future__ import annotations

from typing import ClassVar

from jaxsph.effects.flow_effect import FlowEffect
from jaxsph.effects.tensile_control import smooth_rise
from jaxsph.pair_sum import apply
from jaxsph.pytree import pytree_dataclass


@pytree_dataclass
class KernelGradientCorrection(FlowEffect):
    """The force on a is that of the corrected gradient of the pressure, exact for linear pressures.

        f_a = -V_a sum_b V_b (p_b - p_a) L_a grad W,      L_a = M_a^-1,      M_a = -sum_b V_b grad W x_ab^T.

    J. Bonet, T.-S. L. Lok (1999), Comput. Methods Appl. Mech. Eng. 180, 97, section 4. M is summed in a pass of its own
    from the positions of now, walls included. Inside a fluid it is near the unit matrix; at a free surface, where it is
    badly conditioned, f_a fades into the force of the density calculator as det M falls from .7 to .4 (a flat surface
    has about .25), smoothly. Forces of a pair are then no longer opposite: linear momentum is conserved to the order of
    the scheme, not to round-off. A constant pressure does not spread particles any more, so that `ParticleShifting`
    belongs to it. For flows that fill their domain: a falling column with a free surface scattered after 70 steps. The
    rate of the density stays as it is. Not together with `TensileControl`, whose idea it is too.
    """

    symmetric: ClassVar[bool] = False

    def reliable(self, determinant):
        """0 where M is badly conditioned, 1 where it can be inverted."""
        return smooth_rise(determinant, 0.4, 0.7)

    def corrected(self, force, a, b, pair):
        """The force on a from b [N], from that of the density calculator; L of a carries the factor `reliable`."""
        linear = -a["volume"] * b["volume"] * (b["pressure"] - a["pressure"]) * apply(a["correction"], pair.gradient)
        return (1 - a["reliable"]) * force + linear
