"""Cantilever beams."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxsph.effects import PenaltyForce
from jaxsph.geometry import Particles, clamped_strip
from jaxsph.pytree import replace
from jaxsph.scene import Scene
from jaxsph.structure import Structure

CYLINDER_RADIUS = 0.05  # m, of Turek and Hron: their beam grows out of it


def cantilever(
    length: float,
    thickness: float,
    particles: int = 9,
    *,
    density: float,
    youngs_modulus: float,
    poisson_ratio: float,
    gravity: Sequence[float] = (0.0, 0.0),
    penalty: float = 0.05,
    effects: Sequence = (),
    name: str = "beam",
    dtype=None,
) -> Scene:
    """A beam along x, clamped at the face x = 0, its middle at y = 0.

    Args:
        length, thickness: [m]. The spacing along x is stretched to fit the length.
        particles: across the thickness, the outermost on the surfaces; the spacing is thickness / (particles - 1).
        density, youngs_modulus, poisson_ratio: [kg/m^3], [Pa], [1].
        gravity: [m/s^2].
        penalty: coefficient of the `PenaltyForce`; 0 leaves it out.
        effects: further effects.
        name: of the structure.
        dtype: float32 or float64; None takes jax's default.

    The outermost clamped column lies half a spacing in front of the face, see `clamped_strip`; three more behind it
    are clamped too, so that it sees a body on both sides.

    Raises ValueError for fewer than 3 particles across, or what `clamped_strip` refuses.
    """
    if particles < 3:
        raise ValueError(f"particles = {particles} across the thickness; a bending beam needs at least 3")
    body = clamped_strip(length, thickness, particles, dtype=dtype)
    structure = Structure(
        name,
        body,
        density=density,
        youngs_modulus=youngs_modulus,
        poisson_ratio=poisson_ratio,
        clamped=lambda x: x[:, 0] < body.spacing,
    )
    listed = [*effects, PenaltyForce(penalty)] if penalty else list(effects)
    return Scene(structure, gravity=np.asarray(gravity, float), effects=listed)


def turek_hron_beam(
    particles: int = 9,
    *,
    youngs_modulus: float = 1.4e6,
    gravity: float = 2.0,
    effects: Sequence = (),
    dtype=None,
) -> Scene:
    """The elastic beam behind the cylinder of Turek and Hron, alone, under its own weight.

    Length .35 m, thickness .02 m, density 1000 kg/m^3, Poisson ratio .4, gravity 2 m/s^2: CSM1 (E = 1.4e6 Pa)
    and CSM2 (5.6e6 Pa) are its static states, CSM3 its free motion at 1.4e6 Pa. The tip is at (.35, 0).

    S. Turek, J. Hron (2006), in Fluid-Structure Interaction, LNCSE 53, 371, doi:10.1007/3-540-34596-5_15.
    As there, the root follows the cylinder of radius .05 m: at the surfaces the beam is 1 mm longer than in the
    middle, which lowers its frequency by .5 %.
    """
    flat = cantilever(
        0.35,
        0.02,
        particles,
        density=1000.0,
        youngs_modulus=youngs_modulus,
        poisson_ratio=0.4,
        gravity=(0.0, -gravity),
        effects=effects,
        dtype=dtype,
    )
    beam = flat["beam"]
    return replace(flat, systems=(replace(beam, particles=_round_root(beam.particles, 0.35, CYLINDER_RADIUS)),))


def _round_root(particles: Particles, reach: float, radius: float) -> Particles:
    """Move the columns of a flat-faced beam so that the face lies on a circle around (-radius, 0).

    The columns behind the face go with it; those in front less and less, up to a distance `reach` [m].
    """
    x, y = np.asarray(particles.positions, float).T
    back = radius - np.sqrt(radius**2 - y**2)
    positions = np.stack([x - back * np.clip(1 - np.clip(x, 0, None) / reach, 0, None), y], axis=1)
    stretch = np.where((x > 0) & (x < reach), 1 + back / reach, 1.0)
    real = particles.positions.dtype
    volumes = (particles.volumes * stretch).astype(real)
    return dataclasses.replace(particles, positions=positions.astype(real), volumes=volumes)
