"""How the density of fluids changes, and what it is where it is a sum over particles."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxsph.effects import Shifting
from jaxsph.flow.pairs import fluid_fields, kind_of, over_pairs, partners, wall_at_rest
from jaxsph.fluid import Fluid
from jaxsph.pair_sum import dot
from jaxsph.walls import WallContinuity, WallSummation


def density_rates(scene, references, columns, placed, lists, *, forward_mode=False) -> dict:
    """Rates of the density [kg/(m^3 s)] of all fluids, and of walls with a density of their own, (N,) each.

    placed: by wall its positions, velocities and accelerations, from `Wall.placed`.
    """
    effects = [effect for effect in scene.flow_effects if effect.density_flux is not None]
    shifting = scene.effect(Shifting)
    rates = {}
    for fluid in scene.fluids:
        own = fluid_fields(fluid, references[fluid.name], columns[fluid.name])
        divergence: Any = 0.0
        flux: Any = 0.0
        for other, neighbors in partners(scene, fluid, lists):
            same, wall = other is fluid, not isinstance(other, Fluid)
            if wall:
                senders = wall_at_rest(fluid, other, references, placed)
            else:
                senders = own if same else fluid_fields(other, references[other.name], columns[other.name])
            # Not between two fluids: the jump of their rest densities is none that diffusion may level.
            active = [effect for effect in effects if (same or wall) and kind_of(other) in effect.partners]

            carry = shifting is not None and not shifting.free_surface and same

            def of_pair(a, b, pair, active: list = active, carry: Any = shifting if carry else None) -> dict:
                moving = dot(a["velocity"] - b["velocity"], pair.gradient)
                out = {"divergence": scene.density.divergence(a, b, moving)}
                if carry is not None:
                    out["carried"] = carry.carried(a, b, b["density"] - a["density"], pair)
                fluxes = [effect.density_flux(a, b, pair) for effect in active]
                return out | ({"flux": sum(fluxes)} if fluxes else {})

            symmetry = None
            if same:
                symmetry = {"divergence": 1} | ({"flux": -1} if active else {}) | ({"carried": 1} if carry else {})
            thin = references[other.name].thin if wall else None
            total = over_pairs(scene, fluid, of_pair, own, senders, neighbors, symmetry, forward_mode, thin)  # pyright: ignore
            divergence = divergence + total["divergence"]
            flux = flux + total.get("flux", 0.0) + total.get("carried", 0.0)
        volume = own["mass"] / own["density"]
        rates[fluid.name] = scene.density.of_divergence(divergence, own["density"], volume) + flux / volume
    for wall in scene.boundaries:
        if isinstance(wall.pressure, WallContinuity):
            rates[wall.name] = _wall_rate(scene, wall, references, columns, placed, lists, forward_mode)
    return rates


def _wall_rate(scene, wall, references, columns, placed, lists, forward_mode):
    total = 0.0
    for fluid in scene.fluids:
        own = wall_at_rest(fluid, wall, references, placed)
        senders = fluid_fields(fluid, references[fluid.name], columns[fluid.name])
        neighbors = lists[f"{fluid.name}-{wall.name}"].transposed()

        def of_pair(a, b, pair, fluid=fluid):
            return fluid.density * b["volume"] * dot(a["velocity"] - b["velocity"], pair.gradient)

        thin = references[wall.name].thin
        total = total + over_pairs(scene, fluid, of_pair, own, senders, neighbors, None, forward_mode, thin)
    return total


def summed_deviations(scene, references, columns, placed, lists, *, forward_mode=False) -> dict:
    """Densities as sums over particles, equation (5), less the rest density [kg/m^3].

    Of the fluids whose density is summed, and of walls whose pressure follows from such a sum.
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
                senders = wall_at_rest(fluid, other, references, placed)
            of_pair = lambda a, b, pair: scene.density.summed_mass(a, b) * pair.value  # noqa: E731
            total = total + over_pairs(scene, fluid, of_pair, own, senders, neighbors, None, forward_mode)
        out[fluid.name] = total - fluid.density
    for wall in scene.boundaries:
        if isinstance(wall.pressure, WallSummation):
            fluid = scene.fluids[0]  # the only one: it gives the wall its rest density
            own = wall_at_rest(fluid, wall, references, placed)
            total = own["mass"] * at_zero + over_pairs(
                scene, fluid, lambda a, b, pair: b["mass"] * pair.value, own, own, lists[f"{wall.name}-{wall.name}"]
            )
            for other in scene.fluids:
                senders = fluid_fields(other, references[other.name], columns[other.name])
                neighbors = lists[f"{other.name}-{wall.name}"].transposed()
                of_pair = lambda a, b, pair: b["mass"] * pair.value  # noqa: E731
                total = total + over_pairs(scene, fluid, of_pair, own, senders, neighbors, None, forward_mode)
            out[wall.name] = total - fluid.density
    return out


def keep_volume(scene, references, columns) -> dict:
    """Columns with densities such that all fluids together fill the volume that they filled at the start.

    Only where particles are shifted and there is no free surface. Shifted particles do not follow the flow, so that the
    sum of their volumes m / rho drifts; in a closed domain the pressure then sinks until the fluid tears.
    """
    shifting = scene.effect(Shifting)
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


def filtered(scene, references, columns, lists, *, forward_mode=False) -> dict:
    """Columns with the densities of `ShepardFilter`: the mean deviation of the neighbors, weighted with V W."""
    at_zero = scene.kernel.w(jnp.zeros(scene.dimension, scene.dtype), scene.smoothing_length)
    out = dict(columns)
    for fluid in scene.fluids:
        own = fluid_fields(fluid, references[fluid.name], columns[fluid.name])
        deviation = columns[fluid.name]["density_deviation"]

        def of_pair(a, b, pair):
            weight = b["volume"] * pair.value
            return {"weight": weight, "total": weight * b["deviation"]}

        fields = {name: own[name] for name in ("position", "mass", "density")} | {"deviation": deviation}
        neighbors = lists[f"{fluid.name}-{fluid.name}"]
        sums = over_pairs(scene, fluid, of_pair, fields, fields, neighbors, None, forward_mode)
        self_weight = own["mass"] / own["density"] * at_zero
        mean = (sums["total"] + self_weight * deviation) / (sums["weight"] + self_weight)
        out[fluid.name] = {**columns[fluid.name], "density_deviation": mean}
    return out
