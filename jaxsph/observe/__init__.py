"""Observers: pure functions of a scene and one state, differentiable, for use inside a loss.

Of a whole run: `run.observe(lambda scene, state: observe.surge_front(scene, state, "water"))`, or `jax.vmap` over
`run.states`.
"""

from jaxsph.observe.balance import angular_momentum, energies, linear_momentum
from jaxsph.observe.fields import coverage, density, interpolate, pressure, vorticity
from jaxsph.observe.places import line, plane
from jaxsph.observe.sensors import wall_pressure
from jaxsph.observe.structures import stresses
from jaxsph.observe.surface import free_surface_height, surge_front

__all__ = [
    "angular_momentum",
    "coverage",
    "density",
    "energies",
    "free_surface_height",
    "interpolate",
    "line",
    "linear_momentum",
    "plane",
    "pressure",
    "stresses",
    "surge_front",
    "vorticity",
    "wall_pressure",
]
