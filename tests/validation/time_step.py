"""F35: the largest stable time step of a fluid over h / c, by running into it.

The number of steps between two saves is the same for every step size, so that a scene is compiled once; neighbor lists
are built equally often. `simulate` refuses steps beyond its limit, so here the limit is lifted. Of two fluids c is the
speed c_b sqrt(rho_b / rho_a) of sound in a fluid as light as the one and as stiff as the other, over INTERFACE_LIMIT.
"""

from __future__ import annotations

from collections.abc import Iterator

import jax
import numpy as np
from any_step import any_step
from rows import Case, Row, precision

import jaxsph
from jaxsph.geometry import box, tank
from jaxsph.pytree import replace
from jaxsph.stable_step import INTERFACE_LIMIT
from jaxsph.stable_step import largest_stable as limit_of

FACTORS = (0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.2, 1.4, 1.6)
STEPS = 16  # between two saves
GAIN = 0.01  # of the energy that can move: nothing puts any in, and the error of a stable step is below a thousandth


def layered(light: float, dtype) -> jaxsph.Scene:
    """A light fluid at rest on water; both have the same sound speed."""
    spacing, depth, g = 0.05, 0.2, 9.81
    water = jaxsph.Fluid(
        "water",
        box((0, 0), (0.4, depth), spacing, dtype=dtype),
        density=1000.0,
        sound_speed=20.0,
        pressure=lambda x: g * (light * depth + 1000 * (depth - x[:, 1])),
    )
    above = jaxsph.Fluid(
        "light",
        box((0, depth), (0.4, depth), spacing, dtype=dtype),
        density=light,
        sound_speed=20.0,
        pressure=lambda x: light * g * (2 * depth - x[:, 1]),
    )
    walls = jaxsph.Wall("tank", tank((0, 0), (0.4, 0.5), spacing, 4, dtype=dtype))
    return jaxsph.Scene(water, above, walls, gravity=(0.0, -g), effects=[jaxsph.DeltaDiffusion(0.1)])


def speed_of(scene) -> float:
    """c, the unit of time is h over it [m/s]."""
    water = scene["water"]
    lightest = min(float(fluid.density) for fluid in scene.fluids)
    return float(water.sound_speed) * max(1.0, np.sqrt(float(water.density) / lightest) / INTERFACE_LIMIT)


def scenes(dtype) -> dict:
    """By name a scene, how long it runs [s], the energy that can move [J/m], and the first factor that is tried."""
    vortex = jaxsph.scenes.taylor_green(24, dtype=dtype)
    dam, falls = jaxsph.scenes.dam_break(16, dtype=dtype), (0.8, 1000 * 9.81 * 1.2 * 0.6**2 / 2)
    still = jaxsph.scenes.still_water(16, dtype=dtype)
    # nothing that could damp an instability
    bare = jaxsph.scenes.oscillating_drop(12, frequency=0.0, rate=1.0, effects=[], dtype=dtype)
    square = jaxsph.scenes.rotating_square(40, dtype=dtype)  # its arms are under tension

    turned = 0.4, 1000 * 9.81 * 0.4 * 0.2 * 0.2  # if both changed places; at any step the interface frees .9 % of it

    def damped(alpha):
        return replace(square, effects=(*square.effects, jaxsph.AcousticDamper(alpha)))

    def rubbed(alpha):
        return replace(dam, effects=(jaxsph.DeltaDiffusion(0.1), jaxsph.ArtificialViscosity(alpha)))

    return {
        "Taylor-Green vortex": (vortex, 0.5, 0.25, 0.1),
        "dam break": (dam, *falls, 0.1),
        "still water": (still, 1.0, 1000 * 9.81 * 0.9**2 / 2 * 0.01, 0.1),
        "stretching drop, no effects": (bare, 1.0, 1000 * np.pi / 4, 0.1),
        "rotating square, 40 x 40, to w t = 4": (square, 4.0, 1000 / 12, 0.8),
        "rotating square, AcousticDamper(.5)": (damped(0.5), 4.0, 1000 / 12, 0.4),
        "rotating square, AcousticDamper(1)": (damped(1.0), 4.0, 1000 / 12, 0.2),
        "dam break, ArtificialViscosity(1)": (rubbed(1.0), *falls, 0.4),
        "dam break, ArtificialViscosity(4)": (rubbed(4.0), *falls, 0.1),
        "fluid of 1/30 of the density on water": (layered(1000 / 30, dtype), *turned, 0.4),
        "fluid of 1/100 of the density on water": (layered(10.0, dtype), *turned, 0.4),
    }


def gained(scene, t_end: float, size: float, factor: float) -> float:
    """The largest gain of energy over the start, in units of size, with steps of factor h / c; inf if it blew up."""
    time_step = factor * float(scene.smoothing_length) / speed_of(scene)
    every = STEPS * time_step
    saves = int(np.ceil(t_end / every))
    # as many steps between builds whatever their size: enough for a tenth of the sound speed at the largest
    fastest = 0.1 * speed_of(scene) * max(FACTORS) / factor
    measure = jax.jit(jax.vmap(lambda scene, s: jaxsph.observe.energies(scene, s)["total"], (None, 0)))
    try:
        run = jaxsph.simulate(scene, saves * every, every, time_step=time_step * (1 + 1e-6), max_speed=fastest)
    except jaxsph.SimulationError:
        return float("inf")
    total = np.asarray(measure(scene, run.states), float)
    return float(np.max(total - total[0])) / size


def largest_stable(quick: bool) -> Iterator[list[Row]]:
    """The largest factor up to which no energy is gained, and the limit that `simulate` keeps over it."""
    dtype = np.float64
    for name, (scene, t_end, size, first) in list(scenes(dtype).items())[: 1 if quick else None]:
        stable = 0.0
        limit = limit_of(scene, jaxsph.topologies(scene)) * speed_of(scene) / float(scene.smoothing_length)
        for factor in (factor for factor in FACTORS if factor >= first):
            with any_step():
                gain = gained(scene, t_end, size, factor)
            print(f"  {name}: dt = {factor:.2g} h / c gains {gain:+.2%}", flush=True)
            if not gain < GAIN:
                break
            stable = factor
        yield [
            Row("largest stable c dt / h", stable, None, name, precision(dtype)),
            Row("limit of simulate / largest stable", limit / stable, 1.0, name, precision(dtype)),
        ]


CASES = [Case("F35", "Time step of a fluid", largest_stable)]
