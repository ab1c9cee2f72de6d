"""The sums of a fluid over its pairs: rate of the density, forces, and what a wall takes over from the fluid.

Two passes over the pairs make a step: one for the density, one for the forces. All effects of a scene share them, and
every sum is weighted so that a pair is symmetric or antisymmetric: momentum and mass are exchanged to round-off, and a
gradient costs half.
"""

from jaxsph.flow.density import density_rates, filtered, keep_volume, summed_deviations
from jaxsph.flow.forces import corrected, forces
from jaxsph.flow.pairs import FluidReference, Pair, WallReference, fluid_fields, partners, pressure
from jaxsph.flow.pressure import keep_mean, pressure_rates
from jaxsph.flow.walls import wall_states

__all__ = [
    "FluidReference",
    "Pair",
    "WallReference",
    "corrected",
    "density_rates",
    "filtered",
    "fluid_fields",
    "forces",
    "keep_mean",
    "keep_volume",
    "partners",
    "pressure",
    "pressure_rates",
    "summed_deviations",
    "wall_states",
]
