"""What the structure costs in a coupled step, and what a stiffer one adds.

The dam breaks of the scenes, once the water has reached the plate, beside their plates alone with as many small steps.
"""

from __future__ import annotations

from collections.abc import Iterator

from measure import interleaved, row, steps_of

import jaxsph
from jaxsph.effects import Damping, KelvinVoigt, PenaltyForce

STEPS = 32
USUAL, STIFF = 3.5e6, 1e8  # Pa: the plate of the experiment, and one that is stiffer by a factor of 29
SOLID = (PenaltyForce, KelvinVoigt, Damping)


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """Rows of a plate behind a gate, at two moduli, and of the softer one without a gate."""
    spacing, moment = (0.02, 0.01) if quick else (0.01, 0.35)
    gates = {
        modulus: jaxsph.scenes.dam_break_gate_plate(spacing, youngs_modulus=modulus, dtype=precision)
        for modulus in (USUAL, STIFF)
    }
    yield shares("dam break with gate on a plate", gates, moment, precision)
    if not quick:
        plates = {1e6: jaxsph.scenes.dam_break_plate(15, dtype=precision)}
        yield shares("dam break on a plate", plates, 0.2, precision)


def shares(case: str, scenes: dict[float, jaxsph.Scene], moment: float, precision: str) -> list[dict]:
    """By modulus of the plate its steps in one of the water and their share, and how much longer a stiff one takes."""
    calls, counts = {}, {}
    for modulus, scene in scenes.items():
        step = jaxsph.stable_time_step(scene)
        counts[modulus] = count = jaxsph.stable_substeps(scene, step)["plate"]
        state = jaxsph.simulate(scene, moment).final
        calls[modulus, "coupled"] = steps_of(scene, STEPS, step, state, jaxsph.topologies(scene, state))
        effects = [effect for effect in scene.effects if isinstance(effect, SOLID)]
        alone = jaxsph.Scene(scene["plate"], gravity=scene.gravity, effects=effects)
        calls[modulus, "alone"] = steps_of(alone, STEPS * count, step / count, None, jaxsph.topologies(alone))
    timings = interleaved(calls, 30.0)
    softest, made = min(scenes), []
    for modulus, scene in scenes.items():
        coupled = timings[modulus, "coupled"]
        figures = {
            "time of a step of the water": (coupled.seconds / STEPS * 1e3, "ms"),
            "steps of the plate in it": (float(counts[modulus]), "steps"),
            "the plate's share of the step": (timings[modulus, "alone"].over(coupled), "share"),
            f"time over that at {softest / 1e6:g} MPa": (coupled.over(timings[softest, "coupled"]), "times"),
        }
        if modulus == softest:
            figures.popitem()
        particles = ", ".join(f"{system.n_particles:,} {system.name}" for system in scene.systems)
        where = f"E = {modulus / 1e6:g} MPa, {particles}"
        identity = f"coupled.{case.replace(' ', '_')}.{modulus / 1e6:g}.{precision}"
        for figure, (value, unit) in figures.items():
            made.append(row(identity, case, figure, value, unit, where, precision, timing=coupled))
    return made
