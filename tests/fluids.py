"""Small fluids that several tests use, and the sums of a fluid written as plain loops over all pairs in NumPy."""

from functools import partial
from typing import Any

import jax
import numpy as np

import jaxsph as sph
from jaxsph.dynamics import place_boundaries, positions_of, prepare
from jaxsph.flow import density_rates, forces, pressure, summed_deviations, wall_states
from jaxsph.geometry import box, jitter, tank
from jaxsph.pytree import replace
from jaxsph.state import to_columns, to_rows
from jaxsph.surroundings import rebuild

CELLS = {2: 10, 3: 7}
SMOOTHING = {2: 0.12, 3: 0.145}  # 1.2 and 1.0 spacings; three supports with their skins fit into the period


def periodic(d=2, effects=(), density=None, two=False, law=None, periodic=True, seed=3, **changes: Any) -> sph.Scene:
    """Disordered particles in the unit square or cube; as two fluids, of unlike numbers, side by side."""
    particles = jitter(box((0,) * d, (1,) * d, 1 / CELLS[d]), 0.2, seed)
    about: dict[str, Any] = {"density": 1.3, "sound_speed": 9.0, "viscosity": 0.4, **changes}
    law = sph.MorrisViscosity() if law is None else law
    left = particles.positions[:, 0] < 0.5
    if two:
        systems = (
            sph.Fluid("water", particles.where(left), **about, viscosity_law=law),
            sph.Fluid("oil", particles.where(~left), 0.7, 14.0, 0.9, viscosity_law=law),
        )
    else:
        systems = (sph.Fluid("water", particles, **about, viscosity_law=law),)
    return sph.Scene(
        *systems,
        effects=effects,
        density=density,
        smoothing_length=SMOOTHING[d],
        domain=sph.Domain((0,) * d, (1,) * d, True) if periodic else None,
    )


def stirred(scene: sph.Scene, speed=1.0, spread=0.03, seed=5) -> sph.State:
    """The initial state with velocities and densities at random; whatever else particles remember too."""
    rng, state = np.random.default_rng(seed), sph.initial_state(scene)
    systems = {name: dict(fields) for name, fields in state.systems.items()}
    for name, fields in systems.items():
        for field, value in fields.items():
            noise = rng.uniform(-1, 1, value.shape)
            if field == "density_deviation":
                systems[name][field] = spread * noise * np.asarray(scene.fluids[0].density)
            elif field in ("velocity", "shift", "density_gradient") and scene[name] in scene.fluids:
                systems[name][field] = speed * noise
    return replace(state, systems=systems)


@partial(jax.jit, static_argnames="forward_mode")
def sums(scene, found, systems, time=0.0, forward_mode=False):
    """What `jaxsph.flow` makes of a state: rates of the density, forces, summed densities, and states of the walls.

    By system, particle first and in the user's order; summed densities replace those of the state, as in a step.
    """
    references, columns = prepare(scene, found), to_columns(systems, found)
    placed = place_boundaries(scene, references, columns, time)
    lists = rebuild(scene, found, positions_of(scene, columns, placed))
    summed = summed_deviations(scene, references, columns, placed, lists, forward_mode=forward_mode)
    columns = {k: {**v, **({"density_deviation": summed[k]} if k in summed else {})} for k, v in columns.items()}
    rates: dict[str, Any] = {}
    if not scene.density.summed:
        rates = density_rates(scene, references, columns, placed, lists, forward_mode=forward_mode)
    pressures = {fluid.name: pressure(fluid, columns[fluid.name]) for fluid in scene.fluids}
    walls = wall_states(scene, references, columns, placed, pressures, lists, time, forward_mode=forward_mode)
    out = forces(scene, references, columns, placed, lists, time, forward_mode=forward_mode)
    out = {name: dict(out.get(name, {})) | walls.get(name, {}) for name in columns}
    for name in columns:
        out[name] |= {"rate": rates[name]} if name in rates else {}
        out[name] |= {"summed": summed[name]} if name in summed else {}
    return to_rows(out, found)


def together(scene, systems, out):
    """All particles of all fluids one after the other: what the state holds, and `out` of `sums`."""
    fields: dict[str, list] = {}
    for fluid in scene.fluids:
        n, state = fluid.n_particles, systems[fluid.name]
        rho = fluid.density + np.asarray(state["density_deviation"])
        mine = {
            **{key: np.asarray(value) for key, value in state.items()},
            "rho": rho,
            "m": np.broadcast_to(fluid.mass(), n),
            "p": np.asarray(fluid.state_equation.pressure(rho - fluid.density, fluid.density, fluid.sound_speed)),
            "mu": np.full(n, float(fluid.viscosity)),
            **{f"got_{key}": np.asarray(value) for key, value in out[fluid.name].items()},
        }
        for key, value in mine.items():
            fields.setdefault(key, []).append(value)
    return {key: np.concatenate(values) for key, values in fields.items()}


class AllPairs:
    """Geometry of all pairs (N, M): of receivers at x (N, d) and senders at y (M, d), with the kernel Wendland C2.

    W = k (1 - q/2)^4 (1 + 2 q) with q = r / h, and F = W' / r = -5 k (1 - q/2)^3 / h^2.
    """

    def __init__(self, x, y, h, period=None):
        d = x.shape[1]
        self.offset = x[:, None] - y[None]
        if period is not None:
            self.offset = self.offset - period * np.round(self.offset / period)
        self.squared = np.sum(self.offset**2, axis=-1)
        q = np.sqrt(self.squared) / h
        norm = 7 / (4 * np.pi * h**2) if d == 2 else 21 / (16 * np.pi * h**3)
        inside = q < 2
        if x is y:
            inside &= ~np.eye(len(x), dtype=bool)
        self.w = np.where(inside, norm * (1 - q / 2) ** 4 * (1 + 2 * q), 0.0)
        self.w_at_zero, self.w_at = norm, lambda r: norm * (1 - r / h / 2) ** 4 * (1 + 2 * r / h)
        self.f = np.where(inside, -5 * norm / h**2 * (1 - q / 2) ** 3, 0.0)
        self.gradient = self.f[..., None] * self.offset


def assert_equal(got, expected, tolerance=1e-12):
    """Equal to within a tolerance of the largest: some thirty terms in another order, a rounding of 2e-16 each."""
    assert np.max(np.abs(expected)) > 0
    np.testing.assert_allclose(got, expected, rtol=0, atol=tolerance * np.max(np.abs(expected)))


def column(kind: Any = np.float64, domain=((-1, -1), (2, 2)), velocity=(0.5, 0.0), effects=None, **about: Any):
    """Water of 6 x 6 particles in the corner of a wider tank."""
    particles = jitter(box((0, 0), (0.3, 0.3), 0.05, dtype=kind), 0.05, 2)
    wall = {key: about.pop(key) for key in ("motion", "pressure") if key in about}
    about = {"density": 1000.0, "sound_speed": 20.0, "viscosity": 1.0, "velocity": velocity, **about}
    water = sph.Fluid("water", particles, **about)
    basin = sph.Wall("tank", tank((0, 0), (0.6, 0.3), 0.05, 3, dtype=kind), **wall)
    effects = [sph.DeltaDiffusion(0.1)] if effects is None else effects
    return sph.Scene(water, basin, gravity=(0.0, -9.81), effects=effects, domain=sph.Domain(*domain))
