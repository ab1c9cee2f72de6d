"""The hard cases that find most, coarse and short; all of them run in `make validate`."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "validation"))

import largest_step  # noqa: E402
from any_step import any_step  # noqa: E402
from columns import RAMP, STRONG, gripped  # noqa: E402
from rows import Case, Row, as_record, holds  # noqa: E402
from tension import JET_LENGTH, JET_SPEED, JET_WIDTH, two_jets  # noqa: E402
from watch import alternation, lowest_determinant, rise, rows_of, watch  # noqa: E402

import jaxsph  # noqa: E402
from jaxsph.pytree import replace  # noqa: E402
from jaxsph.stable_step import SAFETY  # noqa: E402

WHERE = ("quick", "float32")


def missed(rows: list[Row]) -> list[dict]:
    """The rows that miss their limit."""
    case = Case("quick", "quick", lambda quick: iter(()))
    return [record for record in (as_record(case, row, 0.0) for row in rows) if not holds(record)]


@pytest.mark.parametrize("free", [8, 6, 5])
def test_alternation_is_measured_in_short_rows_and_none_is_taken_for_zero(free):
    """A row of particles at the end of a clamp; displaced by turns, by a thousandth."""
    row = jaxsph.box((0, 0), (0.1 * (free + 3), 0.2), 0.1, dtype=np.float64)
    place = np.asarray(row.positions)

    def plate(clamped):
        return jaxsph.Structure("plate", row, density=1.0, youngs_modulus=1.0, poisson_ratio=0.3, clamped=clamped)

    structure = plate(place[:, 0] < 0.3)
    state = jaxsph.initial_state(jaxsph.Scene(structure))
    turns = 1e-3 * (-1.0) ** np.round(place / 0.1 - 0.5)[:, :1] * np.array([0.0, 1.0])
    moved = replace(state, systems={"plate": {**state.systems["plate"], "displacement": turns}})
    assert float(alternation(structure)(moved)) == pytest.approx(1e-3)
    with pytest.raises(ValueError, match="no row of five"):
        alternation(plate(place[:, 0] < 0.1 * (free + 3) - 0.4))


def test_jets_that_hit_each_other_lose_energy_and_stay_dense():
    scene = two_jets(5, np.float32)
    watched = watch(scene, 0.6, 12)
    assert not missed(rows_of(watched, WHERE, energy=1000 * JET_LENGTH * JET_WIDTH * JET_SPEED**2))
    place = np.asarray(watched.run["water"]["position"][-1], float)
    assert np.abs(place[:, 1]).max() > JET_WIDTH, "they turn aside"


@pytest.mark.parametrize(("pull", "turns"), [(3.0, 0.0), (0.0, 1.0)], ids=["to four lengths", "by a whole turn"])
def test_a_column_pulled_or_twisted_keeps_its_energy_and_its_order_while_it_is_held(pull, turns):
    """With a strong penalty force, at the default step; with the usual one the twisted column folds."""
    scene = gripped(5, np.float32, pull, turns, STRONG)
    column = scene["column"]
    measures = {"determinant": lowest_determinant(scene, "column"), "alternation": alternation(column)}
    watched = watch(scene, 1.2 * RAMP, 12, measures)
    assert not watched.reason
    assert watched.seen["determinant"].min() > 0
    assert watched.seen["alternation"].max() < 0.01 * column.particles.spacing
    held = watched.seen["energy"][11:]
    assert rise(held) < 1e-3 * held[0]


def test_a_thin_rubber_plate_stays_whole_in_water_that_strikes_it():
    """By the internal friction that the scene lists: without it water shakes the plate until it breaks, at .31 s."""
    scene = jaxsph.scenes.dam_break_gate_plate(0.02, dtype=np.float32)
    watched = watch(scene, 0.4, 20)
    assert not watched.reason
    speed = np.asarray(watched.run["plate"]["velocity"], float)
    rms = np.sqrt(np.mean(np.sum(speed**2, axis=2), axis=1))
    print("rms speed of the plate [m/s]:", rms.round(2))
    # Nothing can throw it faster than the water falls from the top of its column, .4 m.
    assert rms.max() < np.sqrt(2 * 9.81 * 0.4)


def test_limit_of_a_structures_time_step_is_real():
    scene = jaxsph.scenes.turek_hron_beam(3, dtype=np.float64)
    limit = jaxsph.stable_time_step(scene) / SAFETY
    with any_step():
        assert largest_step.gained(scene, 0.1, limit) < largest_step.GAIN
        assert largest_step.gained(scene, 0.1, 1.1 * limit) > 1
    with pytest.raises(jaxsph.UnstableTimeStep):
        jaxsph.simulate(scene, 4 * limit, time_step=1.1 * limit)


def test_every_case_is_on_the_page():
    """In a table, or among those that have no results yet."""
    page = (HERE.parents[1] / "docs" / "stability.md").read_text(encoding="utf-8")
    asked = re.findall(r"begin stability ([^>]*?) *-->", page) + re.findall(r"^No results yet: (.*)\.$", page, re.M)
    names = [name.strip() for names in asked for name in names.split(",")]
    listed = [name for path in HERE.glob("*.py") for name in re.findall(r'Case\("(H\w+)"', path.read_text())]
    assert len(listed) == len(set(listed)) > 12
    for name in listed:
        assert any(name.startswith(asked) for asked in names), f"docs/stability.md has no table with {name}"
