"""The sums of a fluid over its pairs: rate of the density, forces, and what a wall takes over from the fluid.

Two passes over the pairs make a step: one for the density, one for the forces. All effects of a scene share them, and
every sum is weighted so that a pair is symmetric or antisymmetric: momentum and mass are exchanged to round-off, and a
gradient costs half.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxsph.effects import DeltaDiffusion, ParticleShifting
from jaxsph.fluid import Fluid
from jaxsph.pair_sum import dot, pair_sum
from jaxsph.pytree import pytree_dataclass
from jaxsph.tensors import inverse
from jaxsph.walls import WallContinuity, WallSummation


class Pair(NamedTuple):
    """Geometry of a pair, and the numbers of the scene that effects need."""

    offset: Any
    """x_a - x_b (d,) [m], to the nearest image in a periodic domain."""
    squared: Any
    """|x_a - x_b|^2 [m^2]."""
    slope: Any
    """F [1/m^(d+2)], finite where particles meet."""
    gradient: Any
    """grad_a W = F (x_a - x_b) (d,) [1/m^(d+1)]."""
    value: Any
    """W [1/m^d]."""
    value_at_spacing: Any
    """W at a distance of one particle spacing."""
    smoothing_length: Any
    sound_speed: Any
    """c [m/s]; between two fluids the mean of theirs, so that what a gets from b is what b gets from a."""


@pytree_dataclass
class FluidReference:
    """What of a fluid does not change during a run: mass, one number or (N,) in cell order [kg]."""

    mass: Any


@pytree_dataclass
class WallReference:
    """What of a wall does not change: positions at t = 0 (d, N) [m] and volumes, one number or (N,) [m^d]."""

    positions: Any
    volume: Any


def fluid_fields(fluid: Fluid, reference: FluidReference, columns: dict) -> dict:
    """The fields of a fluid that its pairs are made of, (..., N), and numbers that all of it shares."""
    density = fluid.density + columns["density_deviation"]
    fields = {"position": columns["position"], "velocity": columns["velocity"], "density": density}
    fields["mass"], fields["sound_speed"] = reference.mass, fluid.sound_speed
    for name in ("shift", "density_gradient"):
        if name in columns:
            fields[name] = columns[name]
    if fluid.viscosity is not None:
        fields["viscosity"] = fluid.viscosity
    return fields


def pressure(fluid: Fluid, columns: dict):
    """Pressure (N,) [Pa] of a fluid."""
    return fluid.state_equation.pressure(columns["density_deviation"], fluid.density, fluid.sound_speed)


def _over_pairs(scene, fluid, of_pair, receivers, senders, neighbors, symmetry=None, forward_mode=False):
    """Sum of_pair(a, b, pair) where a and b have all their fields; numbers shared by a system are not gathered."""
    kernel, h = scene.kernel, scene.smoothing_length
    at_spacing = kernel.w(jnp.zeros(scene.dimension, scene.dtype).at[0].set(scene.spacing), h)
    (varying_a, uniform_a), (varying_b, uniform_b) = _split(receivers), _split(senders)
    if receivers is senders:
        varying_b = varying_a

    def physics(a, b):
        a, b = _whole(uniform_a, a), _whole(uniform_b, b)
        offset = scene.displacement(a["position"], b["position"])
        slope, value = kernel.gradient_factor(offset, h), kernel.w(offset, h)
        speed = 0.5 * (a.get("sound_speed", fluid.sound_speed) + b.get("sound_speed", fluid.sound_speed))
        pair = Pair(offset, dot(offset, offset), slope, slope * offset, value, at_spacing, h, speed)
        return of_pair(a, b, pair)

    return pair_sum(physics, varying_a, varying_b, neighbors, symmetry=symmetry, forward_mode=forward_mode)


def _split(fields):
    varying = {name: value for name, value in fields.items() if jnp.ndim(value) > 0}
    return varying, {name: value for name, value in fields.items() if jnp.ndim(value) == 0}


def _whole(uniform, fields):
    fields = {**uniform, **fields}
    if "density" in fields:
        fields["volume"] = fields["mass"] / fields["density"]
    return fields


def partners(scene, fluid, lists):
    """The other systems of a fluid's pairs, and the lists: (system, list); itself first."""
    yield fluid, lists[f"{fluid.name}-{fluid.name}"]
    names = [other.name for other in scene.fluids]
    for other in scene.fluids:
        if other.name != fluid.name:
            first = names.index(fluid.name) < names.index(other.name)
            if first:
                yield other, lists[f"{fluid.name}-{other.name}"]
            else:
                yield other, lists[f"{other.name}-{fluid.name}"].transposed()
    for wall in scene.walls:
        yield wall, lists[f"{fluid.name}-{wall.name}"]


def density_rates(scene, references, columns, placed, lists, *, forward_mode=False) -> dict:
    """Rates of the density [kg/(m^3 s)] of all fluids, and of walls with a density of their own, (N,) each.

    placed: by wall its positions, velocities and accelerations, from `Wall.placed`.
    """
    effects = [effect for effect in scene.flow_effects if effect.density_flux is not None]
    shifting = scene.effect(ParticleShifting)
    rates = {}
    for fluid in scene.fluids:
        own = fluid_fields(fluid, references[fluid.name], columns[fluid.name])
        divergence = flux = 0.0
        for other, neighbors in partners(scene, fluid, lists):
            same, wall = other is fluid, not isinstance(other, Fluid)
            if wall:
                senders = _wall_at_rest(fluid, other, references, placed)
            else:
                senders = own if same else fluid_fields(other, references[other.name], columns[other.name])
            # Not between two fluids: the jump of their rest densities is none that diffusion may level.
            active = effects if same else [effect for effect in effects if wall and effect.with_walls]

            carry = shifting is not None and same

            def of_pair(a, b, pair, active=active, carry=carry):
                moving = dot(a["velocity"] - b["velocity"], pair.gradient)
                out = {"divergence": scene.density.divergence(a, b, moving)}
                if carry:
                    out["carried"] = shifting.carried(a, b, b["density"] - a["density"], pair)
                fluxes = [effect.density_flux(a, b, pair) for effect in active]
                return out | ({"flux": sum(fluxes)} if fluxes else {})

            symmetry = None
            if same:
                symmetry = {"divergence": 1} | ({"flux": -1} if active else {}) | ({"carried": 1} if carry else {})
            total = _over_pairs(scene, fluid, of_pair, own, senders, neighbors, symmetry, forward_mode)
            divergence = divergence + total["divergence"]
            flux = flux + total.get("flux", 0.0) + total.get("carried", 0.0)
        volume = own["mass"] / own["density"]
        rates[fluid.name] = scene.density.of_divergence(divergence, own["density"], volume) + flux / volume
    for wall in scene.walls:
        if isinstance(wall.pressure, WallContinuity):
            rates[wall.name] = _wall_rate(scene, wall, references, columns, placed, lists, forward_mode)
    return rates


def keep_volume(scene, references, columns) -> dict:
    """Columns with densities such that all fluids together fill the volume that they filled at the start.

    Only where `ParticleShifting` is told that there is no free surface. Shifted particles do not follow the flow, so
    that the sum of their volumes m / rho drifts; in a closed domain the pressure then sinks until the fluid tears.
    """
    shifting = scene.effect(ParticleShifting)
    if shifting is None or shifting.free_surface:
        return columns
    now = start = 0.0
    for fluid in scene.fluids:
        density = fluid.density + columns[fluid.name]["density_deviation"]
        now = now + jnp.sum(jnp.broadcast_to(references[fluid.name].mass, density.shape) / density)
        start = start + jnp.sum(jnp.asarray(fluid.particles.volumes))
    excess = now / start - 1
    out = dict(columns)
    for fluid in scene.fluids:
        deviation = columns[fluid.name]["density_deviation"]
        out[fluid.name] = {
            **columns[fluid.name],
            "density_deviation": deviation + (fluid.density + deviation) * excess,
        }
    return out


def _wall_at_rest(fluid, wall, references, placed):
    """A wall as a fluid meets it in the density's rate: with its own velocity and the rest density.

    A sliding surface does not move the wall: its velocity would let a corner breathe.
    """
    position, velocity, _ = placed[wall.name]
    velocity = velocity if wall.motion is not None else jnp.zeros_like(velocity)
    fields = {"position": position, "velocity": velocity}
    volume = references[wall.name].volume
    fields["mass"] = fluid.density * volume
    fields["density"] = fluid.density
    if jnp.ndim(volume):
        fields["density"] = jnp.broadcast_to(fluid.density, volume.shape)
    return fields


def _wall_rate(scene, wall, references, columns, placed, lists, forward_mode):
    total = 0.0
    for fluid in scene.fluids:
        own = _wall_at_rest(fluid, wall, references, placed)
        senders = fluid_fields(fluid, references[fluid.name], columns[fluid.name])
        neighbors = lists[f"{fluid.name}-{wall.name}"].transposed()

        def of_pair(a, b, pair, fluid=fluid):
            return fluid.density * b["volume"] * dot(a["velocity"] - b["velocity"], pair.gradient)

        total = total + _over_pairs(scene, fluid, of_pair, own, senders, neighbors, None, forward_mode)
    return total


def summed_deviations(scene, references, columns, placed, lists, *, forward_mode=False) -> dict:
    """Densities as sums over particles, less the rest density [kg/m^3]: of fluids whose density is summed, and of walls.

    Equation (5).
    """
    out = {}
    at_zero = scene.kernel.w(jnp.zeros(scene.dimension, scene.dtype), scene.smoothing_length)
    for fluid in scene.fluids if scene.density.summed else ():
        own = fluid_fields(fluid, references[fluid.name], columns[fluid.name])
        total = own["mass"] * at_zero
        for other, neighbors in partners(scene, fluid, lists):
            if isinstance(other, Fluid):
                senders = own if other is fluid else fluid_fields(other, references[other.name], columns[other.name])
            else:
                senders = _wall_at_rest(fluid, other, references, placed)
            total = total + _over_pairs(
                scene, fluid, lambda a, b, pair: b["mass"] * pair.value, own, senders, neighbors, None, forward_mode
            )
        out[fluid.name] = total - fluid.density
    for wall in scene.walls:
        if isinstance(wall.pressure, WallSummation):
            # One fluid gives the wall its rest density; more than one would leave it undefined.
            fluid = scene.fluids[0]
            own = _wall_at_rest(fluid, wall, references, placed)
            total = own["mass"] * at_zero + _over_pairs(
                scene, fluid, lambda a, b, pair: b["mass"] * pair.value, own, own, lists[f"{wall.name}-{wall.name}"]
            )
            for other in scene.fluids:
                senders = fluid_fields(other, references[other.name], columns[other.name])
                neighbors = lists[f"{other.name}-{wall.name}"].transposed()
                of_pair = lambda a, b, pair: b["mass"] * pair.value  # noqa: E731
                total = total + _over_pairs(scene, fluid, of_pair, own, senders, neighbors, None, forward_mode)
            out[wall.name] = total - fluid.density
    return out


def forces(scene, references, columns, placed, lists, time, *, forward_mode=False) -> dict:
    """By fluid: `acceleration` (d, N) [m/s^2] and, if the scene calls for them, `shift` and `density_gradient`."""
    effects = [effect for effect in scene.flow_effects if effect.force is not None]
    outside = [effect for effect in scene.flow_effects if effect.acceleration is not None]
    shifting, delta = scene.effect(ParticleShifting), scene.effect(DeltaDiffusion)
    pressures = {fluid.name: pressure(fluid, columns[fluid.name]) for fluid in scene.fluids}
    walls = wall_states(scene, references, columns, placed, pressures, lists, forward_mode=forward_mode)
    out = {}
    for fluid in scene.fluids:
        own = fluid_fields(fluid, references[fluid.name], columns[fluid.name])
        own["pressure"] = pressures[fluid.name]
        own.pop("density_gradient", None)  # that of the step before
        totals: dict[str, Any] = {}
        for other, neighbors in partners(scene, fluid, lists):
            same, wall = other is fluid, not isinstance(other, Fluid)
            if wall:
                senders = _wall_in_forces(fluid, other, references, placed, walls[other.name])
            elif same:
                senders = own
            else:
                senders = fluid_fields(other, references[other.name], columns[other.name])
                senders["pressure"] = pressures[other.name]
                senders.pop("density_gradient", None)
            viscous = fluid.viscosity is not None and (other.no_slip if wall else other.viscosity is not None)
            active = [effect for effect in effects if effect.with_walls or not wall]

            def of_pair(a, b, pair, fluid=fluid, other=other, wall=wall, viscous=viscous, active=active, same=same):
                if wall and "pressure" not in b:
                    b = {**b, "pressure": other.pressure.of_pair(a["pressure"])}
                force = scene.density.pressure_force(a, b, pair.gradient)
                seen = b["velocity"]
                if viscous:
                    if wall:
                        seen = b["slip"]
                    sticking = {**b, "velocity": seen, "viscosity": b.get("viscosity", a["viscosity"])}
                    force = force + fluid.viscosity_law.force(a, sticking, pair)
                for effect in active:
                    force = force + effect.force(a, b, pair)
                sums = {"force": force}
                if shifting is not None:
                    if wall:
                        b = {**b, "shift": a["shift"]}
                    sums["carried"] = shifting.carried(a, b, seen - a["velocity"], pair)
                    sums["crowding"] = shifting.crowding(a, b, pair)
                if shifting is not None and shifting.free_surface:
                    volumes = a["volume"] * b["volume"]
                    sums["cover"] = -volumes * dot(pair.offset, pair.gradient) / scene.dimension
                    sums["normal"] = volumes * pair.gradient
                if delta is not None and same:
                    volumes = a["volume"] * b["volume"]
                    sums["moment"] = -volumes * pair.gradient[:, None] * pair.offset[None, :]
                    sums["density_gradient"] = volumes * (b["density"] - a["density"]) * pair.gradient
                return sums

            symmetry = None
            if same:
                symmetry = {"force": -1}
                if shifting is not None:
                    symmetry |= {"carried": 1, "crowding": -1}
                    symmetry |= {"cover": 1, "normal": -1} if shifting.free_surface else {}
                symmetry |= {"moment": 1, "density_gradient": 1} if delta is not None else {}
            part = _over_pairs(scene, fluid, of_pair, own, senders, neighbors, symmetry, forward_mode)
            totals = {name: totals.get(name, 0.0) + part.get(name, 0.0) for name in {**totals, **part}}
        out[fluid.name] = _finish(scene, fluid, own, totals, outside, shifting, delta, time)
    return out


def _finish(scene, fluid, own, totals, outside, shifting, delta, time):
    """From the sums to what the step needs."""
    volume = own["mass"] / own["density"]
    acceleration = totals["force"] / own["mass"] + jnp.asarray(scene.gravity)[:, None]
    if shifting is not None:
        acceleration = acceleration + totals["carried"] / volume
    for effect in outside:
        acceleration = acceleration + effect.acceleration(own["position"], time)
    done = {"acceleration": acceleration}
    if shifting is not None:
        crowding = totals["crowding"] / volume
        done["shift"] = shifting.velocity(
            crowding,
            scene.kernel.support_radius(scene.smoothing_length),
            fluid.sound_speed,
            cover=totals["cover"] / volume if shifting.free_surface else None,
            normal=totals["normal"] if shifting.free_surface else None,
        )
    if delta is not None:
        done["density_gradient"] = corrected(totals["moment"], totals["density_gradient"])
    return done


def corrected(moment, uncorrected):
    """M^-1 times a raw gradient (d, N), M (d, d, N); zero where a particle has too few neighbors for an inverse."""
    d = moment.shape[0]
    size = sum(moment[i, i] for i in range(d)) / d
    scaled = moment / jnp.where(size > 0, size, 1.0)
    identity = jnp.eye(d, dtype=moment.dtype)[:, :, None]
    determinant = scaled[0, 0] * scaled[1, 1] - scaled[0, 1] * scaled[1, 0] if d == 2 else _determinant_3d(scaled)
    good = (size > 0) & (determinant > 0.05)
    safe = jnp.where(good, scaled, identity)
    raw = uncorrected / jnp.where(size > 0, size, 1.0)
    return jnp.where(good, jnp.sum(inverse(safe) * raw[None], axis=1), 0.0)


def _determinant_3d(m):
    return (
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )


def _wall_in_forces(fluid, wall, references, placed, state):
    """A wall as a fluid meets it in the forces."""
    position, velocity, _ = placed[wall.name]
    volume = references[wall.name].volume
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


def wall_states(scene, references, columns, placed, pressures, lists, *, forward_mode=False) -> dict:
    """What walls take over from the fluids: by wall its `pressure` (N,) [Pa] and `slip` velocity (d, N) [m/s].

    The slip velocity is 2 v_wall less the smoothed velocity of the fluid: with it a viscous fluid has the wall's
    velocity at the wall. S. Adami, X. Y. Hu, N. A. Adams (2012), J. Comput. Phys. 231, 7057, eqs. (22) and (23).
    """
    out = {}
    for wall in scene.walls:
        model, state = wall.pressure, {}
        sticking = wall.no_slip and any(fluid.viscosity is not None for fluid in scene.fluids)
        position, velocity, acceleration = placed[wall.name]
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
                part = _over_pairs(scene, fluid, of_pair, receivers, senders, neighbors, None, forward_mode)
                weight = weight + part["weight"]
                total, moving = total + part.get("pressure", 0.0), moving + part.get("velocity", 0.0)
            # Where nothing is near there is nothing to extrapolate. The limit is so low that the kernel's gradient
            # has faded there: at 1e-3 the force jumps by that much when fluid comes near, which gradients do not see.
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
