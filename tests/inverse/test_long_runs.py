"""Gradients along a chaotic run: when they can be trusted, and windows where one long record is hopeless."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import inverse

TRUE, START = 28.0, (1.0, 1.0, 20.0)
SAMPLE, STEPS = 0.05, 5
LYAPUNOV = 0.906  # 1/s, largest exponent of this system (E. Lorenz 1963; J. C. Sprott 2003)


def advance(scene, state, times, mode):
    """Lorenz' equations by Runge and Kutta's fourth-order steps; ((T, 3) states at uniform times, the last state)."""
    dt = SAMPLE / STEPS

    def rate(s):
        x, y, z = s
        return jnp.stack([10.0 * (y - x), x * (scene["rho"] - z) - y, x * y - 8.0 / 3.0 * z])

    def step(s, _):
        a = rate(s)
        b = rate(s + 0.5 * dt * a)
        c = rate(s + 0.5 * dt * b)
        return s + dt / 6 * (a + 2 * b + 2 * c + rate(s + dt * c)), None

    def sample(s, _):
        s = jax.lax.scan(step, s, length=STEPS)[0]
        return s, s

    end, states = jax.lax.scan(sample, jnp.asarray(state), length=len(times))
    return states, end


def simulate(scene, times, mode):
    return advance(scene, jnp.asarray(START) + 0.0 * scene["rho"], times, mode)[0]


def replace(scene, values):
    return {**scene, **values}


def measured(seconds, noise=0.03, seed=0):
    times = SAMPLE * np.arange(1, round(seconds / SAMPLE) + 1)
    data = inverse.Observations(times, np.asarray(jax.jit(lambda rho: simulate({"rho": rho}, times, ""))(TRUE)))
    return data.with_noise(relative=noise, seed=seed)


def unknown(start):
    return {"rho": inverse.log(20.0, 40.0, start=start)}


def long(seconds, start=1.07 * TRUE):
    return inverse.Problem(
        {"rho": TRUE}, lambda run: run, measured(seconds), unknown(start), simulate=simulate, replace=replace
    )


def starts_of(data, windows):
    """States at the starts of windows, as measured."""
    length = len(data) // windows
    return np.concatenate([[START], data.values[length - 1 : -1 : length]])


def shooting(seconds, windows, start=1.07 * TRUE, **options):
    data = measured(seconds)
    return inverse.multiple_shooting(
        {"rho": TRUE},
        lambda run: run,
        data,
        unknown(start),
        advance,
        starts_of(data, windows),
        replace=replace,
        **options,
    )


def test_tangents_of_a_chaotic_run_grow_exponentially():
    growth = inverse.tangent_growth(long(30.0), at={"rho": TRUE}, difference_step=1e-3)
    assert growth.exponential[0]
    # over 15 s, 14 e-folds, the rate of one orbit differs from the mean of all by some tenths
    assert growth.rate[0] == pytest.approx(LYAPUNOV, abs=0.3)
    # what is 2 e-folds of (change / growth) away from the signal: well before the end, and not at once
    assert 0.5 < growth.horizon()[0] < 12.0
    assert growth.horizon(1e-3)[0] > growth.horizon(1e-1)[0]
    # differences of .1 % leave the tangent when they reach the signal's size, not where the gradient is wrong
    assert growth.horizon(1e-1)[0] < growth.agrees_until()[0] < 25.0
    assert "multiple_shooting" in str(growth) and growth.simulation_runs == 3


def test_tangents_of_a_vibration_do_not(toys, tmp_path):
    growth = inverse.tangent_growth(toys.oscillator(3.0, 1.0), difference_step=1e-4)
    assert not growth.exponential[0]
    # the phase moves by w t / 2 for a relative change of the stiffness: 1 / .1 at t = 20 / w
    assert growth.horizon()[0] == pytest.approx(20 / np.sqrt(toys.stiffness), rel=0.2)
    assert growth.agrees_until(1e-3)[0] == toys.oscillator(3.0).data.times[-1]
    assert growth.plot(tmp_path / "growth.png").stat().st_size > 5_000
    with pytest.raises(ValueError, match="difference_step"):
        inverse.tangent_growth(toys.oscillator()).agrees_until()
    with pytest.raises(ValueError, match="must be > 0"):
        inverse.tangent_growth(toys.oscillator(), difference_step=-1.0)
    with pytest.raises(ValueError, match="must be > 0"):
        growth.horizon(0.0)


@pytest.mark.parametrize("method", ["gauss-newton", "l-bfgs-b"])
def test_one_long_window_fails_and_says_so(method):
    """Gauss-Newton's growing window comes near by the first seconds, but the record is not followed."""
    fit = inverse.fit(long(30.0), method=method)
    assert "poor fit" in str(fit) and "model error" in str(fit)
    # tangents of exp(27) promise an accuracy that is not there
    assert abs(float(fit["rho"]) - TRUE) > 1e3 * fit.standard_errors["rho"]


def test_windows_succeed():
    fit = inverse.fit(shooting(16.0, 16))
    assert fit.converged
    # 320 samples of 3 columns with 3 % noise
    assert float(fit["rho"]) == pytest.approx(TRUE, abs=3 * fit.standard_errors["rho"])
    assert fit.standard_errors["rho"] < 1e-3 * TRUE
    assert fit.uncertainty is not None and fit.uncertainty.chi_square_interval is not None
    low, high = fit.uncertainty.chi_square_interval
    assert low < fit.uncertainty.reduced_chi_square < high, "the rows that are always zero must not count"
    gaps = fit.simulated[:, 3:]
    assert np.max(np.abs(gaps)) < 0.03, "windows join to three of their standard deviations"


def test_starts_that_were_measured():
    """Held where they are, with their noise: a bias, and no unknowns but the one."""
    problem = shooting(16.0, 32, gap=None)
    assert problem.labels == ["rho"]
    assert float(inverse.fit(problem)["rho"]) == pytest.approx(TRUE, rel=0.02)


def test_bad_arguments():
    with pytest.raises(ValueError, match="gap=0"):
        shooting(3.0, 3, gap=0.0)
    with pytest.raises(ValueError, match="must be > 0; give the size"):
        shooting(3.0, 3, scale=0.0)
    data = measured(3.0)

    def problem(data, starts):
        observe = lambda run: run  # noqa: E731
        return inverse.multiple_shooting({"rho": TRUE}, observe, data, unknown(TRUE), advance, starts, replace=replace)

    with pytest.raises(ValueError, match="60 samples are not a multiple of 7 windows; leave out 4"):
        problem(data, np.ones((7, 3)))
    with pytest.raises(ValueError, match="evenly spaced"):
        problem(inverse.Observations(data.times**2, data.values, 1.0), starts_of(data, 3))
    with pytest.raises(ValueError, match=r"\(W, d\)"):
        problem(data, [1.0, 2.0])
    with pytest.raises(ValueError, match="standard deviations"):
        problem(inverse.Observations(data.times, data.values), starts_of(data, 3))
