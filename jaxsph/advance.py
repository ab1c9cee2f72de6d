"""From one state to another: what starts a run, many steps of it, and those of an error-controlled solver."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxsph import surroundings
from jaxsph.dynamics import accelerations, constrain, positions_of, prepare
from jaxsph.effects import AcousticDamper
from jaxsph.flow import density_rates, summed_deviations
from jaxsph.health import GAVE_UP, NOT_FINITE, all_finite
from jaxsph.integrate import noted
from jaxsph.pytree import replace
from jaxsph.state import State, to_columns, to_rows
from jaxsph.stepping import Steps, lists_of, repeated


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
    steps = Steps(scene, references, found, state, dt, integrator, forward_mode, rebuild_every, counted)
    health, block = state.health, None if forward_mode else block
    if scene.meets and reserve is not None:
        columns, health = steps.with_lists_when_due(columns, n_steps, reserve)
    elif scene.meets:
        block = None if block is None else max(1, block // rebuild_every)
        columns, health = repeated(steps.between_builds, (columns, health), n_steps // rebuild_every, block)
    else:
        columns = repeated(steps.checkpointed(steps.one), columns, n_steps, block)
    step = state.step + jnp.asarray(n_steps, jnp.int32)
    finite = all_finite(jax.lax.stop_gradient(columns))
    health = health.note(~finite, NOT_FINITE, step)
    return columns, replace(state.later(dt * n_steps), step=step, health=health)


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
