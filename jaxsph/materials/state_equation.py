"""Equations of state: pressure from density, equation (13) of the poster, and back, and stored energy.

They work on the density's deviation from the rest density, rho - rho_0, not on rho: in float32 a weakly compressible
fluid would lose its pressure in the rounding of rho.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

import jax.numpy as jnp

from jaxsph.checks import check_finite, check_positive
from jaxsph.pytree import pytree_dataclass


class StateEquation(ABC):
    """Pressure p [Pa] of a fluid whose density deviates from rest, the inverse, and the energy that it stores."""

    background_pressure: Any

    @abstractmethod
    def pressure(self, deviation, rest_density, sound_speed) -> Any:
        """p [Pa] from rho - rho_0 [kg/m^3], rho_0 [kg/m^3] and c [m/s]."""

    @abstractmethod
    def deviation(self, pressure, rest_density, sound_speed) -> Any:
        """rho - rho_0 [kg/m^3] from p [Pa]."""

    @abstractmethod
    def energy(self, deviation, rest_density, sound_speed) -> Any:
        """Energy of the compression per mass [J/kg]: the integral of p / rho^2 drho from rho_0; zero at rest."""


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

    def energy(self, deviation, rest_density, sound_speed):
        """c^2 / gamma ((r^(gamma - 1) - 1) / (gamma - 1) + 1 / r - 1) - p_background (1 / rho_0 - 1 / rho) [J/kg].

        r = rho / rho_0; for gamma = 1 the first term is ln r.
        """
        return _energy(deviation, rest_density, sound_speed, self.exponent, self.background_pressure)


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

    def energy(self, deviation, rest_density, sound_speed):
        """c^2 (ln r + 1 / r - 1) - p_background (1 / rho_0 - 1 / rho) [J/kg], where r = rho / rho_0."""
        return _energy(deviation, rest_density, sound_speed, 1.0, self.background_pressure)


def _energy(deviation, rest_density, sound_speed, exponent, background_pressure):
    """Energy per mass [J/kg], without the difference of nearly equal numbers that the formulas have near rest.

    With L = ln r and phi(z) = (e^z - 1 - z) / z^2 the first bracket is L^2 ((gamma - 1) phi((gamma - 1) L) + phi(-L)).
    """
    ratio = deviation / rest_density
    log = jnp.log1p(ratio)
    bracket = log**2 * ((exponent - 1) * _second_remainder((exponent - 1) * log) + _second_remainder(-log))
    of_background = background_pressure * ratio / (rest_density * (1 + ratio))
    return sound_speed**2 / exponent * bracket - of_background


_SERIES = [1 / math.factorial(k + 2) for k in range(17, -1, -1)]


def _second_remainder(z):
    """(e^z - 1 - z) / z^2: a power series for |z| < 1, where the formula would lose its digits."""
    small = jnp.abs(z) < 1
    near, far = jnp.where(small, z, 0.0), jnp.where(small, 1.0, z)
    series = jnp.zeros_like(near)
    for coefficient in _SERIES:
        series = series * near + coefficient
    return jnp.where(small, series, (jnp.expm1(far) - far) / far**2)
