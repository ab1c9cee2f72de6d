"""Water at rest, which several tests of observers use."""

from typing import Any

import numpy as np

import jaxsph as sph
from jaxsph import pytree
from jaxsph.geometry import tank

GRAVITY, REST, DX = 10.0, 1000.0, 0.1
WIDTH, HEIGHT = 1.6, 0.8


def basin(kind: Any = np.float64, d=2, width=WIDTH, **changes: Any) -> sph.Scene:
    """Water at rest in a tank whose corner is the origin, with its hydrostatic pressure."""
    size = (width, HEIGHT) if d == 2 else (width, 0.6, HEIGHT)
    down = -GRAVITY * np.eye(d)[-1]
    about: dict[str, Any] = {
        "density": REST,
        "sound_speed": 40.0,
        "pressure": lambda x: REST * GRAVITY * (HEIGHT - x[:, -1]),
    }
    motion = changes.pop("motion", None)
    water = sph.Fluid("water", sph.box(np.zeros(d), size, DX, dtype=kind), **{**about, **changes})
    walls = sph.Wall("tank", tank(np.zeros(d), size, DX, 4, dtype=kind), motion=motion)
    return sph.Scene(water, walls, gravity=down, smoothing_length=1.75 * DX)


def with_water(state, **fields):
    return pytree.replace(state, systems={**state.systems, "water": {**state.systems["water"], **fields}})
