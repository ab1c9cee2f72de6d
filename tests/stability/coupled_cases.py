"""H07, H11, H12, H17 to H19: plates that water strikes, stands on or bends; a channel of ten particles."""

from __future__ import annotations

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from rows import Case, Row, precision
from watch import of_structure, rows_of, structure_rows, watch

import jaxsph
from jaxsph.scenes.plate_parts import USUAL

HALF, DOUBLE = np.float32, np.float64
WIDTH, HEIGHT = 0.146, 0.292  # of the column that breaks [m]
FASTER = 2.0  # sound: the same pressure with a quarter of the density's change, that of an impact with half
POTENTIAL = 1000 * 9.81 * WIDTH * HEIGHT**2 / 2  # J/m


def struck(scene, where: tuple[str, str]) -> list[Row]:
    """A dam break against a plate, until water has struck it, bent it and gone over it: .6 s."""
    watched = watch(scene, 0.6, 60, of_structure(scene, "plate"))
    return rows_of(watched, where, energy=POTENTIAL) + structure_rows(watched, scene, "plate", where)


def thin(quick: bool) -> Iterator[list[Row]]:
    """Plates of two and three particles over the thickness, thinner than the water's support radius.

    As the scene comes, with sound twice as fast, and so without what keeps jets from sinking into walls.
    """
    kinds = [(across, dtype) for dtype in (HALF, DOUBLE) for across in (2, 3)]
    runs: list = [(*kind, speed, None) for speed in (1.0, FASTER) for kind in kinds] + [(3, HALF, FASTER, USUAL)]
    for across, dtype, faster, effects in runs[:1] if quick else runs:
        scene = with_sound(jaxsph.scenes.dam_break_plate(10, across, effects=effects, dtype=dtype), faster)
        named = named_sound(faster) + ("" if effects is None else ", without WallRepulsion")
        yield struck(scene, (f"{across} across{named}", precision(dtype)))


def with_sound(scene, faster: float):
    """The scene with a sound speed so many times its own."""
    return scene.replace({"water.sound_speed": faster * scene["water"].sound_speed})


def named_sound(faster: float) -> str:
    """How a row names `with_sound`."""
    return "" if faster == 1 else f", {faster:g} times the sound speed"


def ratios(quick: bool) -> Iterator[list[Row]]:
    """Plates as dense as water, ten times and a thousand times as dense.

    The modulus of the heavy ones grows with their density, or they would buckle under their own weight: the heaviest
    weighs 53 times what its modulus of before could carry (12 rho g l^3 / (E t^2) = 7.84).
    """
    kinds = [(1, HALF), (10, HALF), (1000, HALF), (1, DOUBLE)]
    runs = [(*kind, faster) for faster in (1.0, FASTER) for kind in kinds]
    for ratio, dtype, faster in runs[:1] if quick else runs:
        modulus = 1e6 * max(1.0, ratio / 2.5)  # at 2.5 it is the scene's own
        scene = jaxsph.scenes.dam_break_plate(10, 3, plate_density=1000.0 * ratio, youngs_modulus=modulus, dtype=dtype)
        named = f"3 across, {ratio} : 1{named_sound(faster)}"
        yield struck(with_sound(scene, faster), (named, precision(dtype)))


def channel(quick: bool) -> Iterator[list[Row]]:
    """Poiseuille flow of ten particles for ten h^2 / nu: long after it is steady."""
    height, viscosity, density, top = 1e-3, 1e-3, 1000.0, 1.25e-5
    for dtype in (HALF,) if quick else (HALF, DOUBLE):
        scene = jaxsph.scenes.poiseuille(10, height=height, dtype=dtype)
        watched = watch(scene, 10 * height**2 * density / viscosity, 20)
        where = ("10 across", precision(dtype))
        place, speed = (np.asarray(watched.run["water"][k][-1], float) for k in ("position", "velocity"))
        y = place[:, 1] / height
        error = np.max(np.abs(speed[:, 0] / top - 4 * y * (1 - y)))
        yield [
            *rows_of(watched, where, energy=None),
            Row("largest |u - exact| / u_max", float(error), None, *where),
            Row("largest |v| / u_max", float(np.max(np.abs(speed[:, 1])) / top), None, *where),
        ]


def stiff(quick: bool) -> Iterator[list[Row]]:
    """A stiff plate under two meters of water for half a second, with friction as the scene comes, and without."""

    def speed(state):
        return jnp.sqrt(jnp.mean(jnp.sum(state.systems["plate"]["velocity"] ** 2, axis=1)))

    for name, effects in (("", None),) if quick else (("", None), (", without friction", USUAL)):
        scene = jaxsph.scenes.water_column_on_plate(3, effects=effects, dtype=HALF)
        watched = watch(scene, 0.5, 200, {"speed": speed})
        where, speeds = (f"3 across{name}", precision(HALF)), watched.seen["speed"]
        late = np.asarray(watched.run.times) > 0.8 * float(watched.run.times[-1])
        rms = float(np.sqrt(np.mean(speeds[late] ** 2)))
        sunk = np.asarray(watched.run["water"]["position"])[:, :, 1] < -0.5 * scene.spacing
        yield [
            *rows_of(watched, where, energy=None),
            # the plate itself bends by a three hundredth of the spacing
            Row("particles half a spacing deep in the plate or below it, most", int(sunk.sum(1).max()), 0, *where),
            Row("rms speed of the plate in the last fifth [m/s]", rms, None, *where),
        ]


def fed(scene, name: str, t_end: float, saves: int, where: tuple[str, str]) -> list[Row]:
    """Whether water feeds the vibrations of a plate: how fast its particles are in the second half of a run."""

    def speed(state):
        return jnp.max(jnp.sum(state.systems[name]["velocity"] ** 2, axis=1)) ** 0.5

    watched = watch(scene, t_end, saves, {"speed": speed})
    times = np.asarray(watched.run.times)
    late = times >= min(0.5 * t_end, times[-1])  # of a run that broke before, its end
    fastest = float(np.max(watched.seen["speed"][late]))
    named = f"largest speed of the {name} from {0.5 * t_end:g} s on [m/s]".replace(" 0.", " .")
    return [*rows_of(watched, where, energy=None), Row(named, fastest, None, *where)]


def gate(quick: bool) -> Iterator[list[Row]]:
    """A rubber gate that water bends for .4 s, with internal friction as the scene comes, and without."""
    for name, effects in (("", None),) if quick else (("", None), (", without friction", USUAL)):
        particles = 10 if quick else 40
        scene = jaxsph.scenes.elastic_gate(particles, effects=effects, dtype=HALF)
        yield fed(scene, "gate", 0.4, 80, (f"{particles} over the width{name}", precision(HALF)))


def rubber(quick: bool) -> Iterator[list[Row]]:
    """Four millimeters of rubber in the way of water from behind a gate, with internal friction and without."""
    for name, effects in (("", None),) if quick else (("", None), (", without friction", USUAL)):
        spacing = 0.02 if quick else 0.01
        scene = jaxsph.scenes.dam_break_gate_plate(spacing, effects=effects, dtype=HALF)
        yield fed(scene, "plate", 0.6, 60, (f"spacing {spacing:g} m{name}", precision(HALF)))


CASES = [
    Case("H07", "Thin plate that a dam break strikes", thin),
    Case("H11", "Density of the plate : water", ratios),
    Case("H17", "Stiff plate under water, .5 s", stiff),
    Case("H18", "Rubber gate that water bends, .4 s", gate),
    Case("H19", "Thin rubber plate behind a gate, .6 s", rubber),
    Case("H12b", "Poiseuille flow with 10 particles across, to 10 h^2/nu", channel),
]
