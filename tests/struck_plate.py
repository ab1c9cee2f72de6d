"""A small scene of water that strikes an elastic plate, of effects that are smooth."""

import numpy as np

import jaxsph as sph
from jaxsph.geometry import box, jitter

SPACING, COLUMNS, HEIGHT, THICKNESS = 0.02, 6, 0.1, 0.02
MIDDLE = COLUMNS * SPACING / 2


def struck_plate(across: int = 3) -> sph.Scene:
    """A block of disordered water that touches a plate held at both ends, and falls on it with 2 m/s."""
    width, overhang = COLUMNS * SPACING, 0.06
    plate = sph.Structure(
        "plate",
        box((-overhang, -THICKNESS), (width + 2 * overhang, THICKNESS), THICKNESS / (across - 1), on_surface=True),
        density=1500.0,
        youngs_modulus=2e6,
        poisson_ratio=0.3,
        clamped=lambda x: np.abs(x[:, 0] - MIDDLE) > MIDDLE + 0.04,
        pressure=sph.AdamiExtrapolation(),
        thickness=THICKNESS,
    )
    water = sph.Fluid(
        "water",
        jitter(box((0, 0), (width, HEIGHT), SPACING), 0.1, 2),
        density=1000.0,
        sound_speed=30.0,
        viscosity=2.0,
        velocity=lambda x: np.stack([0.5 * x[:, 1] / HEIGHT, -2.0 + 0 * x[:, 1]], axis=1),
    )
    effects = [sph.DeltaDiffusion(0.1), sph.PenaltyForce(0.05)]
    return sph.Scene(water, plate, gravity=(0.0, -9.81), effects=effects, domain=sph.Domain((-1, -1), (2, 2)))
