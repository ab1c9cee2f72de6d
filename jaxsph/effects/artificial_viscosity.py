"""Artificial viscosity."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp

from jaxsph.checks import check_at_least
from jaxsph.effects.flow_effect import FlowEffect
from jaxsph.pair_sum import dot
from jaxsph.pytree import pytree_dataclass


@pytree_dataclass
class ArtificialViscosity(FlowEffect):
    """Friction between approaching particles: Pi_ab of equation (11) of the poster.

        Pi_ab = (-alpha c mu + beta mu^2) / rho,  mu = h v_ab . x_ab / (x_ab^2 + .01 h^2)  if v_ab . x_ab < 0, else 0,

    with the mean density rho. J. J. Monaghan (1992), Annu. Rev. Astron. Astrophys. 30, 543, eq. (4.1). Acts like a
    kinematic viscosity of about alpha h c / 16 in 2D, / 20 in 3D, half of what it would if all pairs counted.
    Continuous but not differentiable where pairs turn from approaching to receding: there a gradient is one of the two
    one-sided ones. It does not act between fluid and walls, where it would be a drag along the wall.

    Attributes:
        alpha: .01 to .1 are common.
        beta: against particles that pass through each other in shocks.
    """

    alpha: Any = 0.02
    beta: Any = 0.0
    partners: ClassVar[frozenset[str]] = frozenset({"fluid"})

    def __post_init__(self):
        check_at_least("ArtificialViscosity.alpha", self.alpha, 0.0, "no unit")
        check_at_least("ArtificialViscosity.beta", self.beta, 0.0, "no unit")

    def force(self, a, b, pair):
        """[N]."""
        approach = dot(a["velocity"] - b["velocity"], pair.offset)
        per_h = 1 / pair.smoothing_length  # one division for all pairs
        closing = jnp.where(approach < 0, approach, 0.0) * per_h
        distance = pair.squared * per_h**2 + 0.01
        density = 0.5 * (a["density"] + b["density"])
        viscosity = (self.beta * closing - self.alpha * pair.sound_speed * distance) * closing / (distance**2 * density)
        return -a["mass"] * b["mass"] * viscosity * pair.gradient
