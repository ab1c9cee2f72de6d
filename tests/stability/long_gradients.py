"""H16: gradients through ten thousand steps: finite in all cases, and right where the motion is not chaotic."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from columns import gripped
from rows import Case, Row, precision
from surfaces_at_work import shaken
from tension import two_jets

import jaxsph
from inverse.jaxsph_simulation import topologies_of_runs
from jaxsph import scenes as ready

HALF, DOUBLE = np.float32, np.float64
STEPS = 10_000


@dataclass(frozen=True)
class Long:
    """A scene, the number by which to differentiate, what is observed at the end, and for how long it runs.

    Attributes:
        scene: of a precision.
        path: of the number.
        observe: scalar of a scene and its last state, smooth in the number.
        t_end: [s]; None takes ten thousand steps of the default size.
        max_speed: see `simulate`.
        chaotic: whether nearby runs part; then the gradient is a number of this run alone, and not compared.
    """

    scene: Callable[[Any], Any]
    path: str
    observe: Callable
    t_end: float | None = None
    max_speed: float | None = None
    chaotic: bool = False


def moved(name: str, scene, state):
    """Mean of the squared displacement of a structure [m^2]."""
    return jnp.mean(jnp.sum(state.systems[name]["displacement"] ** 2, axis=1))


def kinetic(scene, state):
    """Mean of half the squared speed of the water [m^2/s^2]."""
    return 0.5 * jnp.mean(jnp.sum(state.systems["water"]["velocity"] ** 2, axis=1))


def flux(scene, state):
    """Mean velocity along x [m/s]."""
    return jnp.mean(state.systems["water"]["velocity"][:, 0])


def compression(scene, state):
    """Mean deviation of the density [kg/m^3]: rho g H / (2 c^2) at rest."""
    return jnp.mean(state.systems["water"]["density_deviation"])


def spread(scene, state):
    """Mean of the squared places of the water [m^2]."""
    return jnp.mean(jnp.sum(state.systems["water"]["position"] ** 2, axis=1))


LONG: dict[str, Long] = {
    "CSM3, 3 across": Long(
        lambda kind: ready.turek_hron_beam(3, dtype=kind), "beam.youngs_modulus", partial(moved, "beam")
    ),
    "column, pulled": Long(
        lambda kind: gripped(4, kind, 3.0, 0.0), "column.poisson_ratio", partial(moved, "column"), 1.5
    ),
    "Poiseuille, 10 across": Long(lambda kind: ready.poiseuille(10, dtype=kind), "water.viscosity", flux),
    "still water, 8": Long(lambda kind: ready.still_water(8, dtype=kind), "water.sound_speed", compression),
    "Taylor-Green, Re 1000, 12 x 12": Long(
        lambda kind: ready.taylor_green(12, reynolds=1000.0, dtype=kind), "water.viscosity", kinetic, 10.0
    ),
    "rotating square, 10 x 10": Long(
        lambda kind: ready.rotating_square(10, dtype=kind), "water.sound_speed", spread, 4.0, 3.0
    ),
    "jets, 4 across": Long(lambda kind: two_jets(4, kind), "water.sound_speed", spread, 1.5, 5.0),
    "sloshing, 6 over the depth": Long(
        lambda kind: shaken(6, kind)[0], "water.sound_speed", kinetic, 10.0, 8.0, chaotic=True
    ),
    "dam break, H / dx = 6": Long(
        lambda kind: ready.dam_break(6, dtype=kind), "water.sound_speed", kinetic, 20 * float(np.sqrt(0.6 / 9.81)), 8.0,
        chaotic=True,
    ),
    "dam break on a plate, 2 across": Long(
        lambda kind: ready.dam_break_plate(6, 2, dtype=kind), "plate.youngs_modulus", partial(moved, "plate"), 0.6, 6.0,
        chaotic=True,
    ),
}  # fmt: skip


def of_number(case: Long, dtype) -> tuple[Callable, float]:
    """The observation as a function of the number, and the number."""
    scene = case.scene(dtype)
    step = jaxsph.stable_time_step(scene) * 0.9  # room for the number to be moved a little
    step = step if case.t_end is None else min(step, case.t_end / STEPS)
    options: dict[str, Any] = {"time_step": step * (1 + 1e-5)}
    if scene.fluids and scene.structures:
        options["integrator"] = jaxsph.KickDriftKick(jaxsph.stable_substeps(scene, step))
    found = jaxsph.topologies(scene)
    if scene.meets:  # a traced run cannot enlarge its lists: room for the most of a plain one
        options["max_speed"] = case.max_speed or 0.1 * float(scene["water"].sound_speed)
        plain = jaxsph.simulate(scene, STEPS * step, STEPS * step / 20, **options)
        found = topologies_of_runs([plain])
    options["topologies_of_scene"] = found

    def observed(number):
        changed = scene.replace({case.path: number})
        run = jaxsph.simulate(changed, STEPS * step, **options)
        return case.observe(changed, run.final)

    return observed, float(np.asarray(scene.get(case.path)))


def gradients(quick: bool) -> Iterator[list[Row]]:
    """Reverse mode; in float64 beside central differences where the motion is not chaotic."""
    runs = [(name, DOUBLE) for name in LONG] + [(name, HALF) for name in LONG]
    for name, dtype in runs[:1] if quick else runs:
        case = LONG[name]
        observed, number = of_number(case, dtype)
        value, slope = jax.value_and_grad(observed)(jnp.asarray(number, dtype))
        value, slope = float(value), float(slope) * number
        where = (name, precision(dtype))
        print(f"  {name}: {value:.6g}, its logarithmic slope {slope / value:+.6g}", flush=True)
        rows = [Row("gradient through 1e4 steps is not finite", float(not np.isfinite(slope)), 0.0, *where)]
        if dtype is DOUBLE and not case.chaotic:
            errors, compiled = [], jax.jit(observed)
            for size in (1e-4, 1e-6):
                ends = [float(compiled(jnp.asarray(number * (1 + sign * size), dtype))) for sign in (1, -1)]
                errors.append(abs(slope / ((ends[0] - ends[1]) / (2 * size)) - 1))
                print(f"    differs from a central difference of {size:g} by {errors[-1]:.3g}", flush=True)
            rows.append(Row("|gradient / central difference - 1|, the better of two", min(errors), 1e-3, *where))
        yield rows


CASES = [Case("H16", "Gradient through 10,000 steps", gradients)]
