"""The simulator that a Problem has by default: jaxsph, through its public names alone."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import jax
import numpy as np

from inverse.transforms import Transform

LOOKS = 5  # states of a run, spread evenly, in which neighbors are counted
ROOM = 1.4  # for more neighbors than those: other values of the unknowns, states in between
SPEED_MARGIN = 1.1
CORNERS_RUN_OF = 2  # unknowns: 4 runs


class JaxsphSimulation:
    """The default `simulate`: jaxsph.simulate to the last observation time, seen at the observation times.

    The time step is the smallest stable one over the corners of the bounds, so that it never depends on a
    traced value: a fit does not change its own discretization while it moves. Nor do the substeps of structures
    beside fluids, the most that any corner needs: no iterate goes unstable.

    With fluids or contact the starting values are run once with plain numbers, and so are the corners of the bounds of
    up to two unknowns, where they can be. From these runs come the room that neighbor lists get, because a lattice
    crowds when it breaks up, and a softer body lets water go elsewhere; and the top speed, which says how often lists
    are built. Neither changes a result: a run that needs more raises.
    """

    def __init__(
        self,
        scene: Any,
        replace: Callable[[Any, dict[str, Any]], Any],
        unknown: Mapping[str, Transform],
        times: np.ndarray,
        time_step: float | None = None,
        save_every: float | None = None,
    ) -> None:
        if times[-1] <= 0:
            raise ValueError(
                f"the last observation is at {times[-1]:g} s, before anything can happen; "
                "give observations at later times"
            )
        if time_step is None:
            import jaxsph

            steps = [float(jaxsph.stable_time_step(replace(scene, corner))) for corner in corners(unknown)]
            time_step = min(steps)
        self.time_step = time_step
        self.save_every = common_interval(times) if save_every is None else save_every
        self._options: dict[str, Any] = {}
        if getattr(scene, "meets", False):
            if scene.fluids and scene.structures:
                import jaxsph

                substeps = most_substeps([replace(scene, corner) for corner in corners(unknown)], time_step)
                self._options = {"integrator": jaxsph.KickDriftKick(substeps)}
            starts = {name: t.start[()] for name, t in unknown.items()}
            ends = corners(unknown) if len(unknown) <= CORNERS_RUN_OF else ()
            runs = self._rehearsals(replace, scene, [starts, *ends], times)
            expected = [max_speed_expected(replace(scene, corner)) for corner in corners(unknown)]
            self._options |= {
                "topologies_of_scene": topologies_of_runs(runs),
                "max_speed": max(*map(max_speed, runs), *expected),
            }

    def _rehearsals(self, replace, scene, values, times) -> list[Any]:
        """Runs with these values in turn; all but the first are left out where they fail."""
        import jaxsph

        runs = [self._run(replace(scene, values[0]), times)]
        for others in values[1:]:
            try:
                runs.append(self._run(replace(scene, others), times))
            except jaxsph.SimulationError:
                continue  # values at the end of their bounds may be too much for a scene, and need not be reached
        return runs

    def __call__(self, scene: Any, times: np.ndarray, mode: str):
        return self._run(scene, times, mode=mode).at(times)

    def _run(self, scene: Any, times: np.ndarray, **options: Any):
        import jaxsph

        intervals = max(1, int(np.ceil(times[-1] / self.save_every - 1e-9)))
        return jaxsph.simulate(
            scene,
            t_end=intervals * self.save_every,
            save_every=self.save_every,
            time_step=self.time_step,
            **self._options,
            **options,
        )


def topologies_of_runs(runs: list[Any]) -> dict[str, Any]:
    """Like `jaxsph.topologies`, with room for the neighbors that each pair of systems has in any state of the runs."""
    import jaxsph

    states = []
    for run in runs:
        last = len(run.times) - 1
        chosen = sorted({round(last * part / (LOOKS - 1)) for part in range(LOOKS)})
        states += [jax.tree.map(lambda leaf, i=i, run=run: leaf[i], run.states) for i in chosen]
    scene = runs[0].scene
    found = [jaxsph.topologies(scene, state, capacity_multiplier=ROOM) for state in states]
    roomy = dict(found[0])
    for name in roomy:
        sizes = np.array([_sizes(each[name]) for each in found])
        if sizes.size:
            # no state need have the most of everything: of the nearest to it, all sizes grow by what it lacks
            lacking = np.max(np.max(sizes, axis=0) / sizes, axis=1)
            best = int(np.argmin(lacking))
            roomy[name] = found[best][name]
            if lacking[best] > 1:
                more = jaxsph.topologies(scene, states[best], capacity_multiplier=ROOM * float(lacking[best]))
                roomy[name] = more[name]
    return roomy


def _sizes(topology: Any) -> list[int]:
    """Sizes of a neighbor list's arrays; none of other topologies, which are the same in all states."""
    both: list[Any] = [topology, getattr(topology, "transpose", None)]
    parts = [part for part in both if hasattr(part, "capacity")]
    return [
        max(1, size)
        for part in parts
        for size in (part.capacity.slots, part.capacity.range, part.capacity.members or 1)
    ]


def max_speed(run: Any) -> float:
    """Largest speed [m/s] of fluids, solids and walls in the saved states, and a tenth more for those between them."""
    squared = []
    for system in [*run.scene.fluids, *run.scene.solids, *run.scene.walls]:
        fields = run[system.name]
        if "velocity" in fields:
            # shifted particles move with that on top of their velocity
            moving = fields["velocity"] + fields.get("shift", 0.0)
            squared.append(np.max(np.sum(np.square(moving), axis=-1)))
    return SPEED_MARGIN * float(np.sqrt(max(squared)))


def most_substeps(scenes: list[Any], time_step: float) -> dict[str, int]:
    """By structure the most `jaxsph.stable_substeps` that any of the scenes needs for this time step [s]."""
    import jaxsph

    found = jaxsph.topologies(scenes[0])  # places are the same in all corners, so neighbors are
    counts = [jaxsph.stable_substeps(scene, time_step, found) for scene in scenes]
    return {name: max(count[name] for count in counts) for name in counts[0]}


def max_speed_expected(scene: Any) -> float:
    """A tenth of the sound speed [m/s], up to which a fluid counts as weakly compressible, and a tenth more."""
    return SPEED_MARGIN * max((0.1 * float(fluid.sound_speed) for fluid in scene.fluids), default=0.0)


def corners(unknown: Mapping[str, Transform]) -> Iterator[dict[str, Any]]:
    """Dictionaries of values at the corners of the bounds (all entries of an array at the same end)."""
    if len(unknown) > 8:  # 2^n corners: beyond that, one unknown at a time off both ends
        ends = [(0,) * len(unknown), (1,) * len(unknown)]
        ends += [tuple(int(i == j) ^ base for i in range(len(unknown))) for j in range(len(unknown)) for base in (0, 1)]
    else:
        ends = list(itertools.product((0, 1), repeat=len(unknown)))
    for end in ends:
        yield {name: (t.upper if upper else t.lower)[()] for (name, t), upper in zip(unknown.items(), end, strict=True)}


def common_interval(times: np.ndarray) -> float:
    """The longest saving interval [s] that hits all times; without one, one short enough to interpolate.

    Times written with few digits count as hit within 1e-3 of an interval.
    """
    marks = np.concatenate([[0.0], times[times > 0]])
    if len(marks) < 2:
        return 1.0
    shortest = float(np.min(np.diff(marks)))
    for divisor in range(1, 11):
        interval = shortest / divisor
        # the last mark sets the interval: it averages out the rounding of a short difference
        count = np.round(marks[-1] / interval)
        interval = marks[-1] / count
        offset = marks / interval
        if np.max(np.abs(offset - np.round(offset))) < 1e-3:
            return float(interval)
    # cubic Hermite interpolation between saved states; at least 400 of them, at most 4,000
    return float(np.clip(shortest, marks[-1] / 4000, marks[-1] / 400))
