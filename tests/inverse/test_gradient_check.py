"""The check finds agreement where derivatives are right, and says so where they are not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import inverse


def test_oscillator_derivatives_agree(toys):
    unknown = {
        "stiffness": inverse.log(5, 500, start=30),
        "damping": inverse.linear(0.0, 5.0, start=0.5),
        "gravity": inverse.log(0.1, 100, start=1.0),
    }
    check = inverse.check(toys.oscillator(2.0, damping=0.8, unknown=unknown))
    # forward and reverse: the same arithmetic in another order; central differences: step^2 + 1e-16 / step
    assert check.forward_against_reverse < 1e-10
    assert check.max_relative_difference < 1e-7
    assert check.differences.shape == (3, len(check.steps))
    assert check.simulation_runs == 2 + 2 * 3 * len(check.steps)
    assert "damping" in str(check)
    assert toys.oscillator().check().max_relative_difference < 1e-7


def test_a_wrong_derivative_is_found(toys):
    @jax.custom_jvp
    def root(k):
        return jnp.sqrt(k)

    @root.defjvp
    def wrong(primals, tangents):
        return root(*primals), 0.6 / jnp.sqrt(primals[0]) * tangents[0]  # .5 would be right

    def simulate(scene, times, mode):
        return jnp.cos(root(scene["stiffness"]) * jnp.asarray(times))

    unknown = {"stiffness": inverse.log(1, 100, start=12.0)}
    problem = toys.twin({"stiffness": 10.0}, unknown, np.linspace(0.1, 1, 20), simulate, lambda run: run)
    check = inverse.check(problem)
    assert check.forward_against_reverse < 1e-10
    assert check.max_relative_difference == pytest.approx(0.2, rel=1e-3)  # .6 / .5 - 1


def test_many_unknowns_are_checked_along_random_directions():
    times = np.arange(1.0, 31.0)

    def simulate(scene, times, mode):
        return jnp.tanh(scene["field"]) * jnp.asarray(times)

    problem = inverse.Problem(
        {"field": jnp.zeros(30)},
        lambda run: run,
        inverse.Observations(times, np.sin(times)),
        {"field": inverse.linear(-1, 1, start=np.full(30, 0.3))},
        simulate=simulate,
        replace=lambda scene, values: values,
    )
    check = problem.check()
    assert len(check.directions) == 8
    assert check.max_relative_difference < 1e-7


def test_float32_says_that_differences_mean_nothing(toys):
    scene = {
        name: jnp.float32(value)
        for name, value in {"stiffness": toys.stiffness, "damping": 0.0, "gravity": toys.gravity}.items()
    }
    unknown = {"stiffness": inverse.log(1, 1e4, start=30.0)}
    problem = toys.twin(scene, unknown, np.arange(1, 50) / 100, toys.oscillator_run, lambda run: run[:, 0])
    check = problem.check()
    assert "not taken" in str(check)
    # rounding of float32 over 500 steps
    assert check.max_relative_difference < 1e-3


def test_bad_arguments(toys):
    problem = toys.oscillator()
    with pytest.raises(ValueError, match="the unknowns are stiffness"):
        problem.check(at={"mass": 1.0})
    with pytest.raises(ValueError, match="within the bounds"):
        problem.check(at={"stiffness": -1.0})
    with pytest.raises(ValueError, match="> 0"):
        problem.check(steps=(0.0,))


def test_a_start_on_a_bound_is_moved_by_the_largest_step_and_it_says_so(toys):
    unknown = {"stiffness": inverse.log(10.0, 500, start=10.0)}
    check = inverse.check(toys.oscillator(1.0, unknown=unknown))
    assert check.moved == ("stiffness",) and "moved away from a bound" in str(check)
    assert check.max_relative_difference < 1e-7
    check = inverse.check(toys.oscillator(1.0, unknown=unknown), at={"stiffness": 30.0}, steps=(0.1, 1e-4))
    assert check.moved == ()
    # steps of .1: .1^2 of the third derivative, not one side of a bound
    assert abs(check.differences[0, 0] / check.forward[0] - 1) < 0.3


def test_narrow_bounds_take_small_steps_or_refuse(toys):
    unknown = {"stiffness": inverse.log(29.9, 30.1, start=30.0)}  # .0067 apart internally
    check = inverse.check(toys.oscillator(1.0, unknown=unknown))
    assert check.steps == (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
    assert check.max_relative_difference < 1e-6  # 1e-5^2 of the third derivative, or 1e-16 over 1e-5
    with pytest.raises(ValueError, match=r"0\.01 to both sides do not fit between bounds"):
        inverse.check(toys.oscillator(1.0, unknown=unknown), steps=(1e-2,))
