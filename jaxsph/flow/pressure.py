"""How the pressure evolves where it is a field of its own, and its mean around a particle."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxsph.effects import Shifting
from jaxsph.flow.pairs import fluid_fields, over_pairs, partners, pressure
from jaxsph.flow.walls import wall_in_forces, wall_states
from jaxsph.fluid import Fluid
from jaxsph.pair_sum import dot


def pressure_rates(scene, references, columns, placed, lists, *, time, forward_mode=False) -> dict:
    """Rates of the pressure [Pa/s] of all fluids at a time [s], (N,) each: of `EDAC`, and what shifts carry."""
    shifting = scene.effect(Shifting)
    pressures = {fluid.name: pressure(fluid, columns[fluid.name]) for fluid in scene.fluids}
    walls = wall_states(scene, references, columns, placed, pressures, lists, time, forward_mode=forward_mode)
    rates = {}
    for fluid in scene.fluids:
        own = {**fluid_fields(fluid, references[fluid.name], columns[fluid.name]), "pressure": pressures[fluid.name]}
        volume = own["mass"] / own["density"]
        rate = jnp.zeros_like(volume)
        for other, neighbors in partners(scene, fluid, lists):
            same, wall = other is fluid, not isinstance(other, Fluid)
            senders = own if same else _senders(fluid, other, references, columns, placed, pressures, walls)
            carry = shifting is not None and not shifting.free_surface and same
            # A sliding surface does not move the wall, see `wall_at_rest`.
            still = wall and not other.moves

            def of_pair(
                a, b, pair, other: Any = other, wall=wall, carry: Any = shifting if carry else None, still=still
            ):
                if wall and "pressure" not in b:
                    b = {**b, "pressure": other.pressure.of_pair(a["pressure"])}
                moving = dot(a["velocity"] if still else a["velocity"] - b["velocity"], pair.gradient)
                sums = {"divergence": a["volume"] * b["volume"] * moving}
                sums["flux"] = scene.density.pressure_flux(a, b, pair)
                if carry is not None:
                    sums["carried"] = carry.carried(a, b, b["pressure"] - a["pressure"], pair)
                return sums

            symmetry = {"divergence": 1, "flux": -1} | ({"carried": 1} if carry else {}) if same else None
            thin = references[other.name].thin if wall else None
            total = over_pairs(scene, fluid, of_pair, own, senders, neighbors, symmetry, forward_mode, thin)
            stiffness = own["density"] * fluid.sound_speed**2
            rate = rate + (stiffness * total["divergence"] + total["flux"] + total.get("carried", 0.0)) / volume
        rates[fluid.name] = rate
    return rates


def mean_pressures(scene, references, columns, placed, lists, pressures, walls, *, forward_mode=False) -> dict:
    """By fluid the mean pressure (N,) [Pa] around its particles, weighted with kernel and volume, itself included."""
    at_zero = scene.kernel.w(jnp.zeros(scene.dimension, scene.dtype), scene.smoothing_length)
    means = {}
    for fluid in scene.fluids:
        own = {**fluid_fields(fluid, references[fluid.name], columns[fluid.name]), "pressure": pressures[fluid.name]}
        weight = own["mass"] / own["density"] * at_zero
        total = weight * own["pressure"]
        for other, neighbors in partners(scene, fluid, lists):
            same, wall = other is fluid, not isinstance(other, Fluid)
            senders = own if same else _senders(fluid, other, references, columns, placed, pressures, walls)

            def of_pair(a, b, pair, other=other, wall=wall):
                asked = other.pressure.of_pair(a["pressure"]) if wall and "pressure" not in b else b["pressure"]
                return {"weight": b["volume"] * pair.value, "pressure": b["volume"] * pair.value * asked}

            part = over_pairs(scene, fluid, of_pair, own, senders, neighbors, None, forward_mode)
            weight, total = weight + part["weight"], total + part["pressure"]
        means[fluid.name] = total / weight
    return means


def _senders(fluid, other, references, columns, placed, pressures, walls):
    if isinstance(other, Fluid):
        fields = fluid_fields(other, references[other.name], columns[other.name])
        return {**fields, "pressure": pressures[other.name]}
    return wall_in_forces(fluid, other, references, placed, walls[other.name])


def keep_mean(scene, references, columns) -> dict:
    """Columns with pressures of the same mean over all fluids as at the start.

    Where `keep_volume` acts, and for its reason: without a free surface the mean pressure of shifted particles drifts,
    and a drifting pressure is noise in the force of disordered particles.
    """
    shifting = scene.effect(Shifting)
    if shifting is None or shifting.free_surface:
        return columns
    now = start = volume_now = volume_start = 0.0
    for fluid in scene.fluids:
        fields, volumes = columns[fluid.name], jnp.asarray(fluid.particles.volumes)
        volume = references[fluid.name].mass / (fluid.density + fields["density_deviation"])
        now, volume_now = now + jnp.sum(volume * fields["pressure"]), volume_now + jnp.sum(volume)
        initial = 0.0 if fluid.pressure is None else fluid.pressure
        start, volume_start = start + jnp.sum(volumes * initial), volume_start + jnp.sum(volumes)
    excess = now / volume_now - start / volume_start
    kept = {f.name: {**columns[f.name], "pressure": columns[f.name]["pressure"] - excess} for f in scene.fluids}
    return {**columns, **kept}
