"""What the scenes of plates in water share."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from jaxsph.effects import ArtificialViscosity, DeltaDiffusion, KelvinVoigt, PenaltyForce
from jaxsph.geometry import Particles, clamped_strip
from jaxsph.materials import lame_parameters
from jaxsph.neighbors import Domain
from jaxsph.scene import Scene
from jaxsph.scenes.tank_flow import GRAVITY

PENALTY = 1.0
"""Of what water strikes: with the .05 of beams that swing, a struck plate of 3 particles over the thickness alternates
by 8 % of its spacing, with 1 by .7 %. It bends .7 % less with 5 over the thickness; the stable step stays."""


def rooted_plate(place: float, thickness: float, length: float, across: int, dtype=None) -> tuple[Particles, Any]:
    """An upright plate on the floor y = 0, from x = place, and which of its particles are its root in the floor."""
    strip = clamped_strip(length, thickness, across, dtype=dtype)
    along, over = strip.positions.T
    positions = np.stack([place + 0.5 * thickness + over, along], axis=1).astype(strip.positions.dtype)
    return dataclasses.replace(strip, positions=positions), lambda x: x[:, 1] < strip.spacing


def without(walls: Particles, body: Particles) -> Particles:
    """Particles of a wall that are not inside the box around the cells of a body."""
    low, high = np.min(body.positions, axis=0), np.max(body.positions, axis=0)
    more = (0.5 - 1e-6) * body.spacing
    return walls.where(~np.all((walls.positions > low - more) & (walls.positions < high + more), axis=1))


USUAL = (DeltaDiffusion(0.1), ArtificialViscosity(0.02), PenaltyForce(PENALTY))
"""Effects of the scenes of fluids and plates."""


def friction_of(structure: Any) -> KelvinVoigt:
    """Friction that holds down vibrations which a fluid feeds: tau of a tenth of the spacing over the wave speed."""
    lam, mu = lame_parameters(structure.youngs_modulus, structure.poisson_ratio)
    wave_speed = float(np.sqrt((lam + 2 * mu) / structure.density))
    return KelvinVoigt(0.1 * float(structure.particles.spacing) / wave_speed)


def plate_scene(*systems, effects, smoothing, inside) -> Scene:
    """Gravity, the effects that such scenes share, and a domain with room for what splashes out."""
    gravity = np.zeros(systems[0].dimension)
    gravity[-1] = -GRAVITY
    reach = 2.0 * np.asarray(inside)
    return Scene(
        *systems,
        gravity=gravity,
        effects=effects,
        smoothing_length=smoothing,
        domain=Domain(-reach, 2 * reach),
    )
