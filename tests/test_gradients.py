"""Gradients through a hundred steps: forward and reverse mode against finite differences, for every kind of number.

Each case compiles its loss, its gradient and its tangent once, for all its unknowns together.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import beam

import jaxsph as sph
from jaxsph import pytree

STEPS, SAVES = 100, 5
SVK, NEO_HOOKEAN = sph.StVenantKirchhoff(), sph.NeoHookean()
RAISED_IN_JIT = (RuntimeError, ValueError)  # as one or the other jax hands on what a callback raised
UNKNOWNS = [
    "beam.youngs_modulus",
    "beam.poisson_ratio",
    "beam.density",
    "beam.velocity",
    "gravity",
    "PenaltyForce.coefficient",
    "beam.particles.positions",
    "beam.smoothing_length",
]


def block_in_3d(law):
    """A cantilever of 3 x 3 particles across and 45 in all."""
    body = sph.box((0, 0, 0), (0.04, 0.02, 0.02), 0.01, on_surface=True)
    body = sph.Structure(
        "beam", body, density=1000.0, youngs_modulus=1e6, poisson_ratio=0.3, law=law,
        clamped=lambda x: x[:, 0] < 0.015, velocity=(0.0, 0.3, 0.1),
    )  # fmt: skip
    return sph.Scene(body, gravity=(0.0, -5.0, 2.0), effects=[sph.PenaltyForce(0.05)])


def beam_in_2d(law):
    scene = beam()
    return pytree.replace(scene, systems=(pytree.replace(scene["beam"], law=law, velocity=np.array([0.1, 0.3])),))


class Case:
    """A scene, and a loss of what its unknowns are multiplied by (positions: of how much they are sheared)."""

    def __init__(self, scene):
        self.scene = scene
        self.dt = 0.8 * sph.stable_time_step(scene)
        self.found = sph.topologies(scene)
        self.gradient = jax.jit(jax.value_and_grad(self.of()))
        self.value_and_slope = jax.jit(lambda x, dx: jax.jvp(self.of(mode="forward"), (x,), (dx,)))
        self.start = dict.fromkeys(UNKNOWNS, 1.0)

    def values(self, x):
        values = {}
        for name, factor in x.items():
            value = jnp.asarray(self.scene.get(name))
            if name.endswith("positions"):
                # bent, so that distances and volumes' weights change differently everywhere
                value = value + (factor - 1) * jnp.roll(jnp.sin(100 * value), 1, axis=1) * 0.01
                values[name] = value
            else:
                values[name] = factor * value
        return values

    def of(self, **options):
        def loss(x):
            scene = self.scene.replace(self.values(x))
            end, every = STEPS * self.dt, STEPS // SAVES * self.dt
            run = sph.simulate(scene, end, every, time_step=self.dt, topologies_of_scene=self.found, **options)
            fields = run["beam"]
            return 1e4 * jnp.sum(fields["displacement"] ** 2) + jnp.sum(fields["velocity"][..., 1] ** 3)

        return loss


@cache
def case_of(build, law):
    return Case(build(law))


@pytest.fixture(
    scope="module",
    params=[
        (beam_in_2d, SVK),
        (beam_in_2d, NEO_HOOKEAN),
        (block_in_3d, SVK),
    ],
    ids=["SvK 2D", "neo-Hookean 2D", "SvK 3D"],
)
def case(request):
    return case_of(*request.param)


def close(value, expected, tolerance=1e-6):
    assert abs(value - expected) <= tolerance * abs(expected), f"{value} is not {expected}"


def test_forward_reverse_and_finite_differences_agree(case):
    value, gradient = case.gradient(case.start)
    for name in UNKNOWNS:
        direction = {key: float(key == name) for key in UNKNOWNS}
        forward_value, forward = case.value_and_slope(case.start, direction)
        close(forward_value, value, 1e-10)  # the same steps, compiled apart

        def value_at(factor, name=name, direction=direction):
            return case.value_and_slope({**case.start, name: factor}, direction)[0]

        def slope(step, value_at=value_at):
            return float(value_at(1.0 + step) - value_at(1.0 - step)) / (2 * step)

        # Richardson: h^4 = 1e-14 times the fifth derivative (a phase of a few radians: some tens) is left of the
        # truncation; rounding of 1e-14 (a hundred steps) over h, 1e-11, of values that can be 1e3 times the slope.
        h = 3e-4
        difference = (4 * slope(h / 2) - slope(h)) / 3
        assert difference != 0, name
        close(float(gradient[name]), difference)
        close(float(forward), difference)
        close(float(forward), float(gradient[name]), 1e-8)  # the same derivative, summed forward and backward


@pytest.fixture(scope="module")
def case_2d():
    return case_of(beam_in_2d, SVK)


def test_two_levels_of_checkpoints_give_the_same_gradient(case_2d):
    some = {"beam.youngs_modulus": 1.0, "beam.density": 1.0}
    for name, value in jax.jit(jax.grad(case_2d.of(memory_budget=1)))(some).items():
        # the same operations, compiled apart
        close(value, case_2d.gradient(case_2d.start)[1][name], 1e-9)


@pytest.mark.slow
def test_batch_of_moduli(case_2d):
    factors = np.array([0.8, 0.9, 1.0])
    of_modulus = jax.value_and_grad(lambda e: case_2d.of()({"beam.youngs_modulus": e}))
    values, slopes = jax.jit(jax.vmap(of_modulus))(factors)
    for factor, value, slope in zip(factors, values, slopes, strict=True):
        expected, gradient = case_2d.gradient({**case_2d.start, "beam.youngs_modulus": factor})
        # the same operations, vectorized in another way
        close(value, expected, 1e-9)
        close(slope, gradient["beam.youngs_modulus"], 1e-9)


def test_a_step_that_is_too_large_raises_inside_jit_and_grad(case_2d):
    """The step is .8 of the stable one at the modulus it was made for, and 1.13 times that of twice the modulus."""
    stiff = {**case_2d.start, "beam.youngs_modulus": 2.0}
    for run in (case_2d.gradient, lambda x: case_2d.value_and_slope(x, case_2d.start)):
        with pytest.raises(RAISED_IN_JIT, match="time step is larger than the largest stable one"):
            jax.block_until_ready(run(stiff))
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(run(case_2d.start))]
        assert all(np.all(np.isfinite(leaf)) for leaf in leaves), "the next call is not spoiled"


def test_a_run_that_blows_up_raises_inside_grad():
    """Neo-Hookean stress is not defined inside out: the velocity turns particles over within some steps."""
    case = case_of(beam_in_2d, NEO_HOOKEAN)
    with pytest.raises(RAISED_IN_JIT, match="a field became infinite or not a number"):
        jax.block_until_ready(case.gradient({**case.start, "beam.velocity": 1e5}))
