"""What walls take over from the fluids: a pressure, and a velocity that makes viscous fluids stick."""

from __future__ import annotations

import jax.numpy as jnp

from jaxsph.flow.pairs import fluid_fields, motion_of, over_pairs
from jaxsph.walls import WallContinuity, WallSummation


def wall_in_forces(fluid, wall, references, placed, state):
    """A wall as a fluid meets it in the forces."""
    position, velocity, _ = motion_of(wall, placed)
    volume = references[wall.name].cells
    fields = {"position": position, "velocity": velocity, "mass": fluid.density * volume}
    fields["density"] = fluid.density
    if "pressure" in state:
        fields["pressure"] = state["pressure"]
        deviation = fluid.state_equation.deviation(state["pressure"], fluid.density, fluid.sound_speed)
        fields["density"] = fluid.density + deviation
    elif jnp.ndim(volume):
        fields["density"] = jnp.broadcast_to(fluid.density, volume.shape)
    if fluid.viscosity is not None and wall.no_slip:
        fields["slip"] = state["slip"]
    return fields


def wall_states(scene, references, columns, placed, pressures, lists, time, *, forward_mode=False) -> dict:
    """What walls take over from the fluids: by wall its `pressure` (N,) [Pa] and `slip` velocity (d, N) [m/s].

    Pressures are continued with gravity and body forces where the wall is at a time [s].

    The slip velocity is 2 v_wall less the smoothed velocity of the fluid: with it a viscous fluid has the wall's
    velocity at the wall. S. Adami, X. Y. Hu, N. A. Adams (2012), J. Comput. Phys. 231, 7057, eqs. (22) and (23).
    """
    out = {}
    for wall in scene.boundaries:
        model, state = wall.pressure, {}
        sticking = wall.no_slip and any(fluid.viscosity is not None for fluid in scene.fluids)
        position, velocity, acceleration = motion_of(wall, placed)
        for effect in scene.flow_effects:
            if model.extrapolates and effect.acceleration is not None:
                acceleration = acceleration - effect.acceleration(position, time)
        if model.extrapolates or sticking:
            total = weight = moving = 0.0
            for fluid in scene.fluids:
                senders = {**fluid_fields(fluid, references[fluid.name], columns[fluid.name])}
                senders = {name: senders[name] for name in ("position", "velocity", "density", "mass")}
                senders["pressure"] = pressures[fluid.name]
                receivers = {"position": position, "velocity": velocity, "acceleration": acceleration}

                def of_pair(a, b, pair, model=model, sticking=sticking):
                    sums = {"weight": pair.value}
                    if model.extrapolates:
                        sums["pressure"] = pair.value * model.pair(a, b, pair, jnp.asarray(scene.gravity))
                    if sticking:
                        sums["velocity"] = pair.value * b["velocity"]
                    return sums

                neighbors = lists[f"{fluid.name}-{wall.name}"].transposed()
                part = over_pairs(scene, fluid, of_pair, receivers, senders, neighbors, None, forward_mode)
                weight = weight + part["weight"]
                total, moving = total + part.get("pressure", 0.0), moving + part.get("velocity", 0.0)
            # Where nothing is near there is nothing to extrapolate. The limit is so low that the kernel's gradient
            # has faded there: at 1e-3 the force jumped when fluid came near, and gradients were off by .2 %.
            near = weight > 1e-12 * scene.kernel.w(jnp.zeros(scene.dimension, scene.dtype), scene.smoothing_length)
            safe = jnp.where(near, weight, 1.0)
            if model.extrapolates:
                state["pressure"] = jnp.where(near, total / safe, 0.0)
            if sticking:
                state["slip"] = jnp.where(near, 2 * velocity - moving / safe, velocity)
        if isinstance(model, (WallContinuity, WallSummation)):
            fluid = scene.fluids[0]
            deviation = columns[wall.name]["density_deviation"]
            state["pressure"] = fluid.state_equation.pressure(deviation, fluid.density, fluid.sound_speed)
        if model.clip and "pressure" in state:
            state["pressure"] = jnp.where(state["pressure"] > 0, state["pressure"], 0.0)
        out[wall.name] = state
    return out
