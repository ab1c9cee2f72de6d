"""Fluids and elastic plates: a column of water on a plate, and a dam that breaks against one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from jaxsph.effects import WallRepulsion
from jaxsph.fluid import Fluid
from jaxsph.geometry import box, tank
from jaxsph.geometry.strip import spacing_across
from jaxsph.materials import MonaghanViscosity, StVenantKirchhoff
from jaxsph.pytree import replace
from jaxsph.scene import Scene
from jaxsph.scenes.moving import dam_break_gate
from jaxsph.scenes.plate_parts import USUAL, friction_of, plate_scene, rooted_plate, without
from jaxsph.scenes.tank_flow import GRAVITY, layers_of
from jaxsph.structure import Structure
from jaxsph.walls import AdamiExtrapolation, Wall


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
        effects: None takes `DeltaDiffusion(0.1)`, `ArtificialViscosity(0.02)`, `PenaltyForce(1)`, `WallRepulsion()`.
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
        viscosity_law=MonaghanViscosity(),
        pressure=lambda x: density * GRAVITY * (height - x[:, 1]),
    )
    walls = tank((0, 0), inside, spacing, layers_of(smoothing), dtype=dtype)
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
    basin = Wall("tank", without(walls, body), AdamiExtrapolation(clip=True), no_slip=False)
    # A jet that sinks into the far wall comes out again with energy that nobody put in: H07 in docs/stability.md.
    effects = (*USUAL, WallRepulsion()) if effects is None else effects
    return plate_scene(water, basin, plate, effects=effects, smoothing=smoothing * spacing, inside=inside)


def water_column_on_plate(
    across: int = 5,
    *,
    youngs_modulus: float = 67.5e9,
    poisson_ratio: float = 0.3,
    plate_density: float = 2700.0,
    density: float = 1000.0,
    sound_speed: float = 50.0,
    thickness: float = 0.05,
    width: float = 1.0,
    height: float = 2.0,
    smoothing: float = 1.5,
    effects: Sequence | None = None,
    dtype=None,
) -> Scene:
    """Water at rest on an elastic plate that is clamped at both sides and begins to carry it at t = 0.

    G. Fourey, C. Hermange, D. Le Touze, G. Oger (2017), Comput. Phys. Commun. 217, 66, section 5.1: an aluminium plate
    of 1 m x .05 m under 2 m of water. Its static deflection is what is asked for, about which it swings. Without
    friction the water, which does not see vibrations faster than its own steps as they are, feeds them (see H17 in
    docs/stability.md).

    The water begins half a spacing above the plate, where the cells of the plate's outermost particles end.

    Args:
        across: particles over the thickness of the plate, the outermost on its surfaces; the water's spacing is theirs.
        youngs_modulus: of the plate [Pa].
        poisson_ratio: of the plate.
        plate_density: [kg/m^3].
        density, sound_speed: of the water.
        thickness, width: of the plate [m], multiples of its spacing.
        height: of the water [m].
        smoothing: smoothing length in spacings of the water.
        effects: None takes `DeltaDiffusion(0.1)`, `ArtificialViscosity(0.02)`, `PenaltyForce(1)`, and a
            `KelvinVoigt` friction of a tenth of the spacing over the speed of p-waves in the plate.
        dtype: float32 or float64; None takes jax's default.
    """
    spacing = spacing_across(thickness, across)
    rows, layers = round(height / spacing), layers_of(smoothing, least=1)
    height, low = rows * spacing, 0.5 * spacing
    water = Fluid(
        "water",
        box((0, low), (width, height), spacing, dtype=dtype),
        density=density,
        sound_speed=sound_speed,
        pressure=lambda x: density * GRAVITY * (low + height - x[:, 1]),
    )
    inside = (width, round(1.1 * rows) * spacing)
    sides = tank((0, low), inside, spacing, layers, sides=["left", "right"], dtype=dtype)
    deep = layers * spacing
    plate = Structure(
        "plate",
        box(
            (0.5 * spacing - deep, -thickness),  # see clamped_strip
            (width - spacing + 2 * deep, thickness),
            spacing,
            on_surface=True,
            dtype=dtype,
        ),
        density=plate_density,
        youngs_modulus=youngs_modulus,
        poisson_ratio=poisson_ratio,
        clamped=lambda x: (x[:, 0] < spacing) | (x[:, 0] > width - spacing),
        thickness=thickness,
    )
    walls = Wall("tank", sides, no_slip=False)
    effects = (*USUAL, friction_of(plate)) if effects is None else effects
    return plate_scene(water, walls, plate, effects=effects, smoothing=smoothing * spacing, inside=inside)


def dam_break_gate_plate(
    spacing: float = 0.01,
    across: int = 4,
    *,
    thickness: float = 0.004,
    youngs_modulus: float = 3.5e6,
    poisson_ratio: float = 0.45,
    plate_density: float = 1161.54,
    length: float = 0.09,
    place: float = 0.6,
    sound_speed: float = 28.01,
    smoothing: float = 1.75,
    effects: Sequence | None = None,
    dtype=None,
) -> Scene:
    """The dam behind a gate that is pulled up, `dam_break_gate`, and an elastic plate in its way.

    K. Liao, C. Hu, M. Sueyoshi (2015), Appl. Ocean Res. 50, 57. The default plate is that of the experiment;
    thickness = .04, youngs_modulus = 3.5e5, across = 4, place = .56 is the one that TrixiParticles.jl runs.

    Args:
        spacing: of the water [m], a divisor of .2 m.
        across: particles over the thickness of the plate, the outermost on its surfaces.
        thickness, length: of the plate [m].
        youngs_modulus: of the plate [Pa].
        poisson_ratio: of the plate.
        plate_density: [kg/m^3].
        place: of its left face [m].
        sound_speed: of the water [m/s].
        smoothing: smoothing length in spacings of the water.
        effects: None takes `DeltaDiffusion(0.1)`, `ArtificialViscosity(0.02)`, `PenaltyForce(1)`, and a
            `KelvinVoigt` friction of a tenth of the spacing over the speed of p-waves in the plate.
        dtype: float32 or float64; None takes jax's default.
    """
    dam = dam_break_gate(spacing, sound_speed=sound_speed, smoothing=smoothing, dtype=dtype)
    body, root = rooted_plate(place, thickness, length, across, dtype)
    plate = Structure(
        "plate",
        body,
        density=plate_density,
        youngs_modulus=youngs_modulus,
        poisson_ratio=poisson_ratio,
        clamped=root,
        pressure=AdamiExtrapolation(clip=True),
        thickness=thickness,
    )
    basin = replace(dam["tank"], particles=without(dam["tank"].particles, body))
    effects = (*USUAL, friction_of(plate)) if effects is None else effects
    return plate_scene(
        dam["water"], basin, dam["gate"], plate, effects=effects, smoothing=smoothing * spacing, inside=(0.8, 0.8)
    )
