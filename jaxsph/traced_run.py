"""A run under a transformation: one pure function, with checkpoints for reverse mode."""

from __future__ import annotations

import math
from functools import partial

import jax
import jax.numpy as jnp

from jaxsph import surroundings
from jaxsph.advance import advance, begin, solve, with_rows
from jaxsph.error_control import Diffrax
from jaxsph.health import CURES, GOOD, OUTGROWN, UNSTABLE
from jaxsph.pytree import replace
from jaxsph.stable_step import largest_stable_time_step
from jaxsph.state import State


@partial(jax.jit, static_argnames=("n_saves", "n_steps", "forward_mode", "memory_budget", "rebuild_every"))
def run_traced(
    scene, found, state, time_step, *, n_saves, n_steps, integrator, forward_mode, memory_budget, rebuild_every
):
    # Lists that are too small here are so in the first steps too, which say so.
    references, columns, _ = begin(scene, found, state, forward_mode=forward_mode)
    first = with_rows(state, columns, found)
    if isinstance(integrator, Diffrax):
        return first, solve(
            scene, references, columns, state, found, time_step, n_saves, n_steps, integrator, forward_mode
        )
    limit = largest_stable_time_step(*jax.lax.stop_gradient((scene, references)), integrator.substeps)
    dt = jnp.asarray(time_step, scene.dtype)
    health = state.health.note(dt > limit, UNSTABLE, state.step, dt, limit)
    for structure in scene.structures:
        health = health.note(~found[structure.name].suffices(structure), OUTGROWN, state.step)
    state = replace(state, health=health)
    steps, kept = n_saves * n_steps, 2 * sum(leaf.nbytes for leaf in jax.tree.leaves(columns))
    if scene.meets:
        lists = [found[f"{a}-{b}"] for a, b in surroundings.pairs_of(scene)]
        kept += sum(leaf.nbytes for leaf in jax.tree.leaves(lists)) // rebuild_every
    block = None
    if steps * kept > memory_budget:
        block = min(n_steps, max(1, round(math.sqrt(steps))))

    def to_next_save(carry, _):
        columns, state = carry
        columns, state = advance(
            scene, references, columns, found, state, time_step, n_steps, integrator, forward_mode, rebuild_every, block
        )
        return (columns, state), with_rows(state, columns, found)

    start = (columns, replace(state, systems={}))
    _, states = jax.lax.scan(to_next_save, start, length=n_saves)
    return first, states


def raise_in_traced(states: State) -> State:
    """Let a failed run raise when its values are used, also through jax.grad."""
    import equinox

    reason = jax.lax.stop_gradient(jnp.max(states.health.reason))
    messages = [CURES[key] for key in sorted(CURES)]
    systems = equinox.branched_error_if(states.systems, reason != GOOD, jnp.maximum(reason - 1, 0), messages)
    return replace(states, systems=systems)
