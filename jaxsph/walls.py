"""Walls: layers of particles that do not follow from forces, and the models of their pressure.

A wall takes part in the sums of a fluid as if it were fluid. What it lacks is a pressure; how it gets one is the model.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from jaxsph import checks
from jaxsph.geometry.shapes import Particles
from jaxsph.pair_sum import dot
from jaxsph.pytree import as_real, pytree_dataclass, static
from jaxsph.system import System


class WallPressure:
    """How a wall gets its pressure.

    A model that `extrapolates` has `pair`, which is summed over the fluid particles near a wall particle, weighted with
    their kernel and divided by the sum of kernels. One that does not is asked for `of_pair`.
    """

    extrapolates = True
    clip = False

    pair: ClassVar[Any] = None
    """pair(wall, fluid, pair, gravity): pressure [Pa] that a fluid particle would have where the wall particle is.

    wall has `velocity`, `acceleration` (d,); fluid `velocity` (d,), `density`, `pressure`; pair is the geometry, from
    fluid to wall; gravity (d,) [m/s^2]."""

    of_pair: ClassVar[Any] = None
    """of_pair(fluid_pressure): pressure of a wall particle [Pa] as seen by a fluid particle with this pressure."""


def check_model(boundary) -> None:
    """Raise ValueError unless the pressure of a wall or solid is a model of it."""
    if not isinstance(boundary.pressure, WallPressure):
        raise ValueError(
            f"{boundary.name}.pressure is {boundary.pressure!r}; it must be a model such as AdamiExtrapolation()"
        )


@pytree_dataclass
class AdamiExtrapolation(WallPressure):
    """The pressure of the fluid, continued hydrostatically: equation (6) of the poster. Body forces count as gravity.

    S. Adami, X. Y. Hu, N. A. Adams (2012), J. Comput. Phys. 231, 7057, eq. (27).

    Attributes:
        clip: take negative pressures of the wall as zero; what then still pulls is the fluid's own. Its derivative is
            zero there.
    """

    clip: bool = static(default=False)

    def pair(self, wall, fluid, pair, gravity):
        """[Pa]."""
        return fluid["pressure"] + fluid["density"] * dot(gravity - wall["acceleration"], pair.offset)


@pytree_dataclass
class BernoulliExtrapolation(WallPressure):
    """As `AdamiExtrapolation`, and the dynamic pressure of fluid that runs against the wall.

    p = p_f + rho_f (g - a_w) . x_wf + factor rho_f / 2 ((v_w - v_f) . x_wf / |x_wf|)^2 if they approach.

    Attributes:
        factor: of the dynamic pressure; 1 is Bernoulli's.
        clip: take negative pressures of the wall as zero.
    """

    factor: Any = 1.0
    clip: bool = static(default=False)

    def __post_init__(self):
        checks.check_at_least("BernoulliExtrapolation.factor", self.factor, 0.0, "no unit")

    def pair(self, wall, fluid, pair, gravity):
        """[Pa]."""
        approach = dot(wall["velocity"] - fluid["velocity"], pair.offset)
        squared = jnp.where(approach < 0, approach, 0.0) ** 2 / jnp.where(pair.squared > 0, pair.squared, 1.0)
        static_part = fluid["pressure"] + fluid["density"] * dot(gravity - wall["acceleration"], pair.offset)
        return static_part + 0.5 * self.factor * fluid["density"] * squared


@pytree_dataclass
class PressureMirroring(WallPressure):
    """The wall has the pressure of whichever fluid particle asks. Cheap; no hydrostatics across the wall."""

    extrapolates = False

    def of_pair(self, fluid_pressure):
        """[Pa]."""
        return fluid_pressure


@pytree_dataclass
class PressureZeroing(WallPressure):
    """The wall has no pressure and the rest density: particles get in further before they are turned back."""

    extrapolates = False

    def of_pair(self, fluid_pressure):
        """[Pa]."""
        return jnp.zeros_like(fluid_pressure)


@pytree_dataclass
class WallContinuity(WallPressure):
    """The wall's density follows from the continuity equation with the fluid, its pressure from the state equation.

    J. J. Monaghan, J. B. Kajtar (2009), Comput. Phys. Commun. 180, 1811, section 2; needs no extrapolation, remembers.

    Attributes:
        clip: take negative pressures of the wall as zero.
    """

    extrapolates = False
    clip: bool = static(default=True)


@pytree_dataclass
class WallSummation(WallPressure):
    """The wall's density is the sum over fluid and wall particles, its pressure follows from the state equation.

    Attributes:
        clip: take negative pressures of the wall as zero; where fluid is missing the sum is too small.
    """

    extrapolates = False
    clip: bool = static(default=True)


@pytree_dataclass
class Wall(System):
    """A wall.

    Attributes:
        name: how the scene and its results call it.
        particles: positions (N, d) [m] at t = 0 and volumes (N,) [m^d]: as many layers as the support radius reaches.
        pressure: model of its pressure.
        no_slip: whether viscous fluids stick to it. Without viscosity it has no effect.
        motion: prescribed displacement, motion(t, X (N, d)) -> (N, d) [m], written with jax.numpy; zero at t = 0.
            None holds it still. It may be made of traced numbers: those that are fitted. A new function is compiled
            anew: one of a module, or a frozen dataclass with `__call__`, is not.
        velocity: (d,) [m/s] of the surface of a wall that stays where it is, such as a sliding lid.
        thickness: of a plate that may be thinner than the support radius of the fluids [m]; they then meet it as if it
            were as thick (see `jaxsph.thin_wall`). None takes it as thick.

    Raises:
        ValueError: a value out of its range, with the limit; a shape that does not fit.
    """

    name: str = static()
    particles: Particles
    pressure: WallPressure = AdamiExtrapolation()
    no_slip: bool = static(default=True)
    motion: Callable | None = static(default=None)
    velocity: Any = None
    thickness: float | None = static(default=None)

    def __post_init__(self):
        checks.check_name(self.name, "velocity")
        check_model(self)
        if self.motion is not None and self.velocity is not None:
            raise ValueError(f"{self.name} has both a motion and a velocity; a moving wall's velocity is its motion's")
        if self.velocity is not None:
            object.__setattr__(self, "velocity", as_real(self.velocity, self.dtype))
        checks.check_motion(self)
        self.check()

    def check(self, prefix: str = "") -> None:
        """Raise ValueError if a number is out of its range or has a shape that does not fit. Traced ones pass."""
        if self.thickness is not None:
            checks.check_positive(f"{prefix}thickness", self.thickness, "m")
        if self.velocity is not None:
            checks.check_finite(f"{prefix}velocity", self.velocity, (self.dimension,))

    @property
    def moves(self) -> bool:
        """Whether its particles change their places."""
        return self.motion is not None

    def placed(self, positions, time):
        """Positions, velocities and accelerations (d, N) at a time [s] of particles at positions (d, N) at t = 0."""
        zero = jnp.zeros_like(positions)
        motion = self.motion
        if motion is None:
            velocity = zero if self.velocity is None else zero + jnp.asarray(self.velocity)[:, None]
            return positions, velocity, zero

        def place(t):
            displacement = motion(t, positions.T)
            checks.check_shape_of_motion(self.name, displacement, positions.T)
            return positions + displacement.T

        def place_and_speed(t):
            return jax.jvp(place, (t,), (jnp.ones_like(t),))

        (position, velocity), (_, acceleration) = jax.jvp(place_and_speed, (time,), (jnp.ones_like(time),))
        return position, velocity, acceleration
