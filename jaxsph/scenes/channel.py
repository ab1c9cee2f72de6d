"""Flow between two plates, from rest: driven by a force, or by a plate."""

from __future__ import annotations

from collections.abc import Sequence

from jaxsph.effects import DensityDiffusion
from jaxsph.fluid import Fluid
from jaxsph.geometry import box, tank
from jaxsph.kernels import QuinticSpline
from jaxsph.neighbors import Domain
from jaxsph.scene import Scene
from jaxsph.walls import Wall


def poiseuille(
    particles: int = 20,
    *,
    height: float = 1e-3,
    density: float = 1000.0,
    viscosity: float = 1e-3,
    top_speed: float = 1.25e-5,
    sound_speed: float | None = None,
    effects: Sequence | None = None,
    dtype=None,
) -> Scene:
    """Poiseuille flow that starts from rest under a constant force along x; periodic along x.

    The default is that of J. P. Morris, P. J. Fox, Y. Zhu (1997), J. Comput. Phys. 136, 214, section 5.2.

    Args:
        particles: across the channel.
        height: [m].
        density, viscosity: [kg/m^3], [Pa s].
        top_speed: in the middle, in the end [m/s]; the force per mass is 8 nu top_speed / height^2.
        sound_speed: [m/s]; None takes 10 top speeds.
        effects: None takes `DensityDiffusion(0.1)`.
        dtype: float32 or float64; None takes jax's default.
    """
    force = 8 * viscosity / density * top_speed / height**2
    scene = _channel(particles, height, density, viscosity, top_speed, sound_speed, effects, dtype, lid=None)
    return scene.replace({"gravity": [force, 0.0]})


def couette(
    particles: int = 20,
    *,
    height: float = 1e-3,
    density: float = 1000.0,
    viscosity: float = 1e-3,
    top_speed: float = 1.25e-5,
    sound_speed: float | None = None,
    effects: Sequence | None = None,
    dtype=None,
) -> Scene:
    """Couette flow that starts from rest when the upper plate begins to slide along x; periodic along x.

    Arguments and source as of `poiseuille`; `top_speed` is that of the plate.
    """
    return _channel(particles, height, density, viscosity, top_speed, sound_speed, effects, dtype, lid=top_speed)


def _channel(particles, height, density, viscosity, top_speed, sound_speed, effects, dtype, lid):
    if particles < 5:
        raise ValueError(f"{particles} particles across the channel; at least 5 are needed")
    spacing = height / particles
    length, layers = max(10, particles // 2) * spacing, 4
    sides = {"bottom": "lower_plate", "top": "upper_plate"}
    plates = [
        Wall(
            name,
            tank((0, 0), (length, height), spacing, layers, sides=[side], dtype=dtype),
            velocity=(lid, 0.0) if lid is not None and side == "top" else None,
        )
        for side, name in sides.items()
    ]
    water = Fluid(
        "water",
        box((0, 0), (length, height), spacing, dtype=dtype),
        density=density,
        sound_speed=10 * abs(top_speed) if sound_speed is None else sound_speed,
        viscosity=viscosity,
    )
    margin = (layers + 2) * spacing
    return Scene(
        water,
        *plates,
        effects=[DensityDiffusion(0.1)] if effects is None else effects,
        kernel=QuinticSpline(),
        smoothing_length=spacing,
        domain=Domain((0.0, -margin), (length, height + margin), periodic=(True, False)),
    )
