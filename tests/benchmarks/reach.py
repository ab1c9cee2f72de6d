"""What it saves that particles which an effect can't reach do not pay for it: those far from the other set of a list.

The same runs with lists that have a row for every particle, and with lists of the particles near the other set, as
`simulate` makes them. From the start of each scene, while most of its walls are dry, and when the water has spread.
"""

from __future__ import annotations

from collections.abc import Iterator

import jax
from measure import interleaved, row, steps_of

import jaxsph
from jaxsph import surroundings
from jaxsph.dynamics import place_boundaries, positions_of, prepare
from jaxsph.state import to_columns

STEPS, STEPS_OF_LARGE, LARGE = 256, 64, 50_000


def scenes(precision: str, quick: bool) -> dict:
    """By name the scene and how long it runs before the later measurement [s]; 0 for none."""
    particles = 20 if quick else 71
    found = {
        f"dam break, H / dx = {particles}": (jaxsph.scenes.dam_break(particles, dtype=precision), 1.0),
        "dam break on a plate, a / dx = 15": (jaxsph.scenes.dam_break_plate(15, dtype=precision), 0.3),
    }
    if not quick:
        large = jaxsph.scenes.dam_break(32, depth=0.6, smoothing=1.3, dtype=precision)
        found["dam break in 3D, H / dx = 32"] = large, 0.0
    return found


def rows(precision: str, quick: bool) -> Iterator[list[dict]]:
    """Rows of one scene after the other."""
    for name, (scene, later) in scenes(precision, quick).items():
        for moment in (0.0,) if quick or not later else (0.0, later):
            state = None if moment == 0 else jaxsph.simulate(scene, moment).final
            yield [saving(name, scene, moment, state, precision)]


def saving(name, scene, moment, state, precision) -> dict:
    found = jaxsph.topologies(scene, state)
    state = jaxsph.simulate(scene, jaxsph.stable_time_step(scene)).final if state is None else state
    everyone = {**found, **surroundings.allocate(scene, placed(scene, found, state), near_only=False)}
    calls, step = {}, jaxsph.stable_time_step(scene, found)
    steps = STEPS if scene.fluids[0].n_particles < LARGE else STEPS_OF_LARGE
    for which, lists in (("near", found), ("all", everyone)):
        calls[which] = steps_of(scene, steps, step, state, lists)
    timings = interleaved(calls, 20.0)
    for which, timing in timings.items():
        print(timing.line(f"{name}, t = {moment:g} s, {which}"), flush=True)
    value = 1 - 1 / timings["all"].over(timings["near"])
    counts = ", ".join(f"{s.n_particles:,} {s.name}" for s in scene.systems)
    identity = f"reach.{name.split(',')[0].replace(' ', '_')}.{moment:g}.{precision}"
    return row(
        identity, name, f"time saved by lists of near particles, t = {moment:g} s", value, "share", counts, precision
    )


def placed(scene, found, state) -> dict:
    """Positions (d, N) in cell order, as `topologies` has them."""
    references, columns = prepare(scene, found), to_columns(state.systems, found)
    positions = positions_of(scene, columns, place_boundaries(scene, references, columns, state.time))
    return jax.device_get(positions)
