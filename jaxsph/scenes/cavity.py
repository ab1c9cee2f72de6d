"""The lid-driven cavity."""

from __future__ import annotations

from collections.abc import Sequence

from jaxsph.checks import check_positive
from jaxsph.effects import DensityDiffusion, ParticleShifting
from jaxsph.fluid import Fluid
from jaxsph.geometry import box, tank
from jaxsph.kernels import QuinticSpline
from jaxsph.neighbors import Domain
from jaxsph.scene import Scene
from jaxsph.walls import Wall

LAYERS = 4


def lid_driven_cavity(
    particles: int = 50,
    *,
    reynolds: float = 100.0,
    sound_speed: float = 10.0,
    effects: Sequence | None = None,
    density=None,
    dtype=None,
) -> Scene:
    """Fluid in the unit square, whose lid slides along x with the velocity 1; the density is 1.

    U. Ghia, K. N. Ghia, C. T. Shin (1982), J. Comput. Phys. 48, 387. The lid stays where it is and has a velocity.

    Args:
        particles: along an edge.
        reynolds: Re = U L / nu.
        sound_speed: [m/s].
        effects: None takes `DensityDiffusion(0.1)` and `ParticleShifting(1.0)`.
        density: how the fluid gets its density; None takes `ContinuityDensity()`.
        dtype: float32 or float64; None takes jax's default.

    Raises ValueError for less than 8 particles along an edge, or a Reynolds number that is not positive.
    """
    check_positive("reynolds", reynolds, "no unit")
    if particles < 8:
        raise ValueError(f"{particles} particles along an edge; at least 8 are needed")
    spacing = 1.0 / particles
    walls = tank((0, 0), (1, 1), spacing, LAYERS, sides=["left", "right", "bottom", "top"], dtype=dtype)
    # The corners belong to the walls that stand still, which is where the lid's velocity jumps.
    above = (walls.positions[:, 1] > 1) & (walls.positions[:, 0] > 0) & (walls.positions[:, 0] < 1)
    water = Fluid(
        "water",
        box((0, 0), (1, 1), spacing, dtype=dtype),
        density=1.0,
        sound_speed=sound_speed,
        viscosity=1.0 / reynolds,
    )
    margin = (LAYERS + 2) * spacing
    return Scene(
        water,
        Wall("cavity", walls.where(~above)),
        Wall("lid", walls.where(above), velocity=(1.0, 0.0)),
        effects=[DensityDiffusion(0.1), ParticleShifting(1.0)] if effects is None else effects,
        kernel=QuinticSpline(),
        smoothing_length=spacing,
        density=density,
        domain=Domain((-margin, -margin), (1 + margin, 1 + margin)),
    )
