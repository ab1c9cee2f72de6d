"""A run: from the arguments of `simulate` to a trajectory."""

from __future__ import annotations

import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import checks, surroundings
from jaxsph.dynamics import topologies
from jaxsph.effects import BodyForce, ShepardFilter
from jaxsph.error_control import Diffrax
from jaxsph.errors import UnstableTimeStep
from jaxsph.integrate import KickDriftKick
from jaxsph.neighbors import safe_steps
from jaxsph.plain_run import run_plain
from jaxsph.pytree import is_concrete
from jaxsph.rigid_body import RigidBody
from jaxsph.stable_step import SAFETY, largest_stable, safe, stable_substeps, structure_limits
from jaxsph.state import State, check_state, initial_state
from jaxsph.traced_run import raise_in_traced, run_traced
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
        max_speed: of fluids and walls [m/s], from which follows how often neighbor lists are built under a
            transformation; None takes a tenth of the sound speed, or the fastest particle at the start. A run with
            plain numbers builds them when they are due.
        progress: show a bar (needs tqdm).
        out: path of a VTKHDF file to write as the run goes (not under a transformation), in place of an older one. A
            run that continues another needs a file of its own.

    Raises:
        ValueError: arguments that do not fit.
        UnstableTimeStep: time_step is larger than the largest stable one.
        NeighborOverflow, SkinExceeded: under a transformation, when more neighbors came or particles were faster.
        ParticleOutside: a particle left the domain.
        NotFinite: a field blew up. The error's `trajectory` holds what was computed, and `out` is whole.
        SimulationError: the error-controlled solver gave up; the same holds.
    """
    if not isinstance(integrator, (KickDriftKick, Diffrax)):
        raise ValueError(f"integrator = {integrator!r} must be KickDriftKick() or Diffrax(diffrax.Tsit5())")
    if mode not in ("reverse", "forward"):
        raise ValueError(f"mode {mode!r} must be 'reverse' or 'forward'")
    n_saves, save_every = _intervals(t_end, save_every)
    traced = not is_concrete(scene, state) or _has_traced_functions(scene)
    if topologies_of_scene is None:
        topologies_of_scene = topologies(scene, state if is_concrete(state) else None)
    found = topologies_of_scene
    for structure in scene.structures if is_concrete(scene) else ():
        if not found[structure.name].suffices(structure):
            raise ValueError(
                f"the smoothing length of {structure.name!r}, {float(structure.smoothing_length):.4g} m, is larger "
                "than that for which topologies_of_scene were made; make them of this scene"
            )
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
        given = integrator.substeps is not None
        integrator = integrator.for_scene(scene, lambda: _stable_substeps(scene, found, taken))
        if given and limit is not None:
            _check_substeps(scene, found, dict(integrator.substeps or ()), taken)
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
        first, states = run_traced(
            scene, found, state, taken, n_saves=n_saves, memory_budget=int(memory_budget), **options
        )
        states = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, raise_in_traced(states))
    else:
        states = run_plain(scene, found, state, taken, n_saves, progress, out, options)
    return Trajectory(scene, states, float(taken))


def _has_traced_functions(scene) -> bool:
    """Whether a motion or a body force is made of traced numbers, which a scene does not show."""
    time, calls = jnp.zeros((), scene.dtype), []
    for system in scene.systems:
        if getattr(system, "motion", None) is not None:
            calls.append(lambda motion=system.motion, x=system.particles.positions: motion(time, jnp.asarray(x)))
    for effect in scene.effects:
        if isinstance(effect, BodyForce):
            position = jnp.asarray(scene.systems[0].particles.positions).T
            calls.append(lambda effect=effect, x=position: effect.acceleration(x, time))
    return not all(is_concrete(call()) for call in calls)


def _stable_substeps(scene, found, time_step):
    if not is_concrete(scene):
        raise ValueError(
            "substeps are needed when numbers of a scene with fluids and structures are traced: they are compiled "
            "in. Pass integrator=KickDriftKick(jaxsph.stable_substeps(scene, time_step)) of the stiffest and lightest "
            "scene that can occur"
        )
    return stable_substeps(scene, time_step, found)


def _check_substeps(scene, found, substeps, time_step):
    if not substeps:
        return
    limit = min(substeps[name] * step for name, step in structure_limits(scene, found).items())
    if time_step > limit * (1 + 1e-6):
        raise UnstableTimeStep(
            f"with {substeps} substeps the largest stable time step is {limit:.4g} s, and {time_step:.4g} s is "
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
    skin = surroundings.smallest_skin(scene, found)
    return max(1, min(8, safe_steps(skin, time_step, max_speed)))


def _velocity(system):
    return system.initial_velocity() if isinstance(system, RigidBody) else system.velocity


def _in_builds(n_steps: int, wanted: int) -> tuple[int, int]:
    """A number of steps not below n_steps that is a multiple of how many are taken between two builds."""
    every = 2 ** int(math.log2(max(1, min(wanted, n_steps))))
    return every * math.ceil(n_steps / every), every
