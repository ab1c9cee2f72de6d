"""Toy simulators: three functions each, as any simulator that `inverse` fits."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import inverse

GRAVITY = 2.0
STIFFNESS = (2 * np.pi * 1.1) ** 2  # 1/s^2: 1.1 Hz, near the tip of the CSM3 beam
STEPS_PER_SAMPLE = 10


def oscillator_run(scene, times, mode):
    """x'' = -k x - c x' + g from rest at 0, kick-drift-kick; (T, 2) position, velocity at uniform times."""
    interval = float(times[-1]) / len(times)
    dt = interval / STEPS_PER_SAMPLE

    def step(carry, _):
        x, v = carry
        v = v + 0.5 * dt * (scene["gravity"] - scene["stiffness"] * x - scene["damping"] * v)
        x = x + dt * v
        v = (v + 0.5 * dt * (scene["gravity"] - scene["stiffness"] * x)) / (1 + 0.5 * dt * scene["damping"])
        return (x, v), None

    def sample(carry, _):
        carry, _ = jax.lax.scan(step, carry, None, length=STEPS_PER_SAMPLE)
        return carry, jnp.stack(carry)

    zero = jnp.zeros_like(jnp.asarray(scene["stiffness"]))
    return jax.lax.scan(sample, (zero, zero), None, length=len(times))[1]


def replace(scene, values):
    return {**scene, **values}


def twin(scene, unknown, times, simulate, observe, noise=None, seed=0):
    """Problem whose data are the scene's own response, with noise relative to its amplitude."""
    data = inverse.Observations(times, np.asarray(observe(simulate(scene, times, "forward"))))
    if noise:
        data = data.with_noise(relative=noise, seed=seed)
    return inverse.Problem(scene, observe, data, unknown, simulate=simulate, replace=replace)


def oscillator(periods=0.9, factor=1 / 3, noise=None, seed=0, damping=0.0, rate=100, unknown=None):
    """Stiffness of an oscillator from its position, starting at `factor` times the truth."""
    scene = {"stiffness": STIFFNESS, "damping": damping, "gravity": GRAVITY}
    times = np.arange(1, int(periods / 1.1 * rate) + 1) / rate
    if unknown is None:
        unknown = {"stiffness": inverse.log(STIFFNESS / 50, STIFFNESS * 50, start=STIFFNESS * factor)}
    return twin(scene, unknown, times, oscillator_run, lambda run: run[:, 0], noise, seed)


def decay(times, truth, unknown, noise=None, seed=0):
    """amplitude * gain * exp(-rate t): amplitude and gain can't be told apart."""

    def simulate(scene, times, mode):
        return scene["amplitude"] * scene["gain"] * jnp.exp(-scene["rate"] * jnp.asarray(times))

    return twin(truth, unknown, times, simulate, lambda run: run, noise, seed)


@pytest.fixture(scope="session")
def toys():
    return types.SimpleNamespace(
        oscillator=oscillator,
        oscillator_run=oscillator_run,
        decay=decay,
        twin=twin,
        replace=replace,
        stiffness=STIFFNESS,
        gravity=GRAVITY,
    )
