"""Equations of state: pressure from density, equation (13) of the poster, and back.

They work on the density's deviation from the rest density, rho - rho_0, not on rho: in float32 a weakly compressible
fluid would lose its pressure in the rounding of rho.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxsph.checks import check_finite, check_positive
from jaxsph.pytree import pytree_dataclass


class StateEquation:
    """Pressure p [Pa] of a fluid whose density deviates from rest, and the inverse."""

    background_pressure: Any

    def pressure(self, deviation, rest_density, sound_speed):
        """p [Pa] from rho - rho_0 [kg/m^3], rho_0 [kg/m^3] and c [m/s]."""
        raise NotImplementedError

    def deviation(self, pressure, rest_density, sound_speed):
        """rho - rho_0 [kg/m^3] from p [Pa]."""
        raise NotImplementedError


@pytree_dataclass
class Cole(StateEquation):
    """p = rho_0 c^2 / gamma ((rho / rho_0)^gamma - 1) - p_background. R. H. Cole (1948), Underwater Explosions.

    Attributes:
        exponent: gamma; 7 for water under high pressure, 1 is `LinearStateEquation`.
        background_pressure: p_background [Pa], taken off the pressure.
    """

    exponent: Any = 7.0
    background_pressure: Any = 0.0

    def __post_init__(self):
        check_positive("Cole.exponent", self.exponent, "no unit")
        check_finite("Cole.background_pressure", self.background_pressure)

    def pressure(self, deviation, rest_density, sound_speed):
        """p [Pa]."""
        stiffness = rest_density * sound_speed**2 / self.exponent
        ratio = deviation / rest_density
        return stiffness * jnp.expm1(self.exponent * jnp.log1p(ratio)) - self.background_pressure

    def deviation(self, pressure, rest_density, sound_speed):
        """rho - rho_0 [kg/m^3]."""
        stiffness = rest_density * sound_speed**2 / self.exponent
        ratio = (pressure + self.background_pressure) / stiffness
        return rest_density * jnp.expm1(jnp.log1p(ratio) / self.exponent)


@pytree_dataclass
class LinearStateEquation(StateEquation):
    """p = c^2 (rho - rho_0) - p_background: the same to first order, and all that weak compressibility needs.

    Attributes:
        background_pressure: [Pa], taken off the pressure.
    """

    background_pressure: Any = 0.0

    def __post_init__(self):
        check_finite("LinearStateEquation.background_pressure", self.background_pressure)

    def pressure(self, deviation, rest_density, sound_speed):
        """p [Pa]."""
        return sound_speed**2 * deviation - self.background_pressure

    def deviation(self, pressure, rest_density, sound_speed):
        """rho - rho_0 [kg/m^3]."""
        return (pressure + self.background_pressure) / sound_speed**2
