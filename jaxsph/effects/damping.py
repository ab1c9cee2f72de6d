"""Damping of a structure's motion."""

from __future__ import annotations

from jaxsph.checks import check_at_least
from jaxsph.pytree import pytree_dataclass


@pytree_dataclass
class Damping:
    """A drag on every particle of a structure, a = -rate v [m/s^2]: to reach a static state.

    Critical for a mode of angular frequency w at rate = 2 w. The stable time step gets shorter, to 2 / rate for a body
    that nothing else limits.

    Attributes:
        rate: [1/s], not negative.
    """

    rate: float

    def __post_init__(self):
        check_at_least("Damping.rate", self.rate, 0.0, "1/s")

    def acceleration(self, velocity):
        """[m/s^2], like velocity [m/s]."""
        return -self.rate * velocity
