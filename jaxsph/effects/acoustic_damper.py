"""Against the sound of an impact."""

from __future__ import annotations

from typing import Any

from jaxsph.checks import check_at_least
from jaxsph.effects.flow_effect import FlowEffect
from jaxsph.pytree import pytree_dataclass


@pytree_dataclass
class AcousticDamper(FlowEffect):
    """A bulk viscosity, which damps sound and leaves shear alone: the forces are those of the pressure

        p + alpha c h drho/dt.

    Water that hits a wall rings: the fluid is far more compressible than water, and what the impact compressed runs
    to and fro as sound until something damps it. P.-N. Sun, C. Pilloton, M. Antuono, A. Colagrossi (2023), J. Comput.
    Phys. 483, 112056, who take the divergence of the velocity in place of the density's rate. The rate has the
    diffusion of the density in it, so that nothing acts in a fluid at rest. It is that of the middle of the step
    before. Walls and solids feel it too, so momentum is exchanged to round-off. Smooth. Needs a density that is
    integrated in time.

    Attributes:
        alpha: no unit; a wave of the length L loses exp(-2 pi^2 alpha c h t / L^2).
    """

    alpha: Any = 0.5

    def __post_init__(self):
        check_at_least("AcousticDamper.alpha", self.alpha, 0.0, "no unit")

    def pressure(self, rate, sound_speed, smoothing_length):
        """What is added to the pressure [Pa] where the density changes at a rate [kg/(m^3 s)]."""
        return self.alpha * sound_speed * smoothing_length * rate
