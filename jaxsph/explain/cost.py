"""What each effect of a scene costs in a step: measured, with and without it."""

from __future__ import annotations

import time
from dataclasses import dataclass

from jaxsph.dynamics import topologies
from jaxsph.errors import SimulationError
from jaxsph.pytree import replace
from jaxsph.scene import Scene
from jaxsph.simulate import simulate
from jaxsph.stable_step import stable_time_step

STEPS, LONG, ROUNDS = 16, 4, 3
"""Steps of a short run, how many times longer the long one is, and how often both are timed."""


@dataclass(frozen=True)
class Cost:
    """Time of a step with all effects and without one [s]; None if the run without it failed."""

    effect: str
    with_it: float
    without: float | None

    @property
    def share(self) -> float | None:
        """Of a step; negative where a step without the effect takes longer."""
        return None if self.without is None else 1 - self.without / self.with_it

    def __str__(self) -> str:
        if self.without is None:
            return f"{self.effect}: does not run without it"
        saved = 1e3 * (self.with_it - self.without)
        return f"{self.effect}: {saved:.2g} of {1e3 * self.with_it:.3g} ms a step, {100 * (self.share or 0):.0f} %"


def variants(scene: Scene) -> dict[str, Scene]:
    """By what is left out the scene without it: every effect, viscosity, no slip, motions of walls."""
    found = {}
    for kind in dict.fromkeys(type(effect) for effect in scene.effects):
        rest = tuple(effect for effect in scene.effects if type(effect) is not kind)
        found[kind.__name__] = replace(scene, effects=rest)
    if any(fluid.viscosity is not None for fluid in scene.fluids):
        thin = {fluid.name: replace(fluid, viscosity=None) for fluid in scene.fluids}
        found["viscosity"] = with_systems(scene, thin)
        if any(wall.no_slip for wall in scene.walls):
            found["no slip"] = with_systems(scene, {wall.name: replace(wall, no_slip=False) for wall in scene.walls})
    if any(wall.motion is not None for wall in scene.walls):
        found["motion of walls"] = with_systems(scene, {wall.name: replace(wall, motion=None) for wall in scene.walls})
    return found


def with_systems(scene: Scene, changed: dict) -> Scene:
    """A scene with other systems, by name."""
    return replace(scene, systems=tuple(changed.get(system.name, system) for system in scene.systems))


def measure(scene: Scene) -> list[Cost]:
    """Time a step of a scene with and without each effect.

    Each is compiled, then run with two lengths, whose difference holds nothing but steps, neighbor lists included. All
    take turns, so that a machine that is busy for a while slows all of them; the fastest of each counts.
    """
    step, found = stable_time_step(scene), topologies(scene)
    runs = {"all": scene, **variants(scene)}
    best: dict[str, list[float]] = {}
    for turn in range(ROUNDS + 1):
        for name, one in list(runs.items()):
            try:
                times = [_seconds(one, step, found, length) for length in (1, 1 + LONG)]
            except SimulationError:
                best.pop(name, None)
                runs.pop(name)
                continue
            if turn:  # the first one compiles
                best[name] = [min(old, new) for old, new in zip(best.get(name, times), times, strict=True)]
    per_step = {name: (long - short) / (LONG * STEPS) for name, (short, long) in best.items()}
    return [Cost(name, per_step["all"], per_step.get(name)) for name in variants(scene)]


def _seconds(scene, step, found, saves):
    start = time.perf_counter()
    # Runs of one length of interval share their program, however many intervals they have.
    simulate(scene, saves * STEPS * step, STEPS * step, time_step=step, topologies_of_scene=found)
    return time.perf_counter() - start
