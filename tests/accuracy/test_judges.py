"""The judges of the studies, held to fields whose error is known."""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "validation"), str(ROOT / "examples")]

import fluid_cases  # noqa: E402
import surface_cases  # noqa: E402


def test_vortices_of_exact_and_of_slower_particles():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(size=(2, 200))
    decay = np.exp(-8 * np.pi**2 / 100)
    u = -decay * np.cos(2 * np.pi * x) * np.sin(2 * np.pi * y)
    v = decay * np.sin(2 * np.pi * x) * np.cos(2 * np.pi * y)
    arrays = {"x": [x], "y": [y], "u": [u], "v": [v], "times": np.array([1.0])}
    assert fluid_cases.vortices_of_peer(arrays)["velocity"] < 1e-14  # rounding
    slower = {**arrays, "u": [0.9 * u], "v": [0.9 * v]}
    assert fluid_cases.vortices_of_peer(slower)["velocity"] == pytest.approx(0.1)


def test_channel_in_the_units_of_the_peer():
    """Steady after a viscous time: a parabola, whose error a constant is."""
    y = np.tile(np.linspace(0.05, 0.95, 10), (1, 1))
    arrays = {"y": y, "u": 1.25e-4 * (4 * y * (1 - y) + 0.01), "top": 1.25e-4, "nu": 0.01, "times": np.array([1000.0])}
    assert fluid_cases.poiseuille_of_peer(arrays)["velocity"] == pytest.approx(0.01, rel=1e-3)


def test_cavity_sees_the_velocities_of_the_table():
    """Particles on a fine lattice with a field that is linear: Shepard's sum gives it back inside."""
    points, expected = fluid_cases.center_lines()
    h = 0.02
    x, y = (a.ravel() for a in np.meshgrid(*[np.arange(-3 * h, 1 + 3.5 * h, h)] * 2))
    arrays = {"x": [x], "y": [y], "u": [y], "v": [-x], "h": np.array(h)}
    n = len(points) // 2
    exact = np.concatenate([points[:n, 1], -points[n:, 0]])
    wanted = np.sqrt(np.mean((exact - expected) ** 2))
    # off the lattice Shepard's sum of a linear field is some thousandths of a spacing off
    assert fluid_cases.cavity_of_peer(arrays)["velocity"] == pytest.approx(wanted, rel=1e-3)


def test_front_of_the_experiment_itself():
    lines = [line for line in surface_cases.table("fluid/dambreak_front.csv") if line["dataset"].endswith("2.25in")]
    times, places = (np.array([float(line[key]) for line in lines]) for key in ("T=t*sqrt(2g/a)", "Z=x/a"))
    assert surface_cases.front_error(times, places) < 1e-14
    assert surface_cases.front_error(times, 1.1 * places) == pytest.approx(0.1)
    front = {"times": times / np.sqrt(2 * 9.81), "front": 7.0 + places - places[0]}
    # it starts where the first sample is, not at 1
    assert surface_cases.front_of_splash(front)["experiment"] == pytest.approx(
        surface_cases.front_error(times, 1 + places - places[0])
    )
