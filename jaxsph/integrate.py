"""One step in time, and the diffrax route on the same right-hand side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph import checks
from jaxsph.dynamics import (
    accelerations,
    body_acceleration,
    constrain,
    held,
    meeting_forces,
    place_boundaries,
    positions_of,
    structure_acceleration,
)
from jaxsph.effects import AcousticDamper
from jaxsph.flow import density_rates, keep_mean, keep_volume, pressure_rates, summed_deviations
from jaxsph.pytree import pytree_dataclass, static
from jaxsph.rigid_body import rigid_drift, rigid_kick
from jaxsph.surroundings import rebuild
from jaxsph.walls import WallSummation


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
        names = [structure.name for structure in scene.structures] if scene.fluids else []
        if isinstance(self.substeps, tuple):
            unknown = [name for name, _ in self.substeps if name not in [s.name for s in scene.structures]]
            if unknown:
                raise ValueError(f"substeps are given for {unknown}; the scene's structures are {names}")
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
        fields["position"] = fields["position"] + half * _path(fields)
        moved[fluid.name] = fields
    evolved = scene.density.evolved
    if evolved is not None:
        halfway = dict(moved)
        for solid in scene.solids:
            now, before = moved[solid.name], columns[solid.name]
            middle = 0.5 * (now["displacement"] + before["displacement"])
            halfway[solid.name] = {**now, "displacement": middle}
        middle = place_boundaries(scene, references, halfway, time + half)
        rates = _rates_of(evolved)(scene, references, halfway, middle, lists, forward_mode=forward_mode)
        for name, rate in rates.items():
            moved[name] = {**moved[name], evolved: moved[name][evolved] + time_step * rate}
        moved = noted(scene, moved, rates)
        keep = keep_volume if evolved == "density_deviation" else keep_mean
        moved = keep(scene, references, moved)
    for fluid in scene.fluids:
        fields = moved[fluid.name]
        moved[fluid.name] = {**fields, "position": fields["position"] + half * _path(fields)}
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


def _rates_of(field):
    return density_rates if field == "density_deviation" else pressure_rates


def _path(fields):
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


@pytree_dataclass
class Diffrax:
    """Any diffrax solver with error-controlled steps, on the same right-hand side as `KickDriftKick`.

    For reference solutions and smooth problems. Needs the `diffrax` package.

    Attributes:
        solver: a diffrax solver; None takes `diffrax.Tsit5()`.
        relative_tolerance, absolute_tolerance: of the step size controller. The error is measured in the root
            mean square over displacements [m] and velocities [m/s] together.
        controller: a diffrax step size controller, instead of one from the tolerances.
        adjoint: a diffrax adjoint; None takes `RecursiveCheckpointAdjoint()` in reverse mode and `ForwardMode()`
            in forward mode.
        max_steps: after which the run stops with an error.
    """

    solver: Any = static(default=None)
    relative_tolerance: float = static(default=1e-6)
    absolute_tolerance: float = static(default=1e-9)
    controller: Any = static(default=None)
    adjoint: Any = static(default=None)
    max_steps: int = static(default=100_000)

    def __post_init__(self):
        checks.check_positive("relative_tolerance", self.relative_tolerance, "no unit")
        checks.check_positive("absolute_tolerance", self.absolute_tolerance, "m, m/s")
        if self.max_steps < 1:
            raise ValueError(f"max_steps = {self.max_steps} must be at least 1")

    def solve(self, scene, references, columns, templates, start, times, first_step, *, forward_mode: bool):
        """Columns at the times [s] (each with a time axis in front), and whether the solver reached the end.

        Neighbor lists are built anew from `templates` at every evaluation.
        """
        import diffrax

        def evaluate(time, y):
            """All fields that follow from those of the solver, and the rates of these."""
            shifted = {name: {k: v for k, v in columns[name].items() if k == "shift"} | y[name] for name in y}
            fields = constrain(scene, references, {**columns, **shifted}, time)
            lists, placed, changes = {}, None, {}
            if scene.meets:
                placed = place_boundaries(scene, references, fields, time)
                fields = {**fields, **{wall.name: dict(fields[wall.name]) for wall in scene.walls}}
                for wall in scene.walls:
                    if wall.motion is not None:
                        position, velocity, _ = placed[wall.name]
                        fields[wall.name] |= {"position": position, "velocity": velocity}
                lists = rebuild(scene, templates, positions_of(scene, fields, placed))
                summed = summed_deviations(scene, references, fields, placed, lists, forward_mode=forward_mode)
                for name, deviation in summed.items():
                    fields[name] = {**fields[name], "density_deviation": deviation}
                if scene.density.evolved is not None:
                    keep = keep_volume if scene.density.evolved == "density_deviation" else keep_mean
                    fields = keep(scene, references, fields)
            # A step takes the shift from the one before; here it has to be that of this moment: twice, then.
            for _ in range(2 if any("shift" in values for values in fields.values()) else 1):
                found = accelerations(scene, references, fields, time, lists, placed, forward_mode=forward_mode)
                fields = {name: {**values, **found.get(name, {})} for name, values in fields.items()}
            evolved = scene.density.evolved
            if scene.fluids and evolved is not None:
                rates = _rates_of(evolved)(scene, references, fields, placed, lists, forward_mode=forward_mode)
                changes = {name: {evolved: rate} for name, rate in rates.items()}
                if scene.effect(AcousticDamper) is not None:
                    fields = noted(scene, fields, rates)
                    found = accelerations(scene, references, fields, time, lists, placed, forward_mode=forward_mode)
                    fields = {name: {**values, **found.get(name, {})} for name, values in fields.items()}
            return fields, changes

        def rates(time, y, _):
            fields, changes = evaluate(time, y)
            change = {}
            for name, solved in y.items():
                change[name] = {}
                if "displacement" in solved:
                    change[name]["displacement"] = references[name].moving * solved["velocity"]
                if "position" in solved:
                    change[name]["position"] = _path(fields[name])
                if "velocity" in solved:
                    change[name]["velocity"] = fields[name]["acceleration"]
                zeros = {k: jnp.zeros_like(solved[k]) for k in ("density_deviation", "pressure") if k in solved}
                change[name] |= zeros | changes.get(name, {})
            return change

        adjoint = self.adjoint
        if adjoint is None:
            adjoint = diffrax.ForwardMode() if forward_mode else diffrax.RecursiveCheckpointAdjoint()
        controller = self.controller
        if controller is None:
            controller = diffrax.PIDController(rtol=self.relative_tolerance, atol=self.absolute_tolerance)
        y = {name: {k: fields[k] for k in _solved(scene, name, fields)} for name, fields in columns.items()}
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            diffrax.Tsit5() if self.solver is None else self.solver,
            t0=start,
            t1=times[-1],
            dt0=first_step,
            y0=y,
            saveat=diffrax.SaveAt(ts=times),
            stepsize_controller=controller,
            adjoint=adjoint,
            max_steps=self.max_steps,
            throw=False,
        )
        ys = solution.ys
        assert ys is not None

        def complete(y, time):
            whole, _ = evaluate(time, y)
            for name, fields in columns.items():
                if "remainder" in fields:
                    whole[name]["remainder"] = jnp.zeros_like(fields["remainder"])
            return whole

        complete_all = jax.lax.map(lambda item: complete(*item), (ys, jnp.asarray(times)))
        return complete_all, solution.result == diffrax.RESULTS.successful, solution.stats["num_steps"]


def _solved(scene, name, fields):
    """The fields of a system that an error-controlled solver integrates."""
    if "acceleration" not in fields:
        names = ["density_deviation"]  # a wall
    else:
        names = ["displacement", "position", "velocity", "density_deviation", "pressure"]
    summed = {fluid.name for fluid in scene.fluids if scene.density.summed}
    summed |= {wall.name for wall in scene.boundaries if isinstance(wall.pressure, WallSummation)}
    return [k for k in names if k in fields and not (k == "density_deviation" and name in summed)]
