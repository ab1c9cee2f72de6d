"""The state: how the world is now."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsph.effects import AcousticDamper, DeltaDiffusion, Shifting, TensileControl
from jaxsph.fluid import Fluid
from jaxsph.health import Health
from jaxsph.pytree import pytree_dataclass, replace
from jaxsph.rigid_body import RigidBody
from jaxsph.structure import Structure
from jaxsph.walls import WallContinuity, WallSummation


@pytree_dataclass
class State:
    """Everything that changes.

    Attributes:
        time: [s].
        step: number of steps taken; in states that an error-controlled solver saved those of its whole run.
        systems: by name of the system, its fields, particle first and in the user's order. A structure or rigid body
            has `displacement` (N, d) [m], `velocity` (N, d) [m/s], `acceleration` (N, d) [m/s^2], and in float32
            `remainder` (N, d) [m], what rounding left out of the displacement (see docs/formulation.md); beside fluids
            and with `Contact` also `surface_acceleration` (N, d) [m/s^2], the force per mass by them. A fluid has
            `position`, `velocity`, `acceleration` (N, d) and `density_deviation` (N,), rho - rho_0 [kg/m^3]; with
            `ParticleShifting` or `TransportVelocity` a `shift` (N, d) [m/s], with `DeltaDiffusion` a
            `density_gradient` (N, d), with `TensileControl` a `cover` (N,), with `AcousticDamper` a `density_rate` (N,)
            [kg/(m^3 s)], with the density calculator `EDAC` a
            `pressure` (N,) [Pa]. A wall has `position` and `velocity` if it moves, `density_deviation` if its model
            integrates it, else nothing.
        health: what went wrong, if anything did.
        time_remainder: [s], what rounding left out of `time` in float32; None in float64.

    In a trajectory every array has a time axis in front.
    """

    time: Any
    step: Any
    systems: dict
    health: Health
    time_remainder: Any = None

    def later(self, duration) -> State:
        """The state with a clock that is a duration [s] later. Rounded sums would drift with the number of saves."""
        if self.time_remainder is None:
            return replace(self, time=self.time + duration)
        added = duration + self.time_remainder
        time = self.time + added
        return replace(self, time=time, time_remainder=added - (time - self.time))


def initial_state(scene) -> State:
    """The scene at rest in its reference configuration, with its initial velocities and still without forces.

    The acceleration is filled in by the first call of `simulate`; a kick-drift-kick step needs it.
    """
    systems = {system.name: _initial_fields(scene, system) for system in scene.systems}
    zero = jnp.zeros((), scene.dtype)
    remainder = zero if scene.dtype == np.float32 else None
    return State(zero, jnp.zeros((), jnp.int32), systems, Health.good(scene.dtype), remainder)


def _initial_fields(scene, system) -> dict:
    shape, dtype = system.particles.positions.shape, system.dtype
    zero = jnp.zeros(shape, dtype)
    if isinstance(system, (Structure, RigidBody)):
        if isinstance(system, RigidBody):
            velocity = system.initial_velocity()
        else:
            free = (~system.clamped)[:, None]
            velocity = jnp.where(free, jnp.broadcast_to(jnp.asarray(system.velocity), shape), zero)
        fields = {"displacement": zero, "velocity": velocity, "acceleration": zero}
        if scene.meets:
            fields |= {"surface_acceleration": zero} | _remembered(system, shape, dtype)
        return fields | ({"remainder": zero} if dtype == np.float32 else {})
    if isinstance(system, Fluid):
        fields = {
            "position": jnp.asarray(system.particles.positions),
            "velocity": jnp.broadcast_to(jnp.asarray(system.velocity), shape),
            "acceleration": zero,
            "density_deviation": jnp.broadcast_to(jnp.asarray(system.initial_deviation(), dtype), shape[:1]),
        }
        if scene.density.evolved == "pressure":
            initial = 0.0 if system.pressure is None else system.pressure
            fields["pressure"] = jnp.broadcast_to(jnp.asarray(initial, dtype), shape[:1])
        blank = zero[:, 0]
        extra = {"shift": (Shifting, zero), "density_gradient": (DeltaDiffusion, zero)}
        extra |= {"cover": (TensileControl, blank), "density_rate": (AcousticDamper, blank)}
        return fields | {name: start for name, (kind, start) in extra.items() if scene.effect(kind) is not None}
    fields = {}
    if system.motion is not None:
        position, velocity, _ = system.placed(jnp.asarray(system.particles.positions).T, jnp.zeros((), dtype))
        fields |= {"position": position.T, "velocity": velocity.T}
    return fields | _remembered(system, shape, dtype)


def _remembered(boundary, shape, dtype) -> dict:
    """What the model of a boundary's pressure remembers."""
    has_density = isinstance(boundary.pressure, (WallContinuity, WallSummation))
    return {"density_deviation": jnp.zeros(shape[:1], dtype)} if has_density else {}


def to_columns(systems: dict, topologies: dict) -> dict:
    """User's order, particle first, to cell order, particle last."""
    return {
        name: {field: jnp.moveaxis(value[topologies[name].order], 0, -1) for field, value in fields.items()}
        for name, fields in systems.items()
    }


def to_rows(columns: dict, topologies: dict) -> dict:
    """Cell order, particle last, to the user's order, particle first."""
    return {
        name: {field: jnp.moveaxis(value, -1, 0)[topologies[name].rank] for field, value in fields.items()}
        for name, fields in columns.items()
    }


def check_state(state: State, scene) -> None:
    """Raise ValueError unless a state belongs to a scene: same systems, shapes and precision."""
    expected = jax.eval_shape(lambda: initial_state(scene)).systems
    if set(state.systems) != set(expected):
        raise ValueError(f"the state has the systems {sorted(state.systems)}, the scene {sorted(expected)}")
    for name, fields in expected.items():
        for field, want in fields.items():
            have = state.systems[name].get(field)
            if have is None or jnp.shape(have) != want.shape or np.dtype(have.dtype) != want.dtype:
                found = "nothing" if have is None else f"{jnp.shape(have)} {have.dtype}"
                raise ValueError(f"state of {name!r}: {field} is {found}; the scene needs {want.shape} {want.dtype}")
