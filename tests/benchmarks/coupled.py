"""What the structure costs in a coupled step, and what a stiffer one adds.

The dam breaks of the scenes, once the water has reached the plate, beside their plates alone with as many small steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import jax
import numpy as np
from measure import interleaved, row

import jaxsph
from jaxsph.effects import Damping, KelvinVoigt, PenaltyForce

STEPS = 32
STIFF = 1e8  # Pa, beside the 3.5e6 Pa of the experiment


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """Rows of the plate that DualSPHysics was timed with at two moduli, and of the softer one without a gate."""
    spacing, moment = (0.02, 0.01) if quick else (0.01, 0.35)

    def behind_gate(modulus):
        return jaxsph.scenes.dam_break_gate_plate(spacing, youngs_modulus=modulus, dtype=precision)

    yield shares("dam break with gate on a plate", {3.5e6: behind_gate(3.5e6), STIFF: behind_gate(STIFF)}, moment)
    if not quick:
        yield shares("dam break on a plate", {1e6: jaxsph.scenes.dam_break_plate(15, dtype=precision)}, 0.2)


def shares(case: str, scenes: dict[float, jaxsph.Scene], moment: float) -> list[dict]:
    """By modulus of the plate the steps in a step and the structure's share, and how much longer a stiff one takes."""
    calls, counts = {}, {}
    for modulus, scene in scenes.items():
        step = jaxsph.stable_time_step(scene)
        counts[modulus] = jaxsph.stable_substeps(scene, step)["plate"]
        alone = jaxsph.Scene(
            scene["plate"],
            gravity=scene.gravity,
            effects=[e for e in scene.effects if isinstance(e, (PenaltyForce, KelvinVoigt, Damping))],
        )
        state = jaxsph.simulate(scene, moment).final
        calls[modulus, "coupled"] = timed(scene, step, STEPS, state)
        calls[modulus, "alone"] = timed(alone, step / counts[modulus], STEPS * counts[modulus])
    timings = interleaved(calls, 30.0)
    made, first = [], min(scenes)
    for modulus, scene in scenes.items():
        coupled, alone = timings[modulus, "coupled"], timings[modulus, "alone"]
        particles = ", ".join(f"{system.n_particles:,} {system.name}" for system in scene.systems)
        precision = np.dtype(scene.dtype).name
        about = (case, f"E = {modulus / 1e6:g} MPa, {particles}")

        def of(figure, value, unit, timing=None, about=about, modulus=modulus, precision=precision):
            identity = f"coupled.{about[0].replace(' ', '_')}.{modulus / 1e6:g}.{precision}"
            return row(identity, about[0], figure, value, unit, about[1], precision, timing=timing)

        made += [
            of("time of a step of the fluid", coupled.seconds / STEPS * 1e3, "ms", coupled),
            of("steps of the structure in it", float(counts[modulus]), "steps"),
            of("structure's share of the step", alone.over(coupled), "share"),
        ]
        if modulus != first:
            longer = coupled.over(timings[first, "coupled"])
            made.append(of(f"time over that at {first / 1e6:g} MPa", longer, "times"))
    return made


def timed(scene: jaxsph.Scene, step: float, steps: int, state=None) -> tuple[Callable[[], None], float]:
    """A run of some steps from a state on, and the seconds of its first call, which compiles it."""
    found = jaxsph.topologies(scene, state)

    def run():
        out = jaxsph.simulate(scene, steps * step * (1 - 1e-6), state=state, time_step=step, topologies_of_scene=found)
        jax.block_until_ready(out.final.systems["plate"]["displacement"])

    begin = time.perf_counter()
    run()
    return run, time.perf_counter() - begin
