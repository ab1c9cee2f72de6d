"""Pressure forces with a gradient that is exact for linear fields."""

from __future__ import annotations

from typing import ClassVar

from jaxsph.effects.flow_effect import FlowEffect
from jaxsph.pair_sum import apply
from jaxsph.pytree import pytree_dataclass


@pytree_dataclass
class KernelGradientCorrection(FlowEffect):
    """The force on a is that of the corrected gradient of the pressure, exact for linear pressures.

        f_a = -V_a sum_b V_b (p_b - p_a) L_a grad W,      L_a = M_a^-1,      M_a = -sum_b V_b grad W x_ab^T.

    J. Bonet, T.-S. L. Lok (1999), Comput. Methods Appl. Mech. Eng. 180, 97, section 4. It stands for the force of the
    density calculator. M is summed in a pass of its own from the positions of now, fluids and walls included; it is
    near the unit matrix inside a fluid, so that the inverse is smooth. The rate of the density stays as it is.

    For flows without a free surface: there M is badly conditioned, and a fluid under pressure would not be held
    together. What it costs: a constant pressure does not spread particles any more, so that `ParticleShifting` or
    `TransportVelocity` has to, which a scene asks for; and the forces of a pair are no longer opposite, so that linear
    momentum is conserved to the order of the scheme, not to round-off.
    """

    symmetric: ClassVar[bool] = False

    def pressure_force(self, a, b, gradient):
        """Force on a from b [N, in 2D per meter], (d,)."""
        return -a["volume"] * b["volume"] * (b["pressure"] - a["pressure"]) * apply(a["correction"], gradient)
