"""The forces on fluids, and what else is summed on the way."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxsph.effects import AcousticDamper, DeltaDiffusion, KernelGradientCorrection, Shifting, TensileControl
from jaxsph.flow.correction import moments
from jaxsph.flow.pairs import fluid_fields, kind_of, over_pairs, partners, pressure
from jaxsph.flow.pressure import mean_pressures
from jaxsph.flow.walls import wall_in_forces, wall_states
from jaxsph.fluid import Fluid
from jaxsph.pair_sum import dot
from jaxsph.tensors import determinant, inverse, symmetric, upper


def forces(scene, references, columns, placed, lists, time, *, forward_mode=False) -> dict:
    """What a step needs of the forces on fluids, and of those that fluids exert on structures.

    By fluid: `acceleration` (d, N) [m/s^2] and, if the scene calls for them, `shift` and `density_gradient`. By
    structure and rigid body: `surface_acceleration` (d, N) [m/s^2].
    """
    outside = [effect for effect in scene.flow_effects if effect.acceleration is not None]
    shifting, delta = scene.effect(Shifting), scene.effect(DeltaDiffusion)
    carry = shifting is not None and not shifting.free_surface
    outward = shifting is not None and shifting.free_surface
    covered = outward or scene.effect(TensileControl) is not None
    pressures = {fluid.name: pressure(fluid, columns[fluid.name]) for fluid in scene.fluids}
    damper = scene.effect(AcousticDamper)
    if damper is not None:
        for fluid in scene.fluids:
            rate = columns[fluid.name]["density_rate"]
            pressures[fluid.name] += damper.pressure(rate, fluid.sound_speed, scene.smoothing_length)
    walls = wall_states(scene, references, columns, placed, pressures, lists, time, forward_mode=forward_mode)
    correction = scene.effect(KernelGradientCorrection)
    means = {}
    if scene.density.averaged_pressure:
        means = mean_pressures(scene, references, columns, placed, lists, pressures, walls, forward_mode=forward_mode)
    fields = {}
    for fluid in scene.fluids:
        own = fluid_fields(fluid, references[fluid.name], columns[fluid.name])
        own["pressure"] = pressures[fluid.name]
        own.pop("density_gradient", None)  # that of the step before
        if delta is not None:  # with so many sums gathering it is faster than dividing: a fifth of a step in 2D
            own["volume"] = own["mass"] / own["density"]
        fields[fluid.name] = own
    out = {}
    for fluid in scene.fluids:
        own = fields[fluid.name]
        if fluid.name in means:
            own = {**own, "mean_pressure": means[fluid.name]}
        if correction is not None:
            own = {
                **own,
                "correction": inverse(moments(scene, fluid, references, columns, placed, lists, forward_mode)),
            }
        totals: dict[str, Any] = {}
        for other, neighbors in partners(scene, fluid, lists):
            same, wall = other is fluid, not isinstance(other, Fluid)
            if wall:
                senders = wall_in_forces(fluid, other, references, placed, walls[other.name])
            else:
                senders = own if same else fields[other.name]
            force_of, active = pair_force(scene, fluid, other)

            def of_pair(a, b, pair, force_of: Any = force_of, wall: bool = wall, same: bool = same) -> dict:
                force, seen = force_of(a, b, pair)
                sums = {"force": force}
                if shifting is not None:
                    if carry:
                        beside = {**b, "shift": a["shift"]} if wall else b
                        sums["carried"] = shifting.carried(a, beside, seen - a["velocity"], pair)
                    sums["crowding"] = shifting.crowding(a, b, pair)
                if covered:
                    volumes = a["volume"] * b["volume"]
                    sums["cover"] = -volumes * dot(pair.offset, pair.gradient) / scene.dimension
                    if outward:
                        sums["normal"] = volumes * pair.gradient
                if delta is not None and same:
                    volumes = a["volume"] * b["volume"]
                    # symmetric, since the kernel's gradient points along the pair
                    sums["moment"] = upper(-volumes * pair.gradient[:, None] * pair.offset[None, :])
                    sums["density_gradient"] = volumes * (b["density"] - a["density"]) * pair.gradient
                return sums

            symmetry = None
            if same:
                symmetry = {"force": -1}
                if shifting is not None:
                    symmetry |= {"crowding": -1} | ({"carried": 1} if carry else {})
                symmetry |= ({"cover": 1} if covered else {}) | ({"normal": -1} if outward else {})
                symmetry |= {"moment": 1, "density_gradient": 1} if delta is not None else {}
                opposite = scene.density.symmetric and correction is None and all(e.symmetric for e in active)
                symmetry = symmetry if opposite else None
            thin = references[other.name].thin if wall else None
            part = over_pairs(scene, fluid, of_pair, own, senders, neighbors, symmetry, forward_mode, thin)  # pyright: ignore
            totals = {name: totals.get(name, 0.0) + part.get(name, 0.0) for name in {**totals, **part}}
        out[fluid.name] = _finish(scene, fluid, own, totals, outside, shifting, delta, time)
        fields[fluid.name] = own
    for solid in scene.solids:
        force = _on_solid(scene, solid, references, fields, placed, walls, lists, forward_mode)
        ready = references[solid.name]
        out[solid.name] = {"surface_acceleration": ready.moving * force / ready.mass}
    return out


def pair_force(scene, fluid, other):
    """The force between a fluid and a partner, force(a, b, pair) -> force on a [N, in 2D per meter], velocity of b.

    b has the velocity with which a sees it: at a wall to which it sticks that of the slip. Second, the effects in it.
    """
    wall = not isinstance(other, Fluid)
    viscous = fluid.viscosity is not None and (other.no_slip if wall else other.viscosity is not None)
    effects = [effect for effect in scene.flow_effects if effect.force is not None]
    active = [effect for effect in effects if kind_of(other) in effect.partners]
    correction = scene.effect(KernelGradientCorrection)
    push = (scene.density if correction is None else correction).pressure_force

    def force_of(a, b, pair):
        if wall and "pressure" not in b:
            b = {**b, "pressure": other.pressure.of_pair(a["pressure"])}
        force = push(a, b, pair.gradient)
        seen = b["velocity"]
        if viscous:
            if wall:
                seen = b["slip"]
            sticking = {**b, "velocity": seen, "viscosity": b.get("viscosity", a["viscosity"])}
            force = force + fluid.viscosity_law.force(a, sticking, pair)
        for effect in active:
            force = force + effect.force(a, b, pair)
        return force, seen

    return force_of, active


def _on_solid(scene, solid, references, fields, placed, walls, lists, forward_mode):
    """Force (d, N) [N, in 2D per meter] on the particles of a solid: that on the fluids, with roles exchanged."""
    total: Any = 0.0
    for fluid in scene.fluids:
        receivers = wall_in_forces(fluid, solid, references, placed, walls[solid.name])
        force_of, _ = pair_force(scene, fluid, solid)

        def of_pair(a, b, pair, force_of: Any = force_of):
            seen_from_fluid = pair._replace(offset=-pair.offset, gradient=-pair.gradient)
            return -force_of(b, a, seen_from_fluid)[0]

        neighbors = lists[f"{fluid.name}-{solid.name}"].transposed()
        thin = references[solid.name].thin
        senders = fields[fluid.name]
        total = total + over_pairs(scene, fluid, of_pair, receivers, senders, neighbors, None, forward_mode, thin)
    return total


def _finish(scene, fluid, own, totals, outside, shifting, delta, time):
    """From the sums to what the step needs."""
    volume = own["mass"] / own["density"]
    acceleration = totals["force"] / own["mass"] + jnp.asarray(scene.gravity)[:, None]
    if "carried" in totals:
        acceleration = acceleration + totals["carried"] / volume
    for effect in outside:
        acceleration = acceleration + effect.acceleration(own["position"], time)
    done = {"acceleration": acceleration}
    if shifting is not None:
        crowding = totals["crowding"] / volume
        done["shift"] = shifting.velocity(
            crowding,
            fluid,
            scene.smoothing_length,
            scene.kernel.support_radius(scene.smoothing_length),
            cover=totals["cover"] / volume if shifting.free_surface else None,
            normal=totals["normal"] if shifting.free_surface else None,
        )
    if scene.effect(TensileControl) is not None:
        done["cover"] = totals["cover"] / volume
    if delta is not None:
        done["density_gradient"] = corrected(symmetric(totals["moment"]), totals["density_gradient"])
    return done


def corrected(moment, uncorrected):
    """M^-1 times a raw gradient (d, N), M (d, d, N); zero where a particle has too few neighbors for an inverse."""
    d = moment.shape[0]
    size = sum(moment[i, i] for i in range(d)) / d
    scaled = moment / jnp.where(size > 0, size, 1.0)
    identity = jnp.eye(d, dtype=moment.dtype)[:, :, None]
    good = (size > 0) & (determinant(scaled) > 0.05)
    safe = jnp.where(good, scaled, identity)
    raw = uncorrected / jnp.where(size > 0, size, 1.0)
    return jnp.where(good, jnp.sum(inverse(safe) * raw[None], axis=1), 0.0)
