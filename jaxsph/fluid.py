"""Weakly compressible fluids: what a fluid is. The sums over its pairs are in `jaxsph.flow`."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxsph import checks
from jaxsph.geometry.shapes import Particles
from jaxsph.materials.state_equation import LinearStateEquation, StateEquation
from jaxsph.materials.viscosity import MorrisViscosity, ViscosityLaw
from jaxsph.pytree import as_real, is_concrete, one_if_alike, pytree_dataclass, static
from jaxsph.system import System


@pytree_dataclass
class Fluid(System):
    """A weakly compressible fluid.

    Attributes:
        name: how the scene and its results call it.
        particles: positions (N, d) [m] and volumes (N,) [m^d] at the start.
        density: rest density rho_0 [kg/m^3].
        sound_speed: c [m/s], numerical: at least ten times the fastest motion keeps the density within 1 %.
        viscosity: dynamic viscosity mu [Pa s]; None is an inviscid fluid, for which nothing is compiled.
        velocity: initial velocity (d,) or (N, d) [m/s], or a function of positions (N, d) that gives it.
        pressure: initial pressure (N,) [Pa], or a function of positions; None is zero. The density follows from
            the equation of state, and the mass of a particle is that density times its volume.
        state_equation: `LinearStateEquation()` or `Cole(exponent)`.
        viscosity_law: `MorrisViscosity()`, `AdamiViscosity()`, or `MonaghanViscosity()` for flows with a free surface.

    Raises:
        ValueError: a value out of its range, with the limit; a shape that does not fit.
    """

    name: str = static()
    particles: Particles
    density: Any
    sound_speed: Any
    viscosity: Any = None
    velocity: Any = None
    pressure: Any = None
    state_equation: StateEquation = LinearStateEquation()
    viscosity_law: ViscosityLaw = MorrisViscosity()

    def __post_init__(self):
        d, real = self.dimension, self.dtype
        checks.check_name(self.name, "viscosity")
        checks.check_kind(f"{self.name}.state_equation", self.state_equation, StateEquation, "Cole(7.0)")
        checks.check_kind(f"{self.name}.viscosity_law", self.viscosity_law, ViscosityLaw, "MonaghanViscosity()")
        for name in ("density", "sound_speed", "viscosity"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, as_real(getattr(self, name), real))
        for name in ("velocity", "pressure"):
            value = getattr(self, name)
            if callable(value):
                value = value(np.asarray(self.particles.positions))
            if value is None and name == "velocity":
                value = np.zeros(d)
            object.__setattr__(self, name, None if value is None else as_real(value, real))
        self.check()

    def check(self, prefix: str = "") -> None:
        """Raise ValueError if a number is out of its range or has a shape that does not fit. Traced ones pass.

        Args:
            prefix: before the names in the message, such as "water.".
        """
        n, d = np.shape(self.particles.positions)
        checks.check_positive(prefix + "density", self.density, "kg/m^3")
        checks.check_positive(prefix + "sound_speed", self.sound_speed, "m/s")
        if self.viscosity is not None:
            checks.check_at_least(prefix + "viscosity", self.viscosity, 0.0, "Pa s")
        for name in ("density", "sound_speed", "viscosity"):
            if np.shape(getattr(self, name)) != () and getattr(self, name) is not None:
                raise ValueError(f"{prefix}{name} has shape {np.shape(getattr(self, name))}; it must be one number")
        if np.shape(self.velocity) not in ((d,), (n, d)):
            raise ValueError(f"{prefix}velocity has shape {np.shape(self.velocity)}; it must be ({d},) or ({n}, {d})")
        checks.check_finite(f"{prefix}velocity", self.velocity)
        if self.pressure is not None:
            checks.check_finite(f"{prefix}pressure", self.pressure, (n,))
            if is_concrete(self.pressure, self.density, self.sound_speed, self.state_equation):
                lowest = self.density + np.min(np.asarray(self.initial_deviation()))
                if not lowest > 0:
                    raise ValueError(
                        f"{prefix}pressure reaches {np.min(self.pressure):.4g} Pa, at which the equation of state "
                        f"gives a density of {lowest:.4g} kg/m^3; take a higher sound speed or a background pressure"
                    )

    def initial_deviation(self):
        """Initial density less rest density [kg/m^3], one number or (N,)."""
        pressure = 0.0 if self.pressure is None else self.pressure
        return self.state_equation.deviation(pressure, self.density, self.sound_speed)

    def mass(self):
        """Mass of the particles [kg, in 2D per meter]: one number if all are alike, else (N,).

        One number is not gathered in the sums over neighbors.
        """
        volumes = self.particles.volumes
        if self.pressure is None:
            volumes = one_if_alike(volumes)
        return (self.density + self.initial_deviation()) * volumes
