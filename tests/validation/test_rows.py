"""The file of results, and the reading of oscillations, on which every row stands."""

import numpy as np
import pytest
from motion import csm3_reference, first_mode, freed_of_time_step, mode_frequencies, oscillation
from reference import number
from rows import Case, Row, as_record, holds, load, merge, save


def record(name: str, figure: str, value: float, limit: float | None = 1.0):
    return as_record(Case(name, name, lambda quick: iter(())), Row(figure, value, limit, "9 across", "float64"), 1.0)


def test_limit_bounds_a_value_from_above():
    assert holds(record("a", "error", 1.0))
    assert not holds(record("a", "error", 1.0 + 1e-12))
    assert holds(record("a", "seconds", 1e9, None))


def test_value_that_is_not_finite_misses_its_limit():
    assert record("a", "error", float("nan"))["value"] is None
    assert not holds(record("a", "error", float("nan")))
    assert not holds(record("a", "error", float("inf"), None))


def test_merging_keeps_other_cases_and_drops_stale_rows():
    old = [record("b", "kept", 1), record("a", "gone", 2), record("a", "same", 3)]
    new = [record("a", "same", 4)]
    order = ["a", "b"]

    def figures(rows):
        return [(row["figure"], row["value"]) for row in rows]

    # while case a still runs, what it has not made anew stays
    assert figures(merge(old, new, [], order)) == [("gone", 2), ("same", 4), ("kept", 1)]
    assert figures(merge(old, new, ["a"], order)) == [("same", 4), ("kept", 1)]


def test_file_is_read_as_written(tmp_path):
    rows = [record("a", "error", 0.5), record("a", "broken", float("nan"))]
    assert load(tmp_path / "rows.json") == []
    save(tmp_path / "rows.json", rows)
    assert load(tmp_path / "rows.json") == rows


def test_oscillation_of_a_known_signal():
    times = np.linspace(0, 10, 2001)
    found = oscillation(times, 2 + 3 * np.cos(2 * np.pi * 1.1 * times + 0.4))
    # the search for its frequency ends at 1e-5 Hz, a phase of 3e-4 at either end
    assert found.fundamental == pytest.approx(3, rel=1e-6)
    # samples 5 ms apart miss a peak by (1 - cos(pi 1.1 .005)) = 1.5e-4; linear crossings err by far less
    assert found.amplitude == pytest.approx(3, rel=2e-4)
    assert found.mean == pytest.approx(2, abs=1e-3)
    assert found.frequency == pytest.approx(1.1, rel=1e-5)


def test_modes_of_a_known_signal_and_their_time_step():
    """Sines of the sizes of CSM3; the trapezoidal rule on one of them is slower by what it is freed of."""
    times = np.linspace(0, 10, 2001)
    known = {"first": (1.094, 0.065), "second": (6.55, 9e-4), "third": (17.6, 7e-5), "fourth": (34.6, 1e-5)}
    values = sum(size * np.cos(2 * np.pi * frequency * times) for frequency, size in known.values())
    for mode, frequency in mode_frequencies(times, np.asarray(values)).items():
        # what the window lets through of the others: the first is a thousand times the fourth
        assert frequency == pytest.approx(known[mode][0], rel=1e-4)
    step, turn = 0.005, 2 * np.pi * 17.6
    place, speed, half = 1.0, 0.0, 0.5 * 0.005 * turn
    rotation = np.linalg.solve([[1, -half], [half, 1]], [[1, half], [-half, 1]])  # x' = w v, v' = -w x
    place, speed = rotation @ (place, speed)
    slow = np.arctan2(-speed, place) / (2 * np.pi * step)
    assert slow < 17.6 * (1 - 0.02)
    assert freed_of_time_step(slow, step) == pytest.approx(17.6, rel=1e-12)


def test_oscillation_needs_two_crossings():
    times = np.linspace(0, 1, 100)
    with pytest.raises(ValueError, match="two are needed"):
        oscillation(times, np.cos(2 * np.pi * times))


def test_reference_series_agrees_with_the_published_values():
    found = csm3_reference()
    # featflow's finest time step published, .005 s on a coarse mesh, is .5 % from the converged frequency
    assert found.frequency == pytest.approx(1.0995, rel=6e-3)
    # the amplitude of its finer mesh: .064595 with a time step of .02 s, which damps by 1.6 %
    assert found.amplitude == pytest.approx(number("solid/turek_hron_csm.csv", "amplitude",
                                                   case="CSM3(dt=.02,lev2+0)", quantity="uy_A"), rel=0.02)  # fmt: skip


def test_first_mode_is_clamped_and_free():
    x = np.linspace(0, 1, 1001)
    shape = first_mode(x)
    assert shape[0] == 0
    assert shape[-1] == 1
    second = np.gradient(np.gradient(shape, x), x)
    assert abs(shape[1]) < 1e-5  # no slope at the root: it grows like x^2
    # no bending moment at the tip: 3.52 there at the root, one-sided differences leave 1e-2
    assert abs(second[-3]) < 0.02
    assert first_mode(np.array([-0.1]))[0] == 0
