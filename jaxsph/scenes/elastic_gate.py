"""A tank that empties below a rubber gate."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxsph.fluid import Fluid
from jaxsph.geometry import box, tank
from jaxsph.geometry.strip import spacing_across
from jaxsph.materials import StVenantKirchhoff
from jaxsph.scene import Scene
from jaxsph.scenes.plate_parts import USUAL, friction_of, plate_scene, rooted_plate, without
from jaxsph.scenes.tank_flow import GRAVITY, layers_of
from jaxsph.structure import Structure
from jaxsph.walls import AdamiExtrapolation, Wall


def elastic_gate(
    particles: int = 40,
    across: int = 5,
    *,
    youngs_modulus: float = 7.8e6,
    poisson_ratio: float = 0.47,
    gate_density: float = 1100.0,
    density: float = 1000.0,
    sound_speed: float | None = None,
    width: float = 0.1,
    height: float = 0.14,
    thickness: float = 0.005,
    length: float = 0.079,
    outside: float = 0.4,
    smoothing: float = 1.75,
    effects: Sequence | None = None,
    law: Any = None,
    dtype=None,
) -> Scene:
    """A tank of water that flows out below a rubber gate, which is clamped at its top and bends.

    C. Antoci, M. Gallati, S. Sibilla (2007), Comput. Struct. 85, 879: the gate of 79 mm x 5 mm is the lower end of the
    right side of a tank, .1 m wide and filled to .14 m. They took E = 12 MPa from a test of the rubber; 7.8 MPa is in
    use for laws that do not stiffen.

    Args:
        particles: over the width of the water.
        across: particles over the thickness of the gate, the outermost on its surfaces.
        youngs_modulus: of the gate [Pa].
        poisson_ratio: of the gate.
        gate_density: [kg/m^3].
        density, sound_speed: of the water; a sound speed of None is 10 sqrt(2 g height).
        width, height: of the water [m].
        thickness, length: of the gate [m].
        outside: length of the floor behind the gate [m].
        smoothing: smoothing length in spacings of the water.
        effects: None takes `DeltaDiffusion(0.1)`, `ArtificialViscosity(0.02)`, `PenaltyForce(1)`, and a
            `KelvinVoigt` friction of a tenth of the spacing over the speed of p-waves in the gate: without it the
            water, which meets the gate once in a step of its own, feeds fast vibrations until the gate breaks.
        law: elastic law; None takes `StVenantKirchhoff()`.
        dtype: float32 or float64; None takes jax's default.
    """
    spacing = width / particles
    height = round(height / spacing) * spacing
    water = Fluid(
        "water",
        box((0, 0), (width, height), spacing, dtype=dtype),
        density=density,
        sound_speed=10 * math.sqrt(2 * GRAVITY * height) if sound_speed is None else sound_speed,
        pressure=lambda x: density * GRAVITY * (height - x[:, 1]),
    )
    # The gate hangs from y = length, with held rows above; upside down it is a rooted plate.
    # Its face is where the cells of its outermost particles end.
    body, _ = rooted_plate(width + 0.5 * spacing_across(thickness, across), thickness, length, across, dtype)
    upright = body.positions * np.array([1.0, -1.0]) + np.array([0.0, length])
    body = dataclasses.replace(body, positions=upright.astype(body.positions.dtype))
    gate = Structure(
        "gate",
        body,
        density=gate_density,
        youngs_modulus=youngs_modulus,
        poisson_ratio=poisson_ratio,
        clamped=lambda x: x[:, 1] > length - body.spacing,
        law=StVenantKirchhoff() if law is None else law,
        pressure=AdamiExtrapolation(clip=True),
        thickness=thickness,
    )
    top = round(1.2 * height / spacing) * spacing
    layers = layers_of(smoothing)
    deep = layers * spacing
    left_and_floor = tank((0, 0), (width, top), spacing, layers, sides=["left", "bottom"], dtype=dtype)
    floor = box((width, -deep), (round(outside / spacing) * spacing, deep), spacing, dtype=dtype)
    right = box((width, 0.0), (deep, top), spacing, dtype=dtype)
    right = right.where(right.positions[:, 1] > length)
    basin = Wall("tank", without(left_and_floor | floor | right, body), AdamiExtrapolation(clip=True), no_slip=False)
    inside = (width + outside, 4 * top)  # what flows off the floor falls
    effects = (*USUAL, friction_of(gate)) if effects is None else effects
    return plate_scene(water, basin, gate, effects=effects, smoothing=smoothing * spacing, inside=inside)
