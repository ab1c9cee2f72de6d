"""What a pair of a fluid is made of: its geometry, the fields of both particles, and the sum over all pairs."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxsph.fluid import Fluid
from jaxsph.pair_sum import dot, pair_sum
from jaxsph.pytree import pytree_dataclass
from jaxsph.walls import Wall


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
    value_at: Any = None
    """W as a function of a distance in particle spacings."""


@pytree_dataclass
class FluidReference:
    """What of a fluid does not change during a run: mass, one number or (N,) in cell order [kg]."""

    mass: Any


@pytree_dataclass
class WallReference:
    """What of a wall does not change: positions at t = 0 (d, N) [m] and volumes of cells, one number or (N,) [m^d].

    thin: a `ThinWall`, or None.
    """

    positions: Any
    cells: Any
    thin: Any = None

    @property
    def volume(self):
        """That with which it takes part in contact: of cells too."""
        return self.cells


def fluid_fields(fluid: Fluid, reference: FluidReference, columns: dict) -> dict:
    """The fields of a fluid that its pairs are made of, (..., N), and numbers that all of it shares."""
    density = fluid.density + columns["density_deviation"]
    fields = {"position": columns["position"], "velocity": columns["velocity"], "density": density}
    fields["mass"], fields["sound_speed"] = reference.mass, fluid.sound_speed
    for name in ("shift", "density_gradient", "cover"):
        if name in columns:
            fields[name] = columns[name]
    if fluid.viscosity is not None:
        fields["viscosity"] = fluid.viscosity
    return fields


def pressure(fluid: Fluid, columns: dict):
    """Pressure (N,) [Pa] of a fluid: of the state, or from the equation of state."""
    if "pressure" in columns:
        return columns["pressure"]
    return fluid.state_equation.pressure(columns["density_deviation"], fluid.density, fluid.sound_speed)


def over_pairs(
    scene, fluid, of_pair: Any, receivers, senders, neighbors, symmetry: Any = None, forward_mode=False, thin=None
) -> Any:
    """Sum of_pair(a, b, pair) where a and b have all their fields.

    What a system shares, a number or a field (..., 1), is not gathered.

    thin: of the boundary among the two, which is thinner than the support radius.
    """
    kernel, h = scene.kernel, scene.smoothing_length

    def value_at(spacings):
        return kernel.w(jnp.zeros(scene.dimension, scene.dtype).at[0].set(spacings * scene.spacing), h)

    at_spacing = value_at(1.0)
    (varying_a, uniform_a), (varying_b, uniform_b) = _split(receivers), _split(senders)
    if receivers is senders:
        varying_b = varying_a

    def physics(a, b):
        a, b = _whole(uniform_a, a), _whole(uniform_b, b)
        offset = scene.displacement(a["position"], b["position"])
        slope, value = kernel.gradient_factor(offset, h), kernel.w(offset, h)
        squared = dot(offset, offset)
        if thin is not None:
            slope = slope + thin.slope(squared, h)
        speed = 0.5 * (a.get("sound_speed", fluid.sound_speed) + b.get("sound_speed", fluid.sound_speed))
        pair = Pair(offset, squared, slope, slope * offset, value, at_spacing, h, speed, value_at)
        return of_pair(a, b, pair)

    return pair_sum(physics, varying_a, varying_b, neighbors, symmetry=symmetry, forward_mode=forward_mode)


def _split(fields):
    if "volume" not in fields and jnp.ndim(fields.get("density", 0.0)) and jnp.ndim(fields.get("mass", 0.0)):
        # gathered from each neighbor instead of mass and density, where only their quotient is asked for
        fields = {**fields, "volume": fields["mass"] / fields["density"]}
    several = fields["position"].shape[-1] > 1
    varying = {k: v for k, v in fields.items() if jnp.ndim(v) and not (several and v.shape[-1] == 1)}
    shared = {k: v for k, v in fields.items() if k not in varying}
    return varying, {k: v[..., 0] if jnp.ndim(v) else v for k, v in shared.items()}


def _whole(uniform, fields):
    fields = {**uniform, **fields}
    if "density" in fields and "volume" not in fields:
        fields["volume"] = fields["mass"] / fields["density"]
    return fields


def kind_of(system) -> str:
    """What a system is to a fluid: "fluid", "wall" or "solid"; see `FlowEffect.partners`."""
    if isinstance(system, Fluid):
        return "fluid"
    return "wall" if isinstance(system, Wall) else "solid"


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
    for wall in scene.boundaries:
        yield wall, lists[f"{fluid.name}-{wall.name}"]


def motion_of(wall, placed):
    """Positions (d, N), velocities and accelerations of a boundary; what all of it shares, such as rest, is (d, 1)."""
    position, velocity, acceleration = placed[wall.name]
    if not wall.moves:
        velocity = velocity[:, :1]
    if not (isinstance(wall, Wall) and wall.moves):
        acceleration = acceleration[:, :1]  # of structures it counts as zero
    return position, velocity, acceleration


def wall_at_rest(fluid, wall, references, placed):
    """A wall as a fluid meets it in the density's rate: with its own velocity and the rest density.

    A sliding surface does not move the wall: its velocity would let a corner breathe.
    """
    position, velocity, _ = motion_of(wall, placed)
    velocity = velocity if wall.moves else jnp.zeros_like(velocity)
    fields = {"position": position, "velocity": velocity}
    volume = references[wall.name].cells
    fields["mass"] = fluid.density * volume
    fields["density"] = fluid.density
    if jnp.ndim(volume):
        fields["density"] = jnp.broadcast_to(fluid.density, volume.shape)
    return fields
