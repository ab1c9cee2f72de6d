"""What it saves to go through several slots of a list in a turn: steps of a dam break, on lists as they are."""

from __future__ import annotations

from collections.abc import Iterator
from unittest import mock

import jax
import jax.numpy as jnp
from measure import compiled, interleaved, row

import jaxsph
from jaxsph import slots
from jaxsph.advance import begin_compiled, lists_of

STEPS = 10
FALLEN = 0.1  # s: the water has left its lattice


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """Rows of one size after the other."""
    for particles in (45,) if quick else (45, 56, 63):
        yield [saving(particles, precision)]


def saving(particles: int, precision: str) -> dict:
    """Time of a step with one slot in a turn over that with `slots.UNROLL`."""
    scene = jaxsph.scenes.dam_break(particles, dtype=precision)
    state = jaxsph.simulate(scene, FALLEN).final
    found = jaxsph.topologies(scene, state)
    references, columns, _ = begin_compiled(scene, found, state)
    lists, _ = lists_of(scene, references, columns, found, state.time)
    integrator, time_step = jaxsph.KickDriftKick(), jnp.asarray(0.0, precision)

    def steps_in_turns_of(several):
        def steps(columns, lists):
            def one(_, columns):
                return integrator.step(scene, references, columns, lists, state.time, time_step, forward_mode=False)

            with mock.patch.object(slots, "UNROLL", several):
                return jax.lax.fori_loop(0, STEPS, one, columns)

        return compiled(steps, columns, lists)

    timings = interleaved({several: steps_in_turns_of(several) for several in (1, slots.UNROLL)}, 10.0)
    for several, timing in timings.items():
        print(timing.line(f"H / dx = {particles}, {several} in a turn"), flush=True)
    counts = ", ".join(f"{s.n_particles:,} {s.name}" for s in scene.systems)
    value = timings[1].over(timings[slots.UNROLL])
    figure = f"a step with one slot in a turn / with {slots.UNROLL}"
    return row(f"turns.{particles}.{precision}", "dam break", figure, value, "times", counts, precision)
