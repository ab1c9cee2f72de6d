"""Models whose error falls with a resolution, of which the exact answer of every fit is known."""

import jax.numpy as jnp
import numpy as np
import pytest

import inverse

TRUTH, TIMES = 3.0, np.arange(1, 41) / 20
COUNTS = {"runs": 0}


def decaying(error=0.4, order=1.0, start=1.0, twist=0.0, noise=0.0):
    """exp(-rate t), by a model of the resolution n that takes rate (1 + error n^-order), and another shape by twist."""

    def problem_of(n):
        def simulate(scene, times, mode):
            t = jnp.asarray(times)
            return jnp.exp(-scene["rate"] * (1 + error * n**-order) * t) + twist / n * scene["rate"] * jnp.sin(9 * t)

        data = inverse.Observations(TIMES, np.exp(-TRUTH * TIMES))
        if noise:
            data = data.with_noise(absolute=noise, seed=1)
        unknown = {"rate": inverse.log(0.3, 30.0, start=start)}
        return inverse.Problem({"rate": 1.0}, lambda run: run, data, unknown, simulate, lambda s, v: {**s, **v})

    return problem_of


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_answer_is_that_of_the_fine_fit(order):
    problem_of = decaying(order=order)
    found = inverse.coarse_to_fine(problem_of, (4, 8, 16, 32))
    fine = inverse.fit(problem_of(32))
    exact = TRUTH / (1 + 0.4 * 32**-order)
    assert found.corrected and found.fit.converged
    # a correction below 1e-4 was not made
    assert found["rate"] == pytest.approx(exact, rel=1e-4) == fine["rate"]
    assert found.fit.simulation_runs < fine.simulation_runs
    assert found.fit.tangent_runs == 0, "no derivatives of the fine model"
    # 1 / (1 + c n^-p) bends a little away from a power
    assert found.order == pytest.approx(order, rel=0.05)
    assert abs(found.extrapolated[0] / TRUTH - 1) < 0.05 * abs(exact / TRUTH - 1)
    # the prediction alone is ten times nearer than the finest coarse answer
    assert abs(found.predicted[0] - exact) < 0.1 * abs(found.fits[-2].vector[0] - exact)
    assert "as fast" in found.saving(fine)


def test_two_resolutions_and_a_given_order():
    found = inverse.coarse_to_fine(decaying(order=2.0), (4, 16), order=2.0)
    assert found["rate"] == pytest.approx(TRUTH / (1 + 0.4 / 256), rel=1e-4)
    assert abs(found.extrapolated[0] / TRUTH - 1) < 1e-3


def test_standard_error_is_that_of_the_fine_fit():
    problem_of = decaying(noise=0.02)
    found, fine = inverse.coarse_to_fine(problem_of, (16, 32, 64)), inverse.fit(problem_of(64))
    # derivatives of resolution 32, whose rate differs by half a percent
    assert found.fit.standard_errors["rate"] == pytest.approx(fine.standard_errors["rate"], rel=0.02)


def test_derivatives_that_do_not_serve_are_given_up_for_a_fit():
    """A coarse model of another shape: its derivatives lead elsewhere, and the fine one is fitted as usual."""
    problem_of = decaying(twist=2.0)
    found = inverse.coarse_to_fine(problem_of, (1, 1000), max_corrections=2)
    assert not found.corrected
    assert found["rate"] == pytest.approx(inverse.fit(problem_of(1000))["rate"], rel=1e-4)
    assert "fitted as usual" in str(found)


def test_a_prediction_that_is_too_far_off_leaves_its_narrow_bounds():
    problem_of = decaying(error=5.0)  # at resolution 1 a sixth of the rate
    found = inverse.coarse_to_fine(problem_of, (1, 50), width=0.05)
    assert found["rate"] == pytest.approx(TRUTH / 1.1, rel=1e-3)


@pytest.mark.parametrize(
    ("resolutions", "options", "said"),
    [((4,), {}, "two or more that grow"), ((8, 4), {}, "two or more that grow"), ((4, 8), {"order": 0}, "must be > 0")],
)
def test_refused(resolutions, options, said):
    with pytest.raises(ValueError, match=said):
        inverse.coarse_to_fine(decaying(), resolutions, **options)


def test_calibrations_tell_bias_from_spread():
    problem_of = decaying()
    found = inverse.calibrations(problem_of, (4, 16), TRUTH, noise=0.05, seeds=range(8))
    for one in found:
        exact = 1 / (1 + 0.4 / one.resolution) - 1
        assert one.bias[0] == pytest.approx(exact, rel=1e-3)
        # eight seeds leave a standard deviation uncertain by a quarter: twice that
        assert one.spread[0] == pytest.approx(one.stated[0], rel=0.5)
        assert one.error[0] == pytest.approx(np.hypot(one.bias[0], one.spread[0]))
    silent = inverse.calibrations(problem_of, (4,), TRUTH, seeds=())[0]
    assert np.isnan(silent.spread[0]) and silent.error[0] == pytest.approx(abs(silent.bias[0]))


def test_other_data_use_what_was_compiled():
    problem = decaying()(4)
    first = inverse.fit(problem)
    second = inverse.fit(problem.started_at(first.vector).with_data(problem.data.with_noise(absolute=0.01, seed=0)))
    assert first.compile_seconds > 0 and second.compile_seconds == 0
    assert second["rate"] != first["rate"] and second["rate"] == pytest.approx(first["rate"], rel=0.1)
    with pytest.raises(ValueError, match="the times must be the same"):
        problem.with_data(problem.data.select(every=2))


def test_narrowed_bounds_stay_within_the_old_ones():
    problem = decaying()(4).narrowed(np.array([29.0]), 0.2)
    rate = problem.unknown["rate"]
    assert float(rate.upper) == pytest.approx(30.0) and float(rate.lower) == pytest.approx(29 * np.exp(-0.2))
    assert float(rate.start) == pytest.approx(29.0)
