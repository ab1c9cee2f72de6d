"""Many steps from a state: what starts them, the loop over them, and the loop of an error-controlled solver."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxsph import surroundings
from jaxsph.dynamics import accelerations, constrain, place_boundaries, positions_of, prepare, velocities_of
from jaxsph.effects import AcousticDamper, ShepardFilter
from jaxsph.flow import density_rates, filtered, summed_deviations
from jaxsph.health import GAVE_UP, NOT_FINITE, all_finite
from jaxsph.integrate import noted
from jaxsph.pytree import replace
from jaxsph.state import State, to_columns, to_rows

PAUSE, LONGEST_PAUSE = 0.8, 8
"""After which share of the steps that neighbor lists are thought to hold to look at them again, and after how many at
most: a wave that breaks changes velocities fast."""


def ready(scene, found, state):
    """References and columns of a state, as it is."""
    references = prepare(scene, found)
    return references, constrain(scene, references, to_columns(state.systems, found), state.time)


ready_compiled = jax.jit(ready)


def begin(scene, found, state, forward_mode=False):
    """References, columns with the forces filled in, and whether the neighbor lists were too small for them."""
    references, columns = ready(scene, found, state)
    lists, placed = lists_of(scene, references, columns, found, state.time)
    now = dict(columns)
    if scene.fluids:  # densities that are sums, and rates that the forces read, are those of this moment
        sums = summed_deviations(scene, references, columns, placed, lists, forward_mode=forward_mode)
        now |= {name: {**columns[name], "density_deviation": deviation} for name, deviation in sums.items()}
        if scene.effect(AcousticDamper) is not None:
            rates = density_rates(scene, references, now, placed, lists, forward_mode=forward_mode)
            now = noted(scene, now, rates)
    fresh = accelerations(scene, references, now, state.time, lists, placed, forward_mode=forward_mode)
    # A state that has been stepped brings the acceleration of its last step: continuing it is exact.
    for name, found_now in fresh.items():
        kept = {k: jnp.where(state.step == 0, new, columns[name][k]) for k, new in found_now.items()}
        columns[name] = {**columns[name], **kept}
    overflows = [neighbors.did_buffer_overflow for neighbors in (lists or {}).values()]
    return references, columns, jnp.any(jnp.array(overflows, bool))


def lists_of(scene, references, columns, found, time):
    """Neighbor lists of the systems that meet, and walls where they are at a time."""
    if not scene.meets:
        return None, None
    placed = place_boundaries(scene, references, columns, time)
    return surroundings.rebuild(scene, found, positions_of(scene, columns, placed)), placed


begin_compiled = jax.jit(begin)


def advance(
    scene,
    references,
    columns,
    found,
    state,
    time_step,
    n_steps,
    integrator,
    forward_mode,
    rebuild_every=1,
    block=None,
    reserve=None,
):
    """n_steps steps from a state. In blocks of `block` steps, each recomputed in reverse mode.

    Where systems meet, neighbor lists are built every rebuild_every steps, of which n_steps and block are multiples.

    With a reserve each of them is built when it is due instead: when particles could come closer than its skin allows
    in the next step, if they come closer `reserve` times as fast as their velocities now say. The number of steps may
    be traced then: one program serves runs of any length, and has no reverse mode.
    """
    counted = isinstance(n_steps, int)
    dt = jnp.asarray(time_step, scene.dtype)
    shepard = scene.effect(ShepardFilter)

    def time_of(number):
        return state.time + number.astype(scene.dtype) * dt

    def one_step(carry, number, lists=None):
        return integrator.step(scene, references, carry, lists, time_of(number), dt, forward_mode=forward_mode)

    def checkpointed(function):
        if forward_mode or not counted:
            return function
        # Not of the many small steps of structures beside fluids.
        names = () if scene.fluids else ("displacement_gradient",)
        keep = jax.checkpoint_policies.save_only_these_names(*names)
        return jax.checkpoint(function, policy=keep, prevent_cse=False)

    def filtered_when_due(columns, lists, number):
        if shepard is None:
            return columns
        apply_filter = lambda now: filtered(scene, references, now, lists, forward_mode=forward_mode)  # noqa: E731
        return jax.lax.cond(filter_due(number), apply_filter, dict, columns)

    def filter_due(number):
        """At the first multiple of rebuild_every steps at or after one of the filter's."""
        return (number % rebuild_every == 0) & shepard.due(state.step + number, rebuild_every)

    def wrapped(columns):
        """Columns with the positions of fluids within the periodic domain."""
        if scene.domain is not None:
            for fluid in scene.fluids:
                fields = columns[fluid.name]
                columns = {**columns, fluid.name: {**fields, "position": scene.domain.wrap(fields["position"])}}
        return columns

    def built(columns, number):
        """Columns before a number of steps, and lists that are new."""
        columns = wrapped(columns)
        lists, _ = lists_of(scene, references, columns, found, time_of(number))
        assert lists is not None  # this is for scenes in which systems meet
        return filtered_when_due(columns, lists, number), lists

    def note(health, columns, lists, number):
        placed = place_boundaries(scene, references, columns, time_of(number))
        return surroundings.note(scene, health, lists, positions_of(scene, columns, placed), state.step + number)

    def between_builds(carry, build):
        columns, health = carry
        first = build * rebuild_every
        columns, lists = built(columns, first)
        step = checkpointed(lambda carry, number, lists: one_step(carry, number, lists))
        columns = _repeated(lambda carry, number: step(carry, first + number, lists), columns, rebuild_every)
        return columns, note(health, columns, lists, first + rebuild_every)

    def until_next_look(carry):
        """Lists that are due built anew, some steps, and a look at how long the lists will hold."""
        columns, lists, (due, pause), health, number = carry
        columns, lists = wrapped(columns), dict(lists)
        positions = positions_of(scene, columns, place_boundaries(scene, references, columns, time_of(number)))
        for pair in surroundings.pairs_of(scene):
            name = "-".join(pair)
            build = lambda _, pair=pair: surroundings.rebuild(scene, found, positions, [pair])  # noqa: E731
            lists |= jax.lax.cond(due[name], build, dict, {name: lists[name]})
        columns, last = filtered_when_due(columns, lists, number), jnp.minimum(number + pause, n_steps)

        def once(carry):
            columns, number, _ = carry
            columns, number = one_step(columns, number, lists), number + 1
            enough = number >= last
            return columns, number, enough if shepard is None else enough | filter_due(number)

        columns, number, _ = jax.lax.while_loop(lambda carry: ~carry[2], once, (columns, number, jnp.bool_(False)))
        health, plan = look(health, columns, lists, number)
        return columns, lists, plan, health, number

    def look(health, columns, lists, number):
        """What is wrong with the lists, which of them are due, and for how many steps not to look again."""
        placed = place_boundaries(scene, references, columns, time_of(number))
        positions = positions_of(scene, columns, placed)
        steps = {name: dt * velocity for name, velocity in velocities_of(scene, columns, placed).items()}
        left = surroundings.steps_left(lists, positions, steps, reserve)
        health = surroundings.note(scene, health, lists, positions, state.step + number, left)
        due = {name: ~(lasts.steps >= 1) for name, lasts in left.items()}
        # Who has just come near others belongs to other regions once lists are new: then one step, and another look.
        shortest = jnp.min(jnp.stack([lasts.steps for lasts in left.values()]))
        pause = jnp.clip(jnp.where(shortest >= 1, shortest * PAUSE, 1), 1, LONGEST_PAUSE).astype(jnp.int32)
        return health, (due, pause)

    health = state.health
    block = None if forward_mode else block
    if scene.meets and reserve is not None:
        lists = {"-".join(pair): found["-".join(pair)] for pair in surroundings.pairs_of(scene)}  # still empty
        plan = dict.fromkeys(lists, jnp.bool_(True)), jnp.int32(1)
        carry = (columns, lists, plan, health, jnp.int32(0))
        columns, _, _, health, _ = jax.lax.while_loop(lambda carry: carry[4] < n_steps, until_next_look, carry)
    elif scene.meets:
        block = None if block is None else max(1, block // rebuild_every)
        columns, health = _repeated(between_builds, (columns, health), n_steps // rebuild_every, block)
    else:
        columns = _repeated(checkpointed(one_step), columns, n_steps, block)
    step = state.step + jnp.asarray(n_steps, jnp.int32)
    finite = all_finite(jax.lax.stop_gradient(columns))
    health = health.note(~finite, NOT_FINITE, step)
    return columns, replace(state.later(dt * n_steps), step=step, health=health)


def _repeated(once, carry, n, block=None):
    """What n times carry = once(carry, number) gives; n may be traced.

    In blocks of which only the start is kept for reverse mode, if a block's length is given.
    """
    if not isinstance(n, int):
        return jax.lax.fori_loop(jnp.int32(0), n, lambda number, carry: once(carry, number), carry)

    def several(carry, numbers):
        return jax.lax.scan(lambda carry, number: (once(carry, number), None), carry, numbers)

    numbers = jnp.arange(n, dtype=jnp.int32)
    if block is None:
        return several(carry, numbers)[0]
    whole = n // block * block
    run_block = jax.checkpoint(several, prevent_cse=False)
    carry, _ = jax.lax.scan(run_block, carry, numbers[:whole].reshape(-1, block))
    if whole < n:
        carry, _ = run_block(carry, numbers[whole:])
    return carry


advance_compiled = jax.jit(advance, static_argnames=("forward_mode",))


def with_rows(state, columns, found):
    return replace(state, systems=to_rows(columns, found))


def solve(
    scene, references, columns, state, found, time_step, n_saves, n_steps, integrator, forward_mode, rebuild_every=1
):
    dt = jnp.asarray(time_step, scene.dtype)
    times = state.time + dt * n_steps * jnp.arange(1, n_saves + 1, dtype=scene.dtype)
    saved, reached, steps = integrator.solve(
        scene, references, columns, found, state.time, times, dt, forward_mode=forward_mode
    )
    step = state.step + jnp.asarray(steps, jnp.int32)

    def at_save(columns, time):
        finite = all_finite(jax.lax.stop_gradient(columns))  # a solver that gave up leaves infinities
        health = state.health.note(~finite & ~reached, GAVE_UP, step).note(~finite, NOT_FINITE, step)
        lists, placed = lists_of(scene, references, columns, found, time)
        if lists is not None:
            health = surroundings.note(scene, health, lists, positions_of(scene, columns, placed), step)
        remainder = None if state.time_remainder is None else jnp.zeros_like(state.time)
        return State(time, step, to_rows(columns, found), health, remainder)

    return jax.vmap(at_save)(saved, times)


solve_compiled = jax.jit(solve, static_argnames=("n_saves", "n_steps", "forward_mode", "rebuild_every"))
