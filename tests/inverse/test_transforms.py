"""Bounds and scales: maps that invert each other, and complaints that say what to do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import inverse


@given(st.floats(1e-3, 1e3), st.floats(1.01, 1e6), st.floats(0, 1))
def test_log_maps_invert_each_other(lower, ratio, fraction):
    unknown = inverse.log(lower, lower * ratio)
    value = lower * ratio**fraction
    # a few roundings of exp and log; ln(value) up to 20 amplifies 1e-16 twentyfold
    assert unknown.value(unknown.internal(value)) == pytest.approx(value, rel=1e-13)


@given(st.floats(-10, 10), st.floats(0.1, 20), st.floats(0, 1))
def test_linear_maps_invert_each_other(lower, width, fraction):
    unknown = inverse.linear(lower, lower + width)
    value = lower + fraction * width
    # absolute, against the size of the numbers that are subtracted
    assert unknown.value(unknown.internal(value)) == pytest.approx(value, abs=1e-13 * 40)


@pytest.mark.parametrize("unknown", [inverse.log(0.5, 80.0), inverse.linear(-3.0, 7.0)])
def test_slope_is_the_derivative_of_the_value(unknown):
    z, step = unknown.internal(2.0), 1e-5
    difference = (unknown.value(z + step) - unknown.value(z - step)) / (2 * step)
    # truncation step^2 / 6 = 2e-11, rounding 1e-16 / step = 1e-11
    assert unknown.slope(z) == pytest.approx(difference, rel=1e-9)


def test_values_never_leave_their_bounds_by_rounding():
    for lower, upper in [(1e5, 1e8), (0.1, 0.3), (1 / 3, 7.7)]:
        unknown = inverse.log(lower, upper)
        assert unknown.value(unknown.internal(lower)) >= lower
        assert unknown.value(unknown.internal(upper)) <= upper


def test_default_start_is_the_middle_on_the_scale():
    assert inverse.log(1e4, 1e6).start == pytest.approx(1e5)
    assert inverse.linear(-1.0, 3.0).start == 1.0


def test_array_unknowns_take_scalar_bounds():
    unknown = inverse.linear(0.0, 1.0, start=np.full((3, 2), 0.25))
    assert unknown.shape == (3, 2)
    assert np.array_equal(unknown.value(unknown.internal(unknown.start)), unknown.start)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: inverse.log(1e8, 1e5), r"lower=1e\+08, upper=100000.*did you mean \(100000, 1e\+08\)"),
        (lambda: inverse.log(0.0, 1.0), "0 is not > 0.*linear"),
        (lambda: inverse.log(-1.0, 1.0), "-1 is not > 0"),
        (lambda: inverse.log(1.0, 10.0, start=20.0), r"start = 20 lies outside its bounds \[1, 10\]"),
        (lambda: inverse.linear(1.0, 1.0), "two different bounds"),
        (lambda: inverse.linear(0.0, np.inf), "finite"),
        (lambda: inverse.linear(0.0, 1.0, start=np.array([0.5, 1.5])), r"start\[1\] = 1.5"),
        (lambda: inverse.linear(0.0, 1.0, start=np.nan), "outside"),
        (lambda: inverse.linear(np.zeros(3), np.ones(3), start=np.full(2, 0.5)), "shape"),
    ],
)
def test_bad_bounds(make, words):
    with pytest.raises(ValueError, match=words):
        make()
