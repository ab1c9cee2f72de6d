"""Particle shifting: particles move a little off their paths, so that they stay evenly spread."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import jax.numpy as jnp

from jaxsph.checks import check_at_least, check_positive
from jaxsph.effects.tensile_control import NEAR_SURFACE, smooth_rise
from jaxsph.pair_sum import dot
from jaxsph.pytree import pytree_dataclass, static


class Shifting(ABC):
    """What `jaxsph.flow` asks of an effect that moves particles with v + dv, of which a scene has at most one."""

    free_surface: bool = False

    @abstractmethod
    def crowding(self, a, b, pair) -> Any:
        """Volume of a times the term of a sum that points to where particles crowd [m^(d-1)], (d,); antisymmetric."""

    @abstractmethod
    def velocity(
        self, crowding, fluid, smoothing_length, support_radius, *, cover: Any = None, normal: Any = None
    ) -> Any:
        """dv (d, N) [m/s] from the sum.

        Args:
            crowding: the sum (d, N) [1/m].
            fluid: whose particles move.
            smoothing_length: h [m].
            support_radius: H [m].
            cover: C (N,), with `free_surface`.
            normal: along the normal of the surface, of any length (d, N), with `free_surface`.
        """

    def carried(self, a, b, difference, pair):
        """dv . grad of a field, times the volume of a, from its difference between b and a; symmetric."""
        along = dot(a["shift"] + b["shift"], pair.gradient)
        return 0.5 * a["volume"] * b["volume"] * along * difference


@pytree_dataclass
class ParticleShifting(Shifting):
    """Particles move with v + dv, where dv points away from where they crowd.

        dv_a = -strength speed H sum_b (1 + .2 (W_ab / W(dx))^4) V_b grad W,      |dv| <= speed / 2,

    with the support radius H: P.-N. Sun, A. Colagrossi, S. Marrone, M. Antuono, A.-M. Zhang (2019), Comput. Phys.
    Commun. 236, 63, eqs. (5), (7). Since particles no longer follow the flow, their density and velocity change by
    dv . grad of both. These are summed as differences: the conservative sums of eq. (5) do not cancel, and the density
    falls by 2 rho |dv|^2 / (speed H) all the time, which empties a closed box. Linear momentum is then conserved to the
    order of the scheme, not to round-off. With a free surface, where the sums are one-sided and would add energy,
    particles keep their density and velocity, as in P.-N. Sun et al. (2017), Comput. Methods Appl. Mech. Eng. 315, 25.

    At a free surface the sum points out of the fluid, whatever the particles do. With `free_surface` the part of dv
    along the normal fades out as the cover C = -sum_b V_b x_ab . grad W / d, which is 1 inside, falls from .95 to .75,
    and all of dv from .6 to .4 (spray), both smoothly. The idea of leaving out the normal part is that of S. J. Lind,
    R. Xu, P. K. Stansby, B. D. Rogers (2012), J. Comput. Phys. 231, 1499, section 3.

    Attributes:
        speed: the flow's own, U [m/s]; None takes a tenth of the sound speed.
        strength: factor before it.
        free_surface: whether to look for a free surface. False for flows that fill their domain.
    """

    speed: Any = None
    strength: Any = 1.0
    free_surface: bool = static(default=False)

    def __post_init__(self):
        if self.speed is not None:
            check_positive("ParticleShifting.speed", self.speed, "m/s")
        check_at_least("ParticleShifting.strength", self.strength, 0.0, "no unit")

    def crowding(self, a, b, pair):
        """Volume of a times the sum's term [m^(d-1)], (d,); antisymmetric."""
        clumped = (pair.value / pair.value_at_spacing) ** 4
        return a["volume"] * b["volume"] * (1 + 0.2 * clumped) * pair.gradient

    def velocity(self, crowding, fluid, smoothing_length, support_radius, *, cover: Any = None, normal: Any = None):
        """dv (d, N) [m/s]."""
        speed = 0.1 * fluid.sound_speed if self.speed is None else self.speed
        shift = -self.strength * speed * support_radius * crowding
        if self.free_surface:
            # Of what is inside the normal is rounding, whose square a derivative must not divide by.
            direction = jnp.where(cover < NEAR_SURFACE[1], normal, 0.0)
            squared = jnp.sum(direction**2, axis=0)
            along = jnp.sum(shift * direction, axis=0) / jnp.where(squared > 0, squared, 1.0) * direction
            shift = smooth_rise(cover, 0.4, 0.6) * (shift - (1 - smooth_rise(cover, *NEAR_SURFACE)) * along)
        squared, limit = jnp.sum(shift**2, axis=0), 0.5 * speed
        over = squared > limit**2
        return shift * (limit / jnp.sqrt(jnp.where(over, squared, limit**2)))


@pytree_dataclass
class TransportVelocity(Shifting):
    """Particles move as a constant background pressure would push them, which acts on nothing else.

        dv_a = -t p_b / (2 m_a) sum_b (V_a^2 + V_b^2) grad W,      t = h / (4 c),

    S. Adami, X. Y. Hu, N. A. Adams (2013), J. Comput. Phys. 241, 292, eq. (8). There t is the time step; here it is the
    one of their eq. (19), so that results do not depend on the step, and m_a / V_a is the rest density. What moving
    particles carry is that of `ParticleShifting`: their tensor A of eq. (4) less v div dv. For flows without a free
    surface, where particles would fly off.

    Attributes:
        background_pressure: p_b [Pa]; None takes rho_0 c^2.
    """

    background_pressure: Any = None

    def __post_init__(self):
        if self.background_pressure is not None:
            check_at_least("TransportVelocity.background_pressure", self.background_pressure, 0.0, "Pa")

    def crowding(self, a, b, pair):
        """Half the sum of squares of the volumes [m^(2d)] times the gradient; antisymmetric."""
        return 0.5 * (a["volume"] ** 2 + b["volume"] ** 2) * pair.gradient

    def velocity(self, crowding, fluid, smoothing_length, support_radius, *, cover: Any = None, normal: Any = None):
        """dv (d, N) [m/s]."""
        per_density = fluid.sound_speed**2
        if self.background_pressure is not None:
            per_density = self.background_pressure / fluid.density
        return -0.25 * smoothing_length / fluid.sound_speed * per_density * crowding
