"""One step in time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.dynamics import (
    body_acceleration,
    held,
    meeting_forces,
    place_boundaries,
    structure_acceleration,
)
from jaxsph.effects import AcousticDamper
from jaxsph.flow import density_rates, keep_mean, keep_volume, pressure_rates, summed_deviations
from jaxsph.pytree import pytree_dataclass, static
from jaxsph.rigid_body import rigid_drift, rigid_kick


@pytree_dataclass
class KickDriftKick:
    """Velocity Verlet, the density at the middle of the drift: second order, symplectic for conservative forces.

        v += a dt/2,   x += v dt/2,   rho += rate(x, v) dt,   x += v dt/2,   a = a(x, rho, v),   v += a dt/2.

    Structures need one evaluation of their forces, fluids one of the density's rate and one of the forces. Drag and
    viscosity enter with the velocity of the half step.

    Structures beside fluids take `substeps` small steps in one of the fluids, each a kick-drift-kick by their stresses,
    between two half kicks by the fluids: M. Tuckerman, B. J. Berne, G. J. Martyna (1992), J. Chem. Phys. 97, 1990, eq.
    (2.20). Rigid bodies take one. Both sides get the same impulse, so momentum is exchanged to round-off. Fluids see a
    structure with its mean velocity over the step: its vibrations, which they can't follow, do not shake them.

    Attributes:
        substeps: of structures beside fluids, {"plate": 12} or one number for all; None takes `stable_substeps`.
    """

    substeps: Any = static(default=None)

    def __post_init__(self):
        counts = self.substeps
        for count in counts.values() if isinstance(counts, dict) else () if counts is None else (counts,):
            if not (isinstance(count, (int, np.integer)) and count >= 1):
                raise ValueError(f"substeps = {counts!r} must be whole numbers of at least 1")
        if isinstance(counts, dict):
            object.__setattr__(self, "substeps", tuple(sorted((k, int(n)) for k, n in counts.items())))

    def for_scene(self, scene, stable: Callable[[], dict]) -> KickDriftKick:
        """With the number of substeps of every structure that meets fluids, where none is given those of `stable()`."""
        structures = [structure.name for structure in scene.structures]
        names = structures if scene.fluids else []
        asked = [n for _, n in self.substeps] if isinstance(self.substeps, tuple) else [self.substeps or 1]
        if not names and max(asked, default=1) > 1:  # `stable_substeps` says 1 where there is nothing to divide
            raise ValueError(
                f"substeps = {self.substeps!r}: structures take substeps beside fluids, and the scene has no "
                f"{'structures' if scene.fluids else 'fluids'}; leave them out, and pass time_step="
            )
        if isinstance(self.substeps, tuple):
            unknown = [name for name, _ in self.substeps if name not in structures]
            if unknown:
                raise ValueError(f"substeps are given for {unknown}; the scene's structures are {structures}")
        given = dict(self.substeps) if isinstance(self.substeps, tuple) else dict.fromkeys(names, self.substeps)
        if any(given.get(name) is None for name in names):
            found = stable()
            given = {name: found[name] if given.get(name) is None else given[name] for name in names}
        return KickDriftKick({name: given[name] for name in names})

    def step(self, scene, references, columns, lists, time, time_step, *, forward_mode: bool):
        """Advance all systems from `time` by one step [s]."""
        half, counts = 0.5 * time_step, dict(self.substeps or ())
        moved = dict(columns)
        for structure in scene.structures:
            moved[structure.name] = _structure_step(
                scene, structure, references[structure.name], columns[structure.name], time, time_step,
                counts.get(structure.name, 1), forward_mode,
            )  # fmt: skip
        for body in scene.rigid_bodies:
            moved[body.name] = _rigid_drifted(references[body.name], columns[body.name], time_step)
        placed, now = None, time + time_step
        if scene.fluids:
            moved = _flow(scene, references, columns, moved, lists, time, time_step, forward_mode)
        elif scene.meets:
            moved = _walls_moved(scene, columns, moved, place_boundaries(scene, references, moved, now))
        if scene.meets:
            placed = place_boundaries(scene, references, moved, now)
        found = meeting_forces(scene, references, moved, placed, lists, now, forward_mode=forward_mode)
        for body in scene.rigid_bodies:
            ready, fields, met = references[body.name], moved[body.name], found.pop(body.name, {})
            pulled = {**fields, **met, "acceleration": body_acceleration(scene, ready, fields, now, met)}
            moved[body.name] = {**pulled, "velocity": rigid_kick(ready, pulled, half)}
        for name, changed in found.items():
            fields = moved[name]
            if "surface_acceleration" in changed:
                kick = changed["surface_acceleration"]
                own = {k: v for k, v in fields.items() if k != "mean_velocity"}
                changed = {**changed, "acceleration": fields["acceleration"] + kick}
                moved[name] = {**own, **changed, "velocity": fields["velocity"] + half * kick}
            else:
                moved[name] = {
                    **fields, **changed, "velocity": fields["velocity"] + half * changed["acceleration"]
                }  # fmt: skip
        return moved


def _rigid_drifted(ready, fields, time_step):
    """A rigid body half kicked, and moved to the end of the step."""
    fields = {**fields, "velocity": rigid_kick(ready, fields, 0.5 * time_step)}
    increment, velocity = rigid_drift(ready, fields, time_step)
    return {**fields, **_drift(fields, increment), "velocity": velocity}


def _walls_moved(scene, columns, moved, placed):
    """With walls where their motion has them."""
    moved = dict(moved)
    for wall in scene.walls:
        moved[wall.name] = dict(columns[wall.name])
        if wall.motion is not None:
            position, velocity, _ = placed[wall.name]
            moved[wall.name] |= {"position": position, "velocity": velocity}
    return moved


def _structure_step(scene, structure, ready, fields, time, time_step, n_steps, forward_mode):
    """A structure kicked by the fluids at the start of a step, then n_steps steps by its own forces.

    Beside fluids with its `mean_velocity`, and with the acceleration by its own forces alone.
    """
    begin = fields
    dt = time_step / n_steps
    if "surface_acceleration" in fields:
        kick = fields["surface_acceleration"]
        velocity = fields["velocity"] + 0.5 * time_step * kick
        fields = {**fields, "velocity": velocity, "acceleration": fields["acceleration"] - kick}

    def small_step(fields, number):
        now = time + number.astype(dt.dtype) * dt
        velocity = fields["velocity"] + 0.5 * dt * fields["acceleration"]
        moved = {**fields, **_drift(fields, dt * velocity), "velocity": velocity}
        moved = held(structure, ready, moved, now + dt)
        found = structure_acceleration(scene, structure, ready, moved, now + dt, forward_mode=forward_mode)
        return {**moved, "acceleration": found, "velocity": moved["velocity"] + 0.5 * dt * found}, None

    if n_steps == 1:
        fields, _ = small_step(fields, jnp.zeros((), jnp.int32))
    else:
        if not forward_mode:
            keep = jax.checkpoint_policies.save_only_these_names("displacement_gradient")
            small_step = jax.checkpoint(small_step, policy=keep, prevent_cse=False)
        fields, _ = jax.lax.scan(small_step, fields, jnp.arange(n_steps, dtype=jnp.int32))
    if "surface_acceleration" in fields:
        way = fields["displacement"] - begin["displacement"]
        if "remainder" in fields:
            way = way + (fields["remainder"] - begin["remainder"])
        # A step of no duration finds the forces of a start.
        still = time_step == 0
        mean = jnp.where(still, fields["velocity"], way / jnp.where(still, 1.0, time_step))
        fields = {**fields, "mean_velocity": mean}
    return fields


def _flow(scene, references, columns, moved, lists, time, time_step, forward_mode):
    """Fluids half kicked and drifted, their densities, and boundaries where they are at the end of the step.

    moved: with the solids at the end of the step.
    """
    half = 0.5 * time_step
    moved = dict(moved)
    for wall in scene.walls:
        moved[wall.name] = dict(columns[wall.name])
    for fluid in scene.fluids:
        fields = dict(columns[fluid.name])
        fields["velocity"] = fields["velocity"] + half * fields["acceleration"]
        fields["position"] = fields["position"] + half * path(fields)
        moved[fluid.name] = fields
    evolved = scene.density.evolved
    if evolved is not None:
        halfway = dict(moved)
        for solid in scene.solids:
            now, before = moved[solid.name], columns[solid.name]
            middle = 0.5 * (now["displacement"] + before["displacement"])
            halfway[solid.name] = {**now, "displacement": middle}
        middle = place_boundaries(scene, references, halfway, time + half)
        rates_now = rates_of(evolved, time + half)
        rates = rates_now(scene, references, halfway, middle, lists, forward_mode=forward_mode)
        for name, rate in rates.items():
            moved[name] = {**moved[name], evolved: moved[name][evolved] + time_step * rate}
        moved = noted(scene, moved, rates)
        keep = keep_volume if evolved == "density_deviation" else keep_mean
        moved = keep(scene, references, moved)
    for fluid in scene.fluids:
        fields = moved[fluid.name]
        moved[fluid.name] = {**fields, "position": fields["position"] + half * path(fields)}
    placed = place_boundaries(scene, references, moved, time + time_step)
    moved = _walls_moved(scene, moved, moved, placed)
    for name, deviation in summed_deviations(
        scene, references, moved, placed, lists, forward_mode=forward_mode
    ).items():
        moved[name] = {**moved[name], "density_deviation": deviation}
    return moved


def noted(scene, columns, rates):
    """Columns with the rates of the density, if an effect asks for them."""
    if scene.effect(AcousticDamper) is None:
        return columns
    return {
        **columns,
        **{fluid.name: {**columns[fluid.name], "density_rate": rates[fluid.name]} for fluid in scene.fluids},
    }


def rates_of(field, time):
    """The function that gives the rates of the density or the pressure, whichever evolves, at a time [s]."""
    return density_rates if field == "density_deviation" else partial(pressure_rates, time=time)


def path(fields):
    """The velocity with which particles move."""
    return fields["velocity"] + fields["shift"] if "shift" in fields else fields["velocity"]


def _drift(fields, increment):
    """Add to the displacement; in float32 with what rounding left out before (Kahan's summation).

    A step adds a millionth of the displacement. Rounded at every step, in float32 that shakes the particles hard
    enough to heat a fine beam until it breaks.
    """
    old = fields["displacement"]
    if "remainder" not in fields:
        return {"displacement": old + increment}
    increment = increment + fields["remainder"]
    new = old + increment
    return {"displacement": new, "remainder": increment - (new - old)}
