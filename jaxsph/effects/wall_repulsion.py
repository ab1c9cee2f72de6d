"""Against the slow sinking of thin sheets of fluid into walls."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxsph.checks import check_at_least
from jaxsph.effects.flow_effect import FlowEffect
from jaxsph.pytree import pytree_dataclass, static


@pytree_dataclass
class WallRepulsion(FlowEffect):
    """A wall pushes particles that come closer to its own than particles are spread.

        force on a from b = -V_a V_b strength rho_a c^2 max(W_ab / W(s dx) - 1, 0)^2 grad W.

    The continuity equation keeps the volume of a sheet that is drawn out: thinner than a spacing, its one layer of
    particles, at hardly any pressure, has its middle in the wall. No pressure of the wall answers that; a distance
    does. Zero, with its derivative, from a distance of s = 1 spacing on, or less, so that particles in layers, and
    still water, do not feel it; a central force, so that it does no work around a closed way. For walls of the fluid's
    spacing. Its second derivative jumps where it begins.

    From one spacing on it lifts thin tongues of water off the floor, which changes how they strike: pressures on the
    wall that a dam break hits are a third further from the published ones. From .6 on, with a strength of 8, it lets
    them be, and still keeps particles from getting through the first layer of the wall (rows F17 of the validation,
    H04 and H05 of the hard cases).

    Attributes:
        strength: the speed at which a particle alone is stopped grows with its square root. The integral of the force
            from one spacing on, for 1 and h = 2 spacings of Wendland C2 in 2D: .06 c on half of the way to a wall's
            particle straight ahead, .1 c on all of it.
        solids: whether structures and rigid bodies push too, and are pushed. For bodies of the fluid's spacing whose
            outermost particles lie half of it below their surface, as `ball` puts them. At a plate whose particles lie
            on its surface the fluid rests closer than a spacing, and would be lifted off.
        distance: s, from which on it acts [particle spacings], at most 1.
    """

    strength: Any = 1.0
    solids: bool = static(default=False)
    distance: float = static(default=1.0)

    def __post_init__(self):
        check_at_least("WallRepulsion.strength", self.strength, 0.0, "no unit")
        if not 0 < self.distance <= 1:
            raise ValueError(
                f"WallRepulsion.distance = {self.distance} must be above 0 and at most 1 particle spacing: further off "
                "it would push particles that lie in layers"
            )

    @property
    def partners(self) -> frozenset[str]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Walls, and solids if they are asked for."""
        return frozenset({"wall", "solid"}) if self.solids else frozenset({"wall"})

    def force(self, a, b, pair):
        """[N]."""
        crowded = pair.value / (pair.value_at_spacing if self.distance == 1 else pair.value_at(self.distance)) - 1
        pressure = self.strength * a["density"] * pair.sound_speed**2 * jnp.where(crowded > 0, crowded, 0.0) ** 2
        return -a["volume"] * b["volume"] * pressure * pair.gradient
