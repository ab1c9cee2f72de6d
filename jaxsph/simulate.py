"""A run: many steps, in blocks, with checkpoints for reverse mode, progress, and files written as it goes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import checks, surroundings
from jaxsph.dynamics import (
    SAFETY,
    Order,
    accelerations,
    constrain,
    in_cell_order,
    largest_stable,
    largest_stable_time_step,
    place_boundaries,
    positions_of,
    prepare,
    safe,
    stable_substeps,
    topologies,
)
from jaxsph.effects import AcousticDamper, ShepardFilter
from jaxsph.errors import UnstableTimeStep
from jaxsph.flow import density_rates, filtered, summed_deviations
from jaxsph.health import (
    BEYOND_SKIN,
    CURES,
    GAVE_UP,
    GOOD,
    NOT_FINITE,
    OVERFLOW,
    UNSTABLE,
    all_finite,
    raise_if_failed,
)
from jaxsph.integrate import Diffrax, KickDriftKick, noted
from jaxsph.neighbors import safe_steps
from jaxsph.pytree import is_concrete, replace
from jaxsph.rigid_body import RigidBody
from jaxsph.state import State, check_state, initial_state, to_columns, to_rows
from jaxsph.trajectory import Trajectory

MEMORY_BUDGET = 2**28
"""Bytes that the states kept for reverse mode may take (256 MiB) before checkpoints go to two levels."""


def simulate(
    scene,
    t_end: float,
    save_every: float | None = None,
    *,
    state: State | None = None,
    time_step: float | None = None,
    integrator: KickDriftKick | Diffrax = KickDriftKick(),  # noqa: B008 (immutable)
    mode: str = "reverse",
    memory_budget: int = MEMORY_BUDGET,
    topologies_of_scene: dict | None = None,
    max_speed: float | None = None,
    progress: bool = False,
    out: str | Path | None = None,
) -> Trajectory:
    """Run a scene and return its trajectory, the start included.

    With plain numbers it advances from save to save, shows progress, and appends each state to `out`. Under
    `jit`, `grad`, `jvp` or `vmap` it is one pure function of the traced numbers in the scene and the state.

    Args:
        scene: what is in the world.
        t_end: time to simulate, counted from the start [s].
        save_every: interval of saved states [s]; None saves the end only. t_end must be a multiple of it.
        state: where to start, for example the `final` of another run or one read from a file; None is the
            scene's initial state. Continuing a run in steps of the same size gives the same bits.
        time_step: upper limit of the step [s]; the step taken divides save_every. None takes `stable_time_step`.
            Required if what determines it (moduli, density, positions) is traced.
        integrator: `KickDriftKick()` or `Diffrax(...)`.
        mode: "reverse" for `grad` (and `jvp`), "forward" if only `jvp` is asked for, which is then cheaper.
        memory_budget: bytes for the states that reverse mode keeps. Beyond it, states are kept for blocks of
            about sqrt(steps), and the memory grows like sqrt(steps).
        topologies_of_scene: from `topologies`, needed if positions are traced. With fluids it also decides how many
            neighbors there is room for under a transformation; a run with plain numbers makes more room by itself.
            Who continues a run many times passes the same each time, so that it is compiled once.
        max_speed: of fluids and walls [m/s], from which follows how often neighbor lists are built; None takes a tenth
            of the sound speed, or the fastest particle at the start. A run with plain numbers that gets faster builds
            them more often by itself.
        progress: show a bar (needs tqdm).
        out: path of a VTKHDF file to write as the run goes (not under a transformation).

    Raises:
        ValueError: arguments that do not fit.
        UnstableTimeStep: time_step is larger than the largest stable one.
        NeighborOverflow, SkinExceeded: under a transformation, when more neighbors came or particles were faster.
        ParticleOutside: a particle left the domain.
        NotFinite: a field blew up. The error's `trajectory` holds what was computed, and `out` is whole.
        SimulationError: the error-controlled solver gave up; the same holds.
    """
    if mode not in ("reverse", "forward"):
        raise ValueError(f"mode {mode!r} must be 'reverse' or 'forward'")
    n_saves, save_every = _intervals(t_end, save_every)
    traced = not is_concrete(scene, state)
    if topologies_of_scene is None:
        topologies_of_scene = topologies(scene, state if is_concrete(state) else None)
    found = topologies_of_scene
    error_controlled = isinstance(integrator, Diffrax)
    if error_controlled and scene.effect(ShepardFilter) is not None:
        raise ValueError("ShepardFilter acts between steps, and Diffrax chooses its own; take KickDriftKick()")
    limit = largest_stable(scene, found) if is_concrete(scene) and not error_controlled else None
    if time_step is None and error_controlled:
        time_step = save_every / 10  # the first try of the controller
    if time_step is None:
        if limit is None:
            raise ValueError(
                "time_step is needed when numbers of the scene are traced: the number of steps is compiled in. Pass "
                "jaxsph.stable_time_step(scene) of the stiffest and lightest scene that can occur"
            )
        time_step = safe(limit)
    checks.check_time("time_step", time_step)
    if limit is not None and float(time_step) > limit * (1 + 1e-6):
        raise UnstableTimeStep(
            f"time_step = {float(time_step):.4g} s is larger than the largest stable one, {limit:.4g} s; pass None to "
            f"take {SAFETY * limit:.4g} s"
        )
    n_steps = max(1, math.ceil(save_every / float(time_step) * (1 - 1e-9)))
    rebuild_every = 1
    if scene.meets:
        wanted = _steps_between_builds(scene, found, state, save_every / n_steps, max_speed)
        n_steps, rebuild_every = _in_builds(n_steps, wanted)
    taken = save_every / n_steps
    if isinstance(integrator, KickDriftKick):
        integrator = integrator.for_scene(scene, lambda: _stable_substeps(scene, found, taken))
        if limit is not None and integrator.substeps:
            _check_substeps(scene, found, integrator.substeps, taken)
    if state is None:
        state = initial_state(scene)
    check_state(state, scene)
    options = {
        "n_steps": n_steps,
        "integrator": integrator,
        "forward_mode": mode == "forward",
        "rebuild_every": rebuild_every,
    }
    if traced:
        if out is not None or progress:
            raise ValueError("out= and progress= need plain numbers; they do not work under jit, grad, jvp or vmap")
        first, states = _run_traced(
            scene, found, state, taken, n_saves=n_saves, memory_budget=int(memory_budget), **options
        )
        states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, _raise_in_traced(states))
    else:
        states = _run(scene, found, state, taken, n_saves, progress, out, options)
    return Trajectory(scene, states, float(taken))


def _stable_substeps(scene, found, time_step):
    if not is_concrete(scene):
        raise ValueError(
            "substeps are needed when numbers of a scene with fluids and structures are traced: they are compiled "
            "in. Pass integrator=KickDriftKick(jaxsph.stable_substeps(scene, time_step)) of the stiffest and lightest "
            "scene that can occur"
        )
    return stable_substeps(scene, time_step, found)


def _check_substeps(scene, found, substeps, time_step):
    limit = largest_stable(scene, found, substeps)
    if time_step > limit * (1 + 1e-6):
        raise UnstableTimeStep(
            f"with {dict(substeps)} substeps the largest stable time step is {limit:.4g} s, and {time_step:.4g} s is "
            f"taken; it needs {stable_substeps(scene, time_step, found)}"
        )


def _intervals(t_end, save_every):
    checks.check_time("t_end", t_end)
    if save_every is None:
        return 1, float(t_end)
    checks.check_time("save_every", save_every)
    n_saves = round(float(t_end) / float(save_every))
    if n_saves < 1 or abs(n_saves * save_every / t_end - 1) > 1e-6:
        raise ValueError(
            f"t_end = {t_end} s is not a multiple of save_every = {save_every} s; "
            f"the nearest is t_end = {max(n_saves, 1) * save_every:.10g} s"
        )
    return n_saves, float(save_every)


def _steps_between_builds(scene, found, state, time_step, max_speed) -> int:
    """How many steps of this size lists stay valid for, and no more than 8."""
    if max_speed is None:
        fastest = [0.1 * float(fluid.sound_speed) for fluid in scene.fluids if is_concrete(fluid.sound_speed)]
        if is_concrete(state, scene.systems):
            for system in [*scene.fluids, *scene.solids]:
                velocity = _velocity(system) if state is None else state.systems[system.name]["velocity"]
                fastest.append(float(np.sqrt(np.max(np.sum(np.asarray(velocity) ** 2, axis=-1)))))
        if not fastest:
            raise ValueError("max_speed is needed when the sound speed is traced: it decides how often lists are built")
        max_speed = 1.1 * max(fastest)
    checks.check_at_least("max_speed", max_speed, 0.0, "m/s")
    skin = min(found[f"{a}-{b}"].skin for a, b in surroundings.pairs_of(scene))
    return max(1, min(8, safe_steps(skin, time_step, max_speed)))


def _velocity(system):
    return system.initial_velocity() if isinstance(system, RigidBody) else system.velocity


def _in_builds(n_steps: int, wanted: int) -> tuple[int, int]:
    """A number of steps not below n_steps that is a multiple of how many are taken between two builds."""
    every = 2 ** int(math.log2(max(1, min(wanted, n_steps))))
    return every * math.ceil(n_steps / every), every


def _ready(scene, found, state):
    """References and columns of a state, as it is."""
    references = prepare(scene, found)
    return references, constrain(scene, references, to_columns(state.systems, found), state.time)


_ready_compiled = jax.jit(_ready)


def _begin(scene, found, state, forward_mode=False):
    """References, columns with the forces filled in, and whether the neighbor lists were too small for them."""
    references, columns = _ready(scene, found, state)
    lists, placed = _lists(scene, references, columns, found, state.time)
    now = dict(columns)
    if scene.fluids:
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


def _lists(scene, references, columns, found, time):
    """Neighbor lists of the systems that meet, and walls where they are at a time."""
    if not scene.meets:
        return None, None
    placed = place_boundaries(scene, references, columns, time)
    return surroundings.rebuild(scene, found, positions_of(scene, columns, placed)), placed


_begin_compiled = jax.jit(_begin)


def _advance(
    scene, references, columns, found, state, time_step, n_steps, integrator, forward_mode, rebuild_every=1, block=None
):
    """n_steps steps from a state. In blocks of `block` steps, each recomputed in reverse mode.

    Where systems meet, neighbor lists are built every rebuild_every steps, of which n_steps and block are multiples.
    Both numbers may be traced: one program then serves runs of any length, and has no reverse mode.
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

    def between_builds(carry, build):
        columns, health = carry
        first = build * rebuild_every
        if scene.domain is not None:
            for fluid in scene.fluids:
                fields = columns[fluid.name]
                columns = {**columns, fluid.name: {**fields, "position": scene.domain.wrap(fields["position"])}}
        lists, _ = _lists(scene, references, columns, found, time_of(first))
        if shepard is not None:
            apply_filter = lambda now: filtered(scene, references, now, lists, forward_mode=forward_mode)  # noqa: E731
            due = shepard.due(state.step + first, rebuild_every)
            columns = jax.lax.cond(due, apply_filter, dict, columns)
        step = checkpointed(lambda carry, number, lists: one_step(carry, number, lists))
        columns = _repeated(lambda carry, number: step(carry, first + number, lists), columns, rebuild_every)
        assert lists is not None  # this is for scenes in which systems meet
        placed = place_boundaries(scene, references, columns, time_of(first + rebuild_every))
        positions = positions_of(scene, columns, placed)
        health = surroundings.note(health, lists, positions, state.step + first + rebuild_every)
        return columns, health

    health = state.health
    block = None if forward_mode else block
    if scene.meets:
        block = None if block is None else max(1, block // rebuild_every)
        columns, health = _repeated(between_builds, (columns, health), n_steps // rebuild_every, block)
    else:
        columns = _repeated(checkpointed(one_step), columns, n_steps, block)
    step = state.step + jnp.asarray(n_steps, jnp.int32)
    finite = all_finite(jax.lax.stop_gradient(columns))
    health = health.note(~finite, NOT_FINITE, step)
    return columns, replace(state, time=state.time + dt * n_steps, step=step, health=health)


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


_advance_compiled = jax.jit(_advance, static_argnames=("forward_mode",))


def _with_rows(state, columns, found):
    return replace(state, systems=to_rows(columns, found))


@partial(jax.jit, static_argnames=("n_saves", "n_steps", "forward_mode", "memory_budget", "rebuild_every"))
def _run_traced(
    scene, found, state, time_step, *, n_saves, n_steps, integrator, forward_mode, memory_budget, rebuild_every
):
    # Lists that are too small here are so in the first steps too, which say so.
    references, columns, _ = _begin(scene, found, state, forward_mode=forward_mode)
    first = _with_rows(state, columns, found)
    if isinstance(integrator, Diffrax):
        return first, _solve(
            scene, references, columns, state, found, time_step, n_saves, n_steps, integrator, forward_mode
        )
    limit = largest_stable_time_step(*jax.lax.stop_gradient((scene, references)), integrator.substeps)
    dt = jnp.asarray(time_step, scene.dtype)
    state = replace(state, health=state.health.note(dt > limit, UNSTABLE, state.step, dt, limit))
    steps, kept = n_saves * n_steps, 2 * sum(leaf.nbytes for leaf in jax.tree.leaves(columns))
    if scene.meets:
        lists = [found[f"{a}-{b}"] for a, b in surroundings.pairs_of(scene)]
        kept += sum(leaf.nbytes for leaf in jax.tree.leaves(lists)) // rebuild_every
    block = None
    if steps * kept > memory_budget:
        block = min(n_steps, max(1, round(math.sqrt(steps))))

    def to_next_save(carry, _):
        columns, state = carry
        columns, state = _advance(
            scene, references, columns, found, state, time_step, n_steps, integrator, forward_mode, rebuild_every, block
        )
        return (columns, state), _with_rows(state, columns, found)

    start = (columns, replace(state, systems={}))
    _, states = jax.lax.scan(to_next_save, start, length=n_saves)
    return first, states


def _solve(
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
        lists, placed = _lists(scene, references, columns, found, time)
        if lists is not None:
            health = surroundings.note(health, lists, positions_of(scene, columns, placed), step)
        return State(time, step, to_rows(columns, found), health)

    return jax.vmap(at_save)(saved, times)


_solve_compiled = jax.jit(_solve, static_argnames=("n_saves", "n_steps", "forward_mode", "rebuild_every"))


def _run(scene, found, state, time_step, n_saves, progress, out, options):
    """Advance from save to save with plain numbers."""
    references, columns, found = _start(scene, found, state, options)
    first = jax.device_get(_with_rows(state, columns, found))
    saved = [first]
    whole = lambda: jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *saved)  # noqa: E731
    writer = nullcontext() if out is None else _writer(out, scene, found, time_step, n_saves, options)
    with writer as file:
        if file is not None:
            file.append_state(first)
        states = _states(scene, references, columns, state, found, time_step, n_saves, options)
        for rows in _bar(states, n_saves, progress):
            if int(rows.health.reason) != GOOD:
                raise_if_failed(rows, Trajectory(scene, whole(), float(time_step)))
            saved.append(rows)
            if file is not None:
                file.append_state(rows)
    return whole()


EVOLVED = ("position", "displacement", "remainder", "velocity", "density_deviation", "pressure")
"""Fields that a run starts with as they are given; a step of no duration could round them, or sum a density anew."""


def _start(scene, found, state, options):
    """References, columns with the forces filled in, and lists with room for them.

    The forces are those that a step of no duration finds, which spares compiling a program for them alone.
    """
    if isinstance(options["integrator"], Diffrax):
        references, columns, too_small = _begin_compiled(scene, found, state)
        while too_small:
            found = _with_room(scene, found)
            references, columns, too_small = _begin_compiled(scene, found, state)
        return references, columns, found
    references, columns = _ready_compiled(scene, found, state)
    if int(state.step) == 0:  # one that has been stepped brings the forces of its last step
        once = {**options, "n_steps": 1, "rebuild_every": 1}
        stepped, _, found, _ = _to_next_save(scene, references, columns, replace(state, systems={}), found, 0.0, once)
        for name, fields in stepped.items():
            columns[name] = {**fields, **{k: v for k, v in columns[name].items() if k in EVOLVED}}
    return references, columns, found


def _states(scene, references, columns, state, found, time_step, n_saves, options):
    """The state at each save, one after the other."""
    if isinstance(options["integrator"], Diffrax):
        states = _solve_compiled(scene, references, columns, state, found, time_step, n_saves, **options)
        states = jax.device_get(states)
        for i in range(n_saves):
            yield jax.tree.map(lambda leaf, i=i: leaf[i], states)
        return
    state = replace(state, systems={})
    for _ in range(n_saves):
        columns, state, found, options = _to_next_save(scene, references, columns, state, found, time_step, options)
        yield jax.device_get(_with_rows(state, columns, found))
        references, columns, found = _in_cell_order(scene, references, columns, found)


def _in_cell_order(scene, references, columns, found):
    """Fluids put in cell order again, so that neighbors stay near each other in memory."""
    references, columns, found = dict(references), dict(columns), dict(found)
    for fluid in scene.fluids:
        name = fluid.name
        permutation = in_cell_order(scene, np.asarray(columns[name]["position"]).T)
        found[name] = Order.of(np.asarray(found[name].order)[permutation])
        columns[name] = {field: value[..., permutation] for field, value in columns[name].items()}
        mass = references[name].mass
        references[name] = replace(references[name], mass=mass[permutation] if jnp.ndim(mass) else mass)
    return references, columns, found


def _to_next_save(scene, references, columns, state, found, time_step, options):
    """One interval; again, with more room, skin or more frequent builds, if the neighbor lists did not suffice."""
    while True:
        counts = {name: np.int32(options[name]) for name in ("n_steps", "rebuild_every")}  # traced: see _advance
        advanced, new = _advance_compiled(scene, references, columns, found, state, time_step, **options | counts)
        reason = int(new.health.reason) if scene.meets else GOOD
        if reason == BEYOND_SKIN and options["rebuild_every"] > 1:
            options = {**options, "rebuild_every": options["rebuild_every"] // 2}
        elif reason == BEYOND_SKIN and float(new.health.number) < _longest_way(scene, found):
            # One step alone is too much for this skin: the fluid is faster than a few times its sound speed's tenth.
            placed = place_boundaries(scene, references, columns, state.time)
            positions = positions_of(scene, columns, placed)
            found = {**found, **surroundings.allocate(scene, positions, skin=2 * float(new.health.limit))}
        elif reason == OVERFLOW and np.isfinite(float(new.health.number)):
            found = _with_room(scene, found, 1.1 * float(new.health.number) / float(new.health.limit))
        else:
            return advanced, new, found, options


def _longest_way(scene, found):
    """How much closer particles may come in one step [m] before the run counts as unstable: the support radius."""
    a, b = surroundings.pairs_of(scene)[0]
    return found[f"{a}-{b}"].cutoff


def _with_room(scene, found, factor: float = 0.0):
    """Lists with room for more neighbors by this factor, or a third if that is more."""
    found = dict(found)
    for a, b in surroundings.pairs_of(scene):
        found[f"{a}-{b}"] = surroundings.enlarged(found[f"{a}-{b}"], max(1.34, factor))
    return found


def _writer(out, scene, found, time_step, n_saves, options):
    from jaxsph.files import RunWriter  # h5py, for runs that are saved

    about = {"time_step": float(time_step), "integrator": type(options["integrator"]).__name__}
    return RunWriter(out, scene, found, metadata=about, saves=n_saves + 1)


def _bar(states: Iterable, n_saves: int, progress: bool):
    if not progress:
        return states
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise ImportError("progress=True needs tqdm: pip install 'jaxsph[plot]'") from error
    return tqdm(states, total=n_saves, unit="save", desc="simulate")


def _raise_in_traced(states: State) -> State:
    """Let a failed run raise when its values are used, also through jax.grad."""
    import equinox

    reason = jax.lax.stop_gradient(jnp.max(states.health.reason))
    messages = [CURES[key] for key in sorted(CURES)]
    systems = equinox.branched_error_if(states.systems, reason != GOOD, jnp.maximum(reason - 1, 0), messages)
    return replace(states, systems=systems)
