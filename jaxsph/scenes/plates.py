"""Fluids and elastic plates: a column of water on a plate, and a dam that breaks against one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxsph.effects import ArtificialViscosity, DeltaDiffusion, PenaltyForce
from jaxsph.fluid import Fluid
from jaxsph.geometry import Particles, box, tank
from jaxsph.materials import StVenantKirchhoff
from jaxsph.neighbors import Domain
from jaxsph.scene import Scene
from jaxsph.scenes.tank_flow import GRAVITY, LAYERS
from jaxsph.structure import Structure
from jaxsph.walls import AdamiExtrapolation, Wall

PENALTY = 0.05


def dam_break_plate(
    particles: int = 15,
    across: int = 5,
    *,
    youngs_modulus: float = 1e6,
    poisson_ratio: float = 0.0,
    plate_density: float = 2500.0,
    density: float = 1000.0,
    sound_speed: float | None = None,
    viscosity: float | None = None,
    thickness: float = 0.012,
    length: float = 0.08,
    smoothing: float = 1.75,
    effects: Sequence | None = None,
    law: Any = None,
    dtype=None,
) -> Scene:
    """A column of water that breaks against an elastic plate, clamped in the floor of the tank.

    E. Walhorn, A. Koelke, B. Huebner, D. Dinkler (2005), Comput. Struct. 83, 2100; S. R. Idelsohn, J. Marti,
    A. Limache, E. Onate (2008), Comput. Methods Appl. Mech. Eng. 197, 1762: a column of .146 m x .292 m in a tank of
    .584 m, the plate .292 m from its left side.

    Args:
        particles: over the width of the column.
        across: particles over the thickness of the plate, the outermost on its surfaces.
        youngs_modulus: of the plate [Pa].
        poisson_ratio: of the plate.
        plate_density: [kg/m^3].
        density, sound_speed, viscosity: of the water; a sound speed of None is 20 sqrt(g height).
        thickness, length: of the plate [m].
        smoothing: smoothing length in spacings of the water.
        effects: None takes `DeltaDiffusion(0.1)`, `ArtificialViscosity(0.02)`, `PenaltyForce(0.05)`.
        law: elastic law; None takes `StVenantKirchhoff()`.
        dtype: float32 or float64; None takes jax's default.
    """
    width, height, place = 0.146, 0.292, 0.292
    spacing = width / particles
    inside = (4 * width, 4 * width)
    water = Fluid(
        "water",
        box((0, 0), (width, height), spacing, dtype=dtype),
        density=density,
        sound_speed=20 * math.sqrt(GRAVITY * height) if sound_speed is None else sound_speed,
        viscosity=viscosity,
        pressure=lambda x: density * GRAVITY * (height - x[:, 1]),
    )
    walls = tank((0, 0), inside, spacing, LAYERS, dtype=dtype)
    body, root = rooted_plate(place, thickness, length, across, dtype)
    plate = Structure(
        "plate",
        body,
        density=plate_density,
        youngs_modulus=youngs_modulus,
        poisson_ratio=poisson_ratio,
        clamped=root,
        law=StVenantKirchhoff() if law is None else law,
        pressure=AdamiExtrapolation(clip=True),
        thickness=thickness,
    )
    basin = Wall("tank", _without(walls, body), AdamiExtrapolation(clip=True), no_slip=False)
    return _scene(water, basin, plate, effects=effects, smoothing=smoothing * spacing, inside=inside)


def rooted_plate(place: float, thickness: float, length: float, across: int, dtype=None) -> tuple[Particles, Any]:
    """An upright plate on the floor y = 0, from x = place, and which of its particles are its root in the floor.

    The face y = 0 is held, and behind it as many rows as a structure's neighbors reach.
    """
    spacing = thickness / (across - 1)
    rows = round(length / spacing)
    step, deep = length / rows, 3
    body = box((place, -deep * spacing), (thickness, (rows + deep) * spacing), spacing, on_surface=True, dtype=dtype)
    stretch = np.array([1.0, step / spacing])  # the length need not be a multiple of the spacing
    positions, volumes = body.positions * stretch, body.volumes * stretch[1]
    body = Particles(positions.astype(body.positions.dtype), volumes.astype(body.volumes.dtype), spacing)
    return body, lambda x: x[:, 1] < 0.01 * step


def _without(walls: Particles, body: Particles) -> Particles:
    """Particles of a wall that are not inside the box around a body."""
    low, high = np.min(body.positions, axis=0), np.max(body.positions, axis=0)
    margin = 1e-6 * (high - low)
    return walls.where(~np.all((walls.positions > low + margin) & (walls.positions < high - margin), axis=1))


def _scene(*systems, effects, smoothing, inside, gravity=None):
    d = systems[0].dimension
    if gravity is None:
        gravity = np.zeros(d)
        gravity[-1] = -GRAVITY
    reach = 2.0 * np.asarray(inside)
    default = [DeltaDiffusion(0.1), ArtificialViscosity(0.02), PenaltyForce(PENALTY)]
    return Scene(
        *systems,
        gravity=gravity,
        effects=default if effects is None else effects,
        smoothing_length=smoothing,
        domain=Domain(-reach, 2 * reach),
    )
