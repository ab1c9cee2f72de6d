"""Gradients through a hundred steps of a fluid: forward and reverse mode against finite differences.

Of a vortex in a periodic box and of a column of water that falls apart in a tank, for every way to get the density and
every effect that is smooth. `ArtificialViscosity` is not: it acts on approaching pairs, its derivative jumps where a
pair turns around, and a finite difference across such a turn is the mean of two slopes. Nor are wall pressures that are
clipped at zero.
"""

import fluids
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph.geometry import box, jitter, tank

STEPS, SAVES = 100, 5
CASES = {
    "volume and diffusion": (sph.ContinuityDensity(), [sph.DensityDiffusion(0.1)]),
    "mass and shifting": (sph.ContinuityDensity("mass"), [sph.ParticleShifting(1.0, 0.2)]),
    "sum": (sph.SummationDensity(), []),
}


def vortex(density, effects):
    """A Taylor-Green vortex of 12 x 12 disordered particles at Re = 100, under a force."""
    particles = jitter(box((0, 0), (1, 1), 1 / 12), 0.1, 2)

    def velocity(x):
        x, y = 2 * np.pi * x.T
        return np.stack([-np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)], axis=1)

    water = sph.Fluid("water", particles, 1.0, 10.0, viscosity=0.01, velocity=velocity)
    domain = sph.Domain((0, 0), (1, 1), periodic=True)
    return sph.Scene(water, gravity=(0.3, -0.5), effects=effects, density=density, smoothing_length=0.1, domain=domain)


def column(density, effects):
    """Water of 8 x 8 disordered particles in the corner of a tank twice as wide, with a shear; all sticks."""
    spacing = 0.05
    particles = jitter(box((0, 0), (0.4, 0.4), spacing), 0.1, 2)
    water = sph.Fluid(
        "water",
        particles,
        1000.0,
        20.0,
        viscosity=1.0,
        velocity=lambda x: np.stack([1.0 + x[:, 1], 0.5 * x[:, 0]], axis=1),
        pressure=lambda x: 9810 * (0.4 - x[:, 1]),
        state_equation=sph.Cole(7.0),
    )
    walls = sph.Wall("tank", tank((0, 0), (0.8, 0.4), spacing, 3))
    domain = sph.Domain((-1, -1), (2, 2))
    return sph.Scene(water, walls, gravity=(0.0, -9.81), effects=effects, density=density, domain=domain)


UNKNOWNS = ["water.viscosity", "water.density", "water.sound_speed", "water.velocity", "gravity"]


class Case:
    """A scene, and a loss of what its unknowns are multiplied by."""

    def __init__(self, scene):
        self.scene, self.found = scene, sph.topologies(scene)
        self.dt = 0.6 * sph.stable_time_step(scene)
        self.gradient = jax.jit(jax.value_and_grad(self.of()))
        forward = self.of(mode="forward")
        self.value_and_slope = jax.jit(lambda x, dx: jax.jvp(forward, (x,), (dx,)))
        self.start = dict.fromkeys(UNKNOWNS, 1.0)

    def of(self, **options):
        def loss(x):
            scene = self.scene.replace({name: factor * self.scene.get(name) for name, factor in x.items()})
            end, every = STEPS * self.dt, STEPS // SAVES * self.dt
            run = sph.simulate(
                scene,
                end,
                every,
                time_step=self.dt,
                topologies_of_scene=self.found,
                max_speed=4.0,
                **options,
            )
            final = run.final.systems["water"]
            density = final["density_deviation"] / self.scene["water"].density
            return (
                jnp.sum(final["position"][:, 0] ** 2) + jnp.sum(final["velocity"][:, 1] ** 3) + 1e3 * jnp.sum(density)
            )

        return loss


def relative(value, expected):
    return abs(float(value) - float(expected)) / abs(float(expected))


def check(case):
    value, gradient = case.gradient(case.start)
    for name in UNKNOWNS:
        direction = {key: float(key == name) for key in UNKNOWNS}
        forward_value, forward = case.value_and_slope(case.start, direction)
        assert relative(forward_value, value) < 1e-10, "the same steps, compiled apart"
        # the same derivative, summed forward and backward through a hundred steps
        assert relative(forward, gradient[name]) < 1e-8, name

        def slope(step, name=name, direction=direction):
            ends = [case.value_and_slope({**case.start, name: 1 + s}, direction)[0] for s in (step, -step)]
            return float(ends[0] - ends[1]) / (2 * step)

        # Richardson: step^4 = 1e-14 times the fifth derivative is left of the truncation; rounding of 1e-13 of the
        # value (a hundred steps) over the step, 1e-9, of a value that can be 1e2 times the slope.
        step = 3e-4
        difference = (4 * slope(step / 2) - slope(step)) / 3
        assert difference != 0, name
        assert relative(forward, difference) < 1e-6, name


@pytest.mark.parametrize("which", CASES)
def test_vortex(which):
    check(Case(vortex(*CASES[which])))


def test_column_in_a_tank():
    """The pressure and the velocity that walls extrapolate, and free surfaces."""
    check(Case(column(sph.ContinuityDensity(), [sph.DeltaDiffusion(0.1)])))


@pytest.mark.parametrize("of", ["body force", "motion of a wall", "motion of a clamp"])
def test_numbers_inside_of_functions(of):
    """Body forces and motions are made of traced numbers where those are fitted; the scene does not show them."""
    beam = sph.box((0, 0), (0.2, 0.1), 0.05)

    def scene(a):
        if of == "motion of a wall":
            push = lambda t, x: jnp.stack([a * jnp.sin(20 * t) + 0 * x[:, 0], 0 * x[:, 1]], axis=1)  # noqa: E731
            return fluids.column(motion=push, effects=[])
        pull, swing = lambda x, t: 30 * a * x, lambda t, x: a * jnp.sin(50 * t) * jnp.ones_like(x)
        body = sph.Structure(
            "beam", beam, 1000.0, 1e5, 0.3, lambda x: x[:, 0] < 0.06, swing if of == "motion of a clamp" else None,
            smoothing_length=0.06,
        )  # fmt: skip
        return sph.Scene(body, effects=[sph.BodyForce(pull)] if of == "body force" else [])

    step = 0.5 * sph.stable_time_step(scene(0.05))
    name = scene(0.05).systems[0].name

    def loss(a):
        run = sph.simulate(scene(a), 10 * step, 10 * step, time_step=step, max_speed=3.0)
        return jnp.sum(run.final.systems[name]["velocity"][:, 0] ** 2)

    slopes = [jax.grad(loss)(0.05), jax.jit(jax.grad(loss))(0.05), jax.jvp(loss, (0.05,), (1.0,))[1]]
    difference = (loss(0.05 + 1e-5) - loss(0.05 - 1e-5)) / 2e-5
    # 1e-5^2 of the third derivative, and rounding of 1e-16 over the step
    np.testing.assert_allclose(slopes, difference, rtol=1e-6)
