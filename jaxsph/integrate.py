"""One step in time, and the diffrax route on the same right-hand side."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxsph import checks
from jaxsph.dynamics import accelerations, constrain
from jaxsph.pytree import pytree_dataclass, static


@pytree_dataclass
class KickDriftKick:
    """Velocity Verlet with one force evaluation a step: second order, symplectic for conservative forces.

        v += a dt/2,   u += v dt,   a = a(u, v),   v += a dt/2.

    Drag enters with the velocity of the half step.
    """

    def step(self, scene, references, columns, time, time_step, *, forward_mode: bool):
        """Advance all systems from `time` by one step [s]."""
        half = 0.5 * time_step
        moved = {}
        for name, fields in columns.items():
            velocity = fields["velocity"] + half * fields["acceleration"]
            moved[name] = {**_drift(fields, time_step * velocity), "velocity": velocity}
        moved = constrain(scene, references, moved, time + time_step)
        rates = accelerations(scene, references, moved, forward_mode=forward_mode)
        return {
            name: {**fields, "velocity": fields["velocity"] + half * rates[name], "acceleration": rates[name]}
            for name, fields in moved.items()
        }


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

    def solve(self, scene, references, columns, start, times, first_step, *, forward_mode: bool):
        """Columns at the times [s] (each with a time axis in front), and whether the solver reached the end."""
        import diffrax

        def rates(time, y, _):
            placed = constrain(scene, references, y, time)
            change = accelerations(scene, references, placed, forward_mode=forward_mode)
            return {
                name: {
                    "displacement": references[name].moving * y[name]["velocity"],
                    "velocity": change[name],
                }
                for name in y
            }

        adjoint = self.adjoint
        if adjoint is None:
            adjoint = diffrax.ForwardMode() if forward_mode else diffrax.RecursiveCheckpointAdjoint()
        controller = self.controller
        if controller is None:
            controller = diffrax.PIDController(rtol=self.relative_tolerance, atol=self.absolute_tolerance)
        y = {name: {k: fields[k] for k in ("displacement", "velocity")} for name, fields in columns.items()}
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

        def complete(fields, time):
            placed = constrain(scene, references, fields, time)
            change = accelerations(scene, references, placed, forward_mode=forward_mode)
            whole = {name: {**placed[name], "acceleration": change[name]} for name in placed}
            for name, fields in columns.items():
                if "remainder" in fields:
                    whole[name]["remainder"] = jnp.zeros_like(fields["remainder"])
            return whole

        complete_all = jax.lax.map(lambda item: complete(*item), (ys, jnp.asarray(times)))
        return complete_all, solution.result == diffrax.RESULTS.successful, solution.stats["num_steps"]
