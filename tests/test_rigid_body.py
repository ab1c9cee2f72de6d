"""Rigid bodies: free motion, what is conserved, precision, and what is refused."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph import observe
from jaxsph.rigid_body import as_rigid, moment, rigid_acceleration, rigid_drift, rigid_kick, rigid_reference, turn


def brick(kind: Any = np.float64, d=3, **about: Any):
    size = (0.3, 0.2, 0.1)[:d]
    about = {"density": 700.0, **about}
    return sph.RigidBody("brick", sph.box((1.0, 2.0, 3.0)[:d], size, 0.05, dtype=kind), **about)


def made_ready(body):
    ready = rigid_reference(body, np.arange(body.n_particles), None)
    fields = {"displacement": jnp.zeros_like(ready.positions), "velocity": body.initial_velocity().T}
    return ready, fields


@partial(jax.jit, static_argnames="steps")
def turned(ready, fields, time_step, steps):
    def step(fields, _):
        increment, velocity = rigid_drift(ready, fields, time_step)
        return {"displacement": fields["displacement"] + increment, "velocity": velocity}, velocity

    return jax.lax.scan(step, fields, length=steps)


def test_turn_is_a_rotation():
    rng = np.random.default_rng(0)
    offset = jnp.asarray(rng.normal(size=(3, 20)))
    for size in (1e-9, 1e-3, 1.0, 3.0):
        angle = rng.normal(size=3)
        angle = jnp.asarray(size * angle / np.linalg.norm(angle))
        after = offset + turn(angle, offset)
        np.testing.assert_allclose(after.T @ after, offset.T @ offset, atol=1e-14 * 20)
        np.testing.assert_allclose(angle @ after, angle @ offset, atol=1e-14)
    quarter = jnp.array([0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(jnp.eye(3) + turn(quarter, jnp.eye(3)), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


def test_free_body_keeps_momenta_shape_and_energy():
    """A brick that tumbles about its middle axis, which is unstable: 2,000 steps of .002 s, some six turns."""
    body = brick(velocity=(0.1, 0.2, -0.3), angular_velocity=(0.02, 9.0, 0.03))
    ready, start = made_ready(body)
    end, velocities = turned(ready, start, 0.002, 2000)
    mass, about = ready.mass, lambda f: ready.positions + f["displacement"]
    for measure in (
        lambda f: jnp.sum(mass * f["velocity"], axis=1),
        lambda f: moment(mass, about(f) - about(start).mean(axis=1, keepdims=True), f["velocity"]),
    ):
        before, after = np.asarray(measure(start)), np.asarray(measure(end))
        # a rounding of 1e-16 in each of 2,000 steps
        np.testing.assert_allclose(after, before, atol=2e-13 * np.abs(before).max())
    apart = lambda f: np.linalg.norm(np.asarray(about(f))[:, :, None] - np.asarray(about(f))[:, None], axis=0)  # noqa: E731
    np.testing.assert_allclose(apart(end), apart(start), atol=1e-13)
    energy = np.asarray(jnp.sum(mass * velocities**2, axis=(1, 2)))
    assert np.abs(energy / energy[0] - 1).max() < 2e-4  # second order: (9 x .002)^2
    spins = jax.vmap(lambda v: jnp.sum(v[1] ** 2))(velocities)
    assert float(spins.min()) < 0.5 * float(spins.max())  # it has tumbled


def test_spin_in_the_plane_is_exact():
    body = brick(d=2, angular_velocity=2.0)
    ready, start = made_ready(body)
    end, _ = turned(ready, start, np.pi / 4 / 10, 10)
    offset = np.asarray(ready.positions) - np.asarray(ready.positions).mean(axis=1, keepdims=True)
    np.testing.assert_allclose(end["displacement"], np.stack([-offset[1], offset[0]]) - offset, atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_accelerations_have_the_force_and_the_moment(d):
    body = brick(d=d, angular_velocity=2.0 if d == 2 else (1.0, 2.0, 3.0))
    ready, fields = made_ready(body)
    pulls = jnp.asarray(np.random.default_rng(2).normal(size=ready.positions.shape))
    got = rigid_acceleration(ready, fields, pulls)
    offset = ready.positions - jnp.mean(ready.positions, axis=1, keepdims=True)
    np.testing.assert_allclose(jnp.sum(got, axis=1), jnp.sum(pulls, axis=1), atol=1e-12)
    np.testing.assert_allclose(moment(ready.mass, offset, got), moment(ready.mass, offset, pulls), atol=1e-13)
    kicked = rigid_kick(ready, {**fields, "acceleration": pulls}, 0.1)
    expected = as_rigid(ready.mass, offset, fields["velocity"] + 0.1 * pulls)
    for value, wanted in zip(as_rigid(ready.mass, offset, kicked), expected, strict=True):
        np.testing.assert_allclose(value, wanted, atol=1e-13)


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_fall_in_a_run(kind):
    """It falls as any body does and spins on; what is saved is that, in both precisions."""
    body = brick(kind, d=2, velocity=(1.0, 0.0), angular_velocity=4.0)
    scene = sph.Scene(body, gravity=(0.0, -9.81))
    with pytest.raises(ValueError, match="pass time_step="):
        sph.stable_time_step(scene)
    run = sph.simulate(scene, 0.5, 0.25, time_step=0.001)
    assert run["brick"]["displacement"].dtype == kind
    # 500 times the rounding of a speed below 8 m/s, over half a second; and of places less than 3 m off
    tolerance, rounding = (1e-12, 1e-12) if kind is np.float64 else (6e-5, 2e-6)
    mean = np.asarray(run["brick"]["displacement"], float).mean(axis=1)[-1]
    np.testing.assert_allclose(mean, [0.5, -0.5 * 9.81 * 0.25], atol=tolerance)
    spin = np.asarray(run.observe(observe.angular_momentum), float) + np.asarray(
        [9.81 * float(np.sum(body.density * body.particles.volumes)) * (1.15 * t + 0.5 * t**2) for t in (0, 0.25, 0.5)]
    )
    np.testing.assert_allclose(spin, spin[0], rtol=10 * tolerance)
    shape = np.asarray(run.positions("brick"), float)
    apart = np.linalg.norm(shape[:, :, None] - shape[:, None], axis=-1)
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=rounding)
    assert run.probe("brick", (1.025, 2.025)).displacement.shape == (3, 2)


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"brick.density|density"):
        brick(density=-1.0)
    with pytest.raises(ValueError, match="angular_velocity"):
        brick(angular_velocity=2.0)
    with pytest.raises(ValueError, match="line"):
        sph.RigidBody("rod", sph.Particles(np.linspace([0, 0, 0], [1, 1, 1], 5), np.ones(5), 0.1), 1.0)
    with pytest.raises(ValueError, match="PenaltyForce acts on a Structure"):
        sph.Scene(brick(), effects=[sph.PenaltyForce(0.1)])
