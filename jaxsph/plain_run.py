"""A run with plain numbers: from save to save, with progress, a file written as it goes, and room made where needed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import nullcontext

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import surroundings
from jaxsph.advance import advance_compiled, begin_compiled, ready_compiled, solve_compiled
from jaxsph.dynamics import Order, in_cell_order, place_boundaries, positions_of, shared_if_alike
from jaxsph.error_control import Diffrax
from jaxsph.health import BEYOND_SKIN, GOOD, OVERFLOW, raise_if_failed
from jaxsph.pytree import replace
from jaxsph.trajectory import Trajectory


def run_plain(scene, found, state, time_step, n_saves, progress, out, options):
    """Advance from save to save with plain numbers."""
    _refuse_early(progress, out, state)
    references, columns, found = _start(scene, found, state, options)
    first = _on_host(state, columns, found)
    saved = [first]
    whole = lambda: jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *saved)  # noqa: E731
    writer = nullcontext() if out is None else _writer(out, scene, found, time_step, n_saves, options)
    with writer as file:
        if file is not None:
            file.append_state(first)
        states = _states(scene, references, columns, state, found, time_step, n_saves, options)
        for rows in _bar(states, n_saves, progress):
            if int(rows.health.reason) != GOOD:
                raise_if_failed(rows, Trajectory(scene, whole(), float(time_step)), _domain(scene, found))
            saved.append(rows)
            if file is not None:
                file.append_state(rows)
    return whole()


def _refuse_early(progress, out, state):
    """What would be refused after the first step has been compiled, before that."""
    if progress:
        _tqdm()
    if out is None:
        return
    from jaxsph.files.restart import ends_with  # h5py, for runs that are saved
    from jaxsph.files.writer import check_place

    check_place(out)
    if int(state.step) > 0 and ends_with(out, state):
        raise ValueError(f"{out}: holds the run that this one continues, and would be replaced; give another name")


EVOLVED = ("position", "displacement", "remainder", "velocity", "density_deviation", "pressure")
"""Fields that a run starts with as they are given; a step of no duration could round them, or sum a density anew."""


MORE_ROOM = 1.34
"""By how much lists grow that were too small; the second time by its square, and so on, since each time a program is
compiled, which takes longer than hundreds of steps. Water that runs far needs more again and again."""

RESERVE, LARGE_RESERVE = 1.25, 5.0
"""How much further than its velocity says a particle may go in a step before lists that were thought to hold do not:
at first, and where that was not enough."""

STEPS_AT_ONCE = 500
"""So many steps are done again at most when lists did not suffice."""


def _start(scene, found, state, options):
    """References, columns with the forces filled in, and lists with room for them.

    The forces are those that a step of no duration finds, which spares compiling a program for them alone.
    """
    if isinstance(options["integrator"], Diffrax):
        references, columns, too_small = begin_compiled(scene, found, state)
        while too_small:
            found = _with_room(scene, found)
            references, columns, too_small = begin_compiled(scene, found, state)
        return shared_if_alike(references), columns, found
    references, columns = ready_compiled(scene, found, state)
    references = shared_if_alike(references)
    if int(state.step) == 0:  # one that has been stepped brings the forces of its last step
        once = {**options, "n_steps": 1, "rebuild_every": 1}
        stepped, _, found, _ = _to_next_save(scene, references, columns, replace(state, systems={}), found, 0.0, once)
        for name, fields in stepped.items():
            columns[name] = {**fields, **{k: v for k, v in columns[name].items() if k in EVOLVED}}
        return references, columns, found
    # In the order that the run which is continued has put them into at this save, so that sums have the same bits.
    return _in_cell_order(scene, references, columns, found)


def _states(scene, references, columns, state, found, time_step, n_saves, options):
    """The state at each save, one after the other."""
    if isinstance(options["integrator"], Diffrax):
        states = solve_compiled(scene, references, columns, state, found, time_step, n_saves, **options)
        states = jax.device_get(states)
        for i in range(n_saves):
            yield jax.tree.map(lambda leaf, i=i: leaf[i], states)
        return
    state = replace(state, systems={})
    for _ in range(n_saves):
        columns, state, found, options = _to_next_save(scene, references, columns, state, found, time_step, options)
        yield _on_host(state, columns, found)
        references, columns, found = _in_cell_order(scene, references, columns, found)


def _on_host(state, columns, found):
    """The state with its systems in the user's order, as NumPy arrays.

    A call of JAX for each field takes several times as long.
    """
    systems = {}
    for name, fields in columns.items():
        rank = np.asarray(found[name].rank)
        systems[name] = {field: np.moveaxis(np.asarray(value), -1, 0)[rank] for field, value in fields.items()}
    return replace(jax.device_get(state), systems=systems)


def _in_cell_order(scene, references, columns, found):
    """Fluids put in cell order again, so that neighbors stay near each other in memory."""
    references, columns, found = dict(references), dict(columns), dict(found)
    for fluid in scene.fluids:
        name = fluid.name
        permutation = in_cell_order(scene, np.asarray(columns[name]["position"]).T)
        found[name] = Order.of(np.asarray(found[name].order)[permutation])
        columns[name] = {field: np.asarray(value)[..., permutation] for field, value in columns[name].items()}
        mass = references[name].mass
        references[name] = replace(references[name], mass=mass[permutation] if jnp.ndim(mass) else mass)
    return references, columns, found


def _to_next_save(scene, references, columns, state, found, time_step, options):
    """One interval, some steps at a time, until it is done or something is wrong that more room does not mend."""
    every, left = options["rebuild_every"], options["n_steps"]
    at_once = math.ceil(STEPS_AT_ONCE / every) * every if scene.meets else left
    while left > 0:
        some = min(left, at_once)
        columns, state, found, options = _some_steps(scene, references, columns, state, found, time_step, options, some)
        if int(state.health.reason) != GOOD:
            break
        left -= some
    return columns, state, found, options


def _some_steps(scene, references, columns, state, found, time_step, options, n_steps):
    """Some steps; again, with more room, skin or more frequent builds, if the neighbor lists did not suffice."""
    reserve = RESERVE
    while True:
        counts = {"n_steps": np.int32(n_steps), "rebuild_every": np.int32(options["rebuild_every"])}
        traced = {**counts, "reserve": np.asarray(reserve, scene.dtype)}  # see advance
        given = {name: value for name, value in options.items() if name != "growth"}
        advanced, new = advance_compiled(scene, references, columns, found, state, time_step, **given | traced)
        reason = int(new.health.reason) if scene.meets else GOOD
        if reason == BEYOND_SKIN and reserve < LARGE_RESERVE:
            reserve = LARGE_RESERVE
        elif reason == BEYOND_SKIN and float(new.health.number) < _longest_way(scene, found):
            # One step alone is too much for this skin: the fluid is faster than a few times its sound speed's tenth.
            placed = place_boundaries(scene, references, columns, state.time)
            positions = positions_of(scene, columns, placed)
            found = {
                **found,
                **surroundings.allocate(scene, positions, skin=2 * surroundings.smallest_skin(scene, found)),
            }
        elif reason == OVERFLOW and np.isfinite(float(new.health.number)):
            growth = options.get("growth", 1.0) * MORE_ROOM
            found = _with_room(scene, found, max(growth, 1.1 * float(new.health.number) / float(new.health.limit)))
            options = {**options, "growth": growth}
        else:
            return advanced, new, found, options


def _domain(scene, found):
    """In which neighbors are searched; None if no systems meet."""
    lists = [found["-".join(pair)] for pair in surroundings.pairs_of(scene)] if scene.meets else []
    return lists[0].grid.domain if lists else None


def _longest_way(scene, found):
    """How much closer particles may come in one step [m] before the run counts as unstable: the support radius."""
    a, b = surroundings.pairs_of(scene)[0]
    return found[f"{a}-{b}"].cutoff


def _with_room(scene, found, factor: float = MORE_ROOM):
    """Lists with room for more neighbors by this factor."""
    found = dict(found)
    for a, b in surroundings.pairs_of(scene):
        found[f"{a}-{b}"] = surroundings.enlarged(found[f"{a}-{b}"], factor)
    return found


def _writer(out, scene, found, time_step, n_saves, options):
    from jaxsph.files import RunWriter  # h5py, for runs that are saved

    about = {"time_step": float(time_step), "integrator": type(options["integrator"]).__name__}
    return RunWriter(out, scene, found, metadata=about, saves=n_saves + 1)


def _bar(states: Iterable, n_saves: int, progress: bool):
    return _tqdm()(states, total=n_saves, unit="save", desc="simulate") if progress else states


def _tqdm():
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise ImportError("progress=True needs tqdm: pip install 'jaxsph[plot]'") from error
    return tqdm
