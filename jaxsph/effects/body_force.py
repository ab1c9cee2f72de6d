"""Forces from outside."""

from __future__ import annotations

from collections.abc import Callable

from jaxsph.effects.flow_effect import FlowEffect
from jaxsph.pytree import pytree_dataclass, static


@pytree_dataclass
class BodyForce(FlowEffect):
    """A force per mass given as a function of place and time, on every system.

    Attributes:
        function: acceleration(x (d, N) [m], t [s]) -> (d, N) or (d, 1) [m/s^2], written with jax.numpy. It may be made
            of traced numbers: those that are fitted.
    """

    function: Callable = static()

    def __post_init__(self):
        if not callable(self.function):
            raise ValueError(
                f"BodyForce is given {self.function!r}; it takes a function of positions and time. An acceleration "
                "that is the same everywhere is the scene's gravity="
            )

    def acceleration(self, positions, time):
        """[m/s^2]."""
        return self.function(positions, time)
