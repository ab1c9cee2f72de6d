"""Lengths from micrometers to kilometers: the same physics in any unit, in float32 too, or a refusal."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fluids import sums

import jaxsph as sph
from jaxsph.dynamics import prepare
from jaxsph.geometry import box, jitter
from jaxsph.stable_step import largest_stable


def brick(spacing, kind: Any = np.float32):
    return sph.Structure(
        "brick", box((0,) * 3, (3 * spacing,) * 3, spacing, on_surface=True, dtype=kind), 1e3, 1e6, 0.3
    )


@pytest.mark.parametrize("spacing", [1.0, 3e-4, 1e-6])
def test_correction_of_a_small_body(spacing):
    """Determinants of moments as small as volumes would be zero in float32, and the body wrong without a word."""
    single, double = (sph.Scene(brick(spacing, kind)) for kind in (np.float32, np.float64))
    found = [prepare(scene, sph.topologies(scene))["brick"].correction for scene in (single, double)]
    # the inverse of a matrix near the unit one, a few roundings of 6e-8
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=2e-6 * np.abs(found[1]).max())


@pytest.mark.parametrize("spacing", [1e-3, 1e-5])
def test_derivative_by_the_size_of_a_small_body(spacing):
    scene = sph.Scene(brick(spacing), gravity=(0, 0, -9.81))
    found, h = sph.topologies(scene), float(scene["brick"].smoothing_length)
    largest = lambda h: jnp.sum(  # noqa: E731
        prepare(scene.replace({"brick.smoothing_length": h}), found)["brick"].correction ** 2
    )
    slope = jax.jit(jax.grad(largest))(h) * h
    double = sph.Scene(brick(1.0, np.float64))
    at = float(double["brick"].smoothing_length)
    same = lambda h: jnp.sum(  # noqa: E731
        prepare(double.replace({"brick.smoothing_length": h}), sph.topologies(double))["brick"].correction ** 2
    )
    # what has no unit does not depend on the unit; cancellation leaves some hundred roundings of 6e-8
    np.testing.assert_allclose(slope, jax.grad(same)(at) * at, rtol=1e-4)


@pytest.mark.parametrize("radius", [0.1, 1e-3, 1e-4])
def test_a_small_ball_turns_as_a_large_one(radius):
    particles = sph.ball((0, 0, 0), radius, radius / 3, dtype=np.float32)
    ball = sph.RigidBody("ball", particles, 1000.0, angular_velocity=(1.0, 2.0, 3.0))
    scene = sph.Scene(ball)

    def turned(spin, density):
        changed = scene.replace({"ball.angular_velocity": spin * jnp.array([1.0, 2, 3]), "ball.density": density})
        run = sph.simulate(changed, 5e-4, time_step=1e-4)
        return jnp.sum(run.final.systems["ball"]["displacement"][:, 0] * particles.positions[:, 1]) / radius**2

    one, rho = np.float32(1.0), np.float32(1000.0)
    value, (by_spin, by_density) = jax.jit(jax.value_and_grad(turned, argnums=(0, 1)))(one, rho)
    # -W_z t sum y^2 and a share 1e-3 of it in t^2: linear in the spin, and mass drops out
    assert by_spin == pytest.approx(float(value), rel=5e-3)
    assert abs(by_density) * 1000 < 1e-3 * abs(value)


@pytest.mark.parametrize("spacing", [1e-2, 1e-6])
def test_stable_step_of_a_small_body(spacing):
    """Squares of the squares of its frequencies, 1e40 for steel in micrometers, are beyond float32."""
    steps = []
    for kind in (np.float32, np.float64):
        scene = sph.Scene(
            sph.Structure("block", box((0, 0), (4 * spacing,) * 2, spacing, dtype=kind), 7800.0, 2.1e11, 0.3)
        )
        steps.append(largest_stable(scene, sph.topologies(scene)))
    assert steps[0] == pytest.approx(steps[1], rel=1e-4)


def drop(spacing, kind: Any = np.float32):
    """A cube of disordered particles whose pressures and velocities do not depend on its size."""
    particles = jitter(box((0,) * 3, (5 * spacing,) * 3, spacing, dtype=kind), 0.1, 3)
    waves = lambda x: np.sin(2.1 * x / spacing)  # noqa: E731
    water = sph.Fluid("water", particles, 1000.0, 10.0, 1e-3, velocity=waves, pressure=lambda x: 500 * waves(x)[:, 1])
    return sph.Scene(water, effects=[sph.DeltaDiffusion(0.1), sph.ArtificialViscosity(0.1)])


def test_fluids_of_micrometers():
    found = []
    for kind in (np.float32, np.float64):
        scene = drop(2e-6, kind)
        found.append(sums(scene, sph.topologies(scene), sph.initial_state(scene).systems)["water"])
    # products of two volumes are 1e-34 here, of which every factor but the slope would lose digits
    for field in ("acceleration", "rate"):
        single, double = (np.asarray(fields[field], float) for fields in found)
        np.testing.assert_allclose(single, double, rtol=0, atol=1e-5 * np.abs(double).max())


@pytest.mark.parametrize("spacing", [1e-7, 1e5])
def test_what_float32_does_not_hold_is_refused(spacing):
    with pytest.raises(ValueError, match=r"forces of pairs of 'water' .* float32 loses digits .* dtype=float64"):
        drop(spacing)
    assert drop(spacing, np.float64).dtype == np.float64
