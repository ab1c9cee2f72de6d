"""Water in a tank: at rest, as a breaking dam, with a gate that opens, pushed by a wall, and as a standing wave."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from jaxsph.effects import ArtificialViscosity, DeltaDiffusion
from jaxsph.fluid import Fluid
from jaxsph.geometry import box, tank
from jaxsph.materials import MonaghanViscosity
from jaxsph.neighbors import Domain
from jaxsph.scene import Scene
from jaxsph.walls import AdamiExtrapolation, Wall

GRAVITY = 9.81  # m/s^2
LAYERS = 4  # of wall particles at least


def layers_of(smoothing: float, least: int = LAYERS) -> int:
    """How many layers of particles a wall has for a smoothing length in spacings: as many as water beside it sees.

    With fewer it is pushed back by less, and gets through.
    """
    return max(least, math.ceil(2 * smoothing))


def still_water(
    particles: int = 20,
    *,
    height: float = 0.9,
    width: float = 1.0,
    density: float = 1000.0,
    sound_speed: float | None = None,
    viscosity: float | None = None,
    effects: Sequence | None = None,
    smoothing: float = 2.0,
    dtype=None,
) -> Scene:
    """Water at rest in an open tank, with its hydrostatic pressure.

    Args:
        particles: over the height of the water.
        height, width: of the water [m].
        density: [kg/m^3].
        sound_speed: [m/s]; None takes 10 sqrt(2 g height).
        viscosity: [Pa s]; None is inviscid.
        effects: None takes `DeltaDiffusion(0.1)` and `ArtificialViscosity(0.02)`.
        smoothing: smoothing length in spacings.
        dtype: float32 or float64; None takes jax's default.
    """
    spacing = height / particles
    columns = max(round(width / spacing), 2)
    return column_in_tank(
        (columns * spacing, height),
        (columns * spacing, round(1.2 * particles) * spacing),
        spacing,
        density=density,
        sound_speed=sound_speed,
        viscosity=viscosity,
        effects=effects,
        smoothing=smoothing,
        dtype=dtype,
    )


def dam_break(
    particles: int = 40,
    *,
    height: float = 0.6,
    width: float = 1.2,
    tank_length: float = 3.2196,
    tank_height: float = 1.8,
    depth: float | None = None,
    density: float = 1000.0,
    sound_speed: float | None = None,
    viscosity: float | None = None,
    effects: Sequence | None = None,
    hydrostatic: bool = True,
    smoothing: float = 2.0,
    dtype=None,
) -> Scene:
    """A column of water that collapses in a tank.

    The default is the tank of B. Buchner (2002), Green water on ship-type offshore structures, Delft: 1.2 m x .6 m of
    water, 5.366 water heights of tank. Martin and Moyce's (1952) is height = 2 width.

    Args:
        particles: over the height of the water.
        height, width: of the column [m].
        tank_length, tank_height: inner sizes of the tank [m], rounded to the spacing; the top is open.
        depth: of the column and the tank along y in 3D [m]; None is 2D.
        density: [kg/m^3].
        sound_speed: [m/s]; None takes 20 sqrt(g height).
        viscosity: [Pa s]; None is inviscid.
        effects: None takes `DeltaDiffusion(0.1)` and `ArtificialViscosity(0.02)`.
        hydrostatic: start with hydrostatic pressure; False starts without pressure.
        smoothing: smoothing length in spacings.
        dtype: float32 or float64; None takes jax's default.
    """
    spacing = height / particles
    inside = [round(tank_length / spacing) * spacing, round(tank_height / spacing) * spacing]
    column = [round(width / spacing) * spacing, height]
    if depth is not None:
        inside.insert(1, round(depth / spacing) * spacing)
        column.insert(1, round(depth / spacing) * spacing)
    return column_in_tank(
        column,
        inside,
        spacing,
        density=density,
        sound_speed=20 * math.sqrt(GRAVITY * height) if sound_speed is None else sound_speed,
        viscosity=viscosity,
        effects=effects,
        hydrostatic=hydrostatic,
        smoothing=smoothing,
        dtype=dtype,
    )


def column_in_tank(
    column: Sequence[float],
    inside: Sequence[float],
    spacing: float,
    *,
    density: float = 1000.0,
    sound_speed: float | None = None,
    viscosity: float | None = None,
    effects: Sequence | None = None,
    hydrostatic: bool = True,
    smoothing: float = 2.0,
    no_slip: bool = False,
    motion: Callable | None = None,
    walls: Sequence[Wall] = (),
    corner: Sequence[float] | None = None,
    dtype=None,
) -> Scene:
    """A box of water in an open tank whose lower corner is the origin.

    Args:
        column, inside: sizes of the water and of the inside of the tank (d,) [m], multiples of the spacing.
        spacing: [m].
        density, sound_speed, viscosity: of the water; a sound speed of None is 10 sqrt(2 g height).
        effects: None takes `DeltaDiffusion(0.1)` and `ArtificialViscosity(0.02)`.
        hydrostatic: start with hydrostatic pressure.
        smoothing: smoothing length in spacings.
        no_slip: whether viscous water sticks to the tank.
        motion: prescribed displacement of the tank, see `Wall`.
        walls: further ones.
        corner: lower corner of the water (d,) [m]; None is that of the tank.
        dtype: float32 or float64; None takes jax's default.
    """
    d, height = len(column), column[-1]
    start = np.zeros(d) if corner is None else np.asarray(corner, float)
    gravity = np.zeros(d)
    gravity[-1] = -GRAVITY
    water = Fluid(
        "water",
        box(start, column, spacing, dtype=dtype),
        density=density,
        sound_speed=10 * math.sqrt(2 * GRAVITY * height) if sound_speed is None else sound_speed,
        viscosity=viscosity,
        viscosity_law=MonaghanViscosity(),
        pressure=(lambda x: density * GRAVITY * (start[-1] + height - x[:, -1])) if hydrostatic else None,
    )
    basin = Wall(
        "tank",
        tank(np.zeros(d), inside, spacing, layers_of(smoothing), dtype=dtype),
        AdamiExtrapolation(clip=True),
        no_slip=no_slip,
        motion=motion,
    )
    reach = 2.0 * np.asarray(inside)
    return Scene(
        water,
        basin,
        *walls,
        gravity=gravity,
        effects=[DeltaDiffusion(0.1), ArtificialViscosity(0.02)] if effects is None else effects,
        smoothing_length=smoothing * spacing,
        domain=Domain(-reach, 2 * reach),
    )
