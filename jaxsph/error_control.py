"""The diffrax route: error-controlled steps on the same right-hand side as `KickDriftKick`."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxsph import checks
from jaxsph.dynamics import accelerations, constrain, place_boundaries, positions_of
from jaxsph.effects import AcousticDamper
from jaxsph.flow import keep_mean, keep_volume, summed_deviations
from jaxsph.integrate import noted, path, rates_of
from jaxsph.pytree import pytree_dataclass, static
from jaxsph.surroundings import rebuild
from jaxsph.walls import WallSummation

OF_THE_PAST = ("shift", "cover", "density_rate")
"""Fields that a step takes from the one before. An evaluation makes them anew, whatever they are at first."""


@pytree_dataclass
class Diffrax:
    """A diffrax solver with error-controlled steps, on the same right-hand side as `KickDriftKick`.

    For reference solutions and smooth problems. Needs the `diffrax` package.

    Attributes:
        solver: a diffrax solver that estimates its error, such as `diffrax.Dopri8()`; None takes `diffrax.Tsit5()`.
            Without an estimate (`diffrax.Euler()`) it needs controller=diffrax.ConstantStepSize(). Implicit ones work,
            and take a matrix of all particles.
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
        if isinstance(self.solver, type):
            raise ValueError(f"solver = {self.solver!r} is a class; call it: Diffrax(diffrax.{self.solver.__name__}())")
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
            noticed = {name: {k: v for k, v in columns[name].items() if k in OF_THE_PAST} | y[name] for name in y}
            fields = constrain(scene, references, {**columns, **noticed}, time)
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
            # A step takes shift and cover from the one before; here they have to be those of this moment: twice, then.
            remembered = any("shift" in values or "cover" in values for values in fields.values())
            for _ in range(2 if remembered else 1):
                found = accelerations(scene, references, fields, time, lists, placed, forward_mode=forward_mode)
                fields = {name: {**values, **found.get(name, {})} for name, values in fields.items()}
            evolved = scene.density.evolved
            if scene.fluids and evolved is not None:
                rates = rates_of(evolved, time)(scene, references, fields, placed, lists, forward_mode=forward_mode)
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
                    change[name]["position"] = path(fields[name])
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
