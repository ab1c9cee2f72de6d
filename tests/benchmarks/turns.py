"""What the loop over pairs does to be fast: steps of a dam break as it is, and without, on lists as they are.

Several slots of a list go through in a turn, sums are carried side by side in wide numbers, and what belongs to one of
these is calculated apart from the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from unittest import mock

import jax
import jax.numpy as jnp
from measure import compiled, interleaved, row, steps_of

import jaxsph
from jaxsph import plain_run, slots
from jaxsph.advance import advance, begin_compiled
from jaxsph.side_by_side import SideBySide
from jaxsph.stepping import lists_of

STEPS, STEPS_OF_RUN = 10, 300
FALLEN = 0.1  # s: the water has left its lattice


class EachAlone(SideBySide):
    """Every sum in an array of its own."""

    def __init__(self, dtypes, *, differentiable: bool):
        super().__init__(dtypes, differentiable=differentiable)
        self.groups, self.passes = [[place] for place in range(len(dtypes))], [range(len(dtypes))]


class Sharing(SideBySide):
    """Wide numbers that are calculated together."""

    def __init__(self, dtypes, *, differentiable: bool):
        super().__init__(dtypes, differentiable=differentiable)
        self.passes = [range(len(dtypes))]


WAYS = {
    "as it is": nullcontext,
    "one slot in a turn": lambda: mock.patch.multiple(slots, UNROLL=1, UNROLL_NARROW=1),
    "every sum in an array of its own": lambda: mock.patch.object(slots, "SideBySide", EachAlone),
    "wide numbers calculated together": lambda: mock.patch.object(slots, "SideBySide", Sharing),
}
NARROW_WAYS = {
    "as it is": nullcontext,
    "four slots in a turn": lambda: mock.patch.object(slots, "UNROLL_NARROW", slots.UNROLL),
}
"""Of lists of few neighbors, which do eight slots in a turn."""

FEW_WAYS = {
    "as it is": nullcontext,
    "no slots abreast": lambda: mock.patch.object(slots, "ABREAST", {}),
}
"""Of few particles in float32."""


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """Rows of one size after the other."""
    for particles in (45,) if quick else (45, 71, 158):
        yield savings(jaxsph.scenes.dam_break(particles, dtype=precision), f"{particles}", precision)
    plain = [jaxsph.ArtificialViscosity(0.1)]
    scene = jaxsph.scenes.dam_break(45 if quick else 71, effects=plain, smoothing=1.3, dtype=precision)
    yield savings(scene, "narrow", precision, "dam break, few neighbors, no diffusion", NARROW_WAYS)
    if precision == "float32":
        for particles in (16, 25):
            cavity = jaxsph.scenes.lid_driven_cavity(particles, dtype=precision)
            yield savings_of_runs(cavity, f"cavity{particles}", precision, "cavity", FEW_WAYS)
    if not quick:
        scene = jaxsph.scenes.dam_break(32, depth=0.6, smoothing=1.3, dtype=precision)
        yield savings(scene, "32.3d", precision, "dam break, 3D")


def savings_of_runs(scene, size: str, precision: str, case: str, ways) -> list[dict]:
    """Time of a run of some steps in each other way over that of one as it is, lists built in it when they are due."""
    found = jaxsph.topologies(scene)
    time_step = jaxsph.stable_time_step(scene, found)

    def run_in(way):
        # a function of its own, so that what the other way has compiled is not taken for this one
        own = jax.jit(lambda *arguments, **options: advance(*arguments, **options), static_argnames=("forward_mode",))

        def call(run):
            with mock.patch.object(plain_run, "advance_compiled", own):
                return run()

        with way():
            run, seconds = call(lambda: steps_of(scene, STEPS_OF_RUN, time_step, None, found))
        return lambda: call(run), seconds

    timings = interleaved({name: run_in(way) for name, way in ways.items()}, 20.0)
    return rows_of(timings, scene, size, precision, case, "a run")


def savings(scene, size: str, precision: str, case="dam break", ways=WAYS) -> list[dict]:
    """Time of a step in each other way over that of one as it is."""
    state = jaxsph.simulate(scene, FALLEN).final
    found = jaxsph.topologies(scene, state)
    references, columns, _ = begin_compiled(scene, found, state)
    lists, _ = lists_of(scene, references, columns, found, state.time)
    integrator, time_step = jaxsph.KickDriftKick(), jnp.asarray(0.0, precision)

    def steps_in(way):
        def steps(columns, lists):
            def one(_, columns):
                return integrator.step(scene, references, columns, lists, state.time, time_step, forward_mode=False)

            with way():
                return jax.lax.fori_loop(0, STEPS, one, columns)

        return compiled(steps, columns, lists)

    timings = interleaved({name: steps_in(way) for name, way in ways.items()}, 10.0)
    return rows_of(timings, scene, size, precision, case, "a step")


def rows_of(timings, scene, size: str, precision: str, case: str, timed: str) -> list[dict]:
    """How many times as long each other way takes as the first."""
    for name, timing in timings.items():
        print(timing.line(f"H / dx = {size}, {name}"), flush=True)
    counts = ", ".join(f"{s.n_particles:,} {s.name}" for s in scene.systems)
    usual, *others = timings
    return [
        row(
            f"turns.{number}.{size}.{precision}",
            case,
            f"{timed} with {name} / as it is",
            timings[name].over(timings[usual]),
            "times",
            counts,
            precision,
        )
        for number, name in enumerate(others)
    ]
