"""Against the tensile instability."""

from __future__ import annotations

from typing import ClassVar

import jax.numpy as jnp

from jaxsph.effects.flow_effect import FlowEffect
from jaxsph.pytree import pytree_dataclass

NEAR_SURFACE = (0.75, 0.95)
"""The cover below which a particle is at a free surface, and that from which it is inside; between them it is both."""


@pytree_dataclass
class TensileControl(FlowEffect):
    """Where the pressure of a is negative, p_b - p_a stands for p_a + p_b in the force on a.

    Both are the pressure's gradient where particles are spread evenly; under tension the second one makes them clump
    and tear. P.-N. Sun, A. Colagrossi, S. Marrone, M. Antuono, A.-M. Zhang (2018), Comput. Phys. Commun. 224, 63,
    eq. (6). It fades out at a free surface, as the cover (see `ParticleShifting`, whose value of the step before is
    taken) falls from .95 to .75. Forces of a pair are then no longer opposite: linear momentum is conserved to the
    order of the scheme, not to round-off. The force is continuous in the pressure, its derivative jumps at zero.
    """

    symmetric: ClassVar[bool] = False

    def force(self, a, b, pair):
        """[N]."""
        inside = smooth_rise(a["cover"], *NEAR_SURFACE)
        missing = jnp.where(a["pressure"] < 0, -2.0 * a["pressure"], 0.0)
        return -a["volume"] * b["volume"] * inside * missing * pair.gradient


def smooth_rise(value, start: float, end: float):
    """0 below start, 1 above end, a cubic between."""
    x = jnp.clip((value - start) / (end - start), 0.0, 1.0)
    return x * x * (3 - 2 * x)
