"""The examples of fluids run, small and short, and what they return is physical."""

from pathlib import Path

import numpy as np
import pytest
from examples_of import runner

from jaxsph import observe

FOLDER = Path(__file__).parents[1] / "examples" / "fluids"


@pytest.fixture
def example(tmp_path):
    return runner(FOLDER, tmp_path)


def volume(run):
    """Of the water at all saved times (T,) [m^d]."""
    water = run.scene["water"]
    return np.sum(np.asarray(water.mass()) / (float(water.density) + run["water"]["density_deviation"]), axis=1)


def assert_inside(run, low, high):
    """No particle is out of the tank by more than half a spacing: its center is then in the middle of the wall's first.

    The sides of a tank are open at the top: `high` leaves out the last axis.
    """
    positions, slack = np.asarray(run.positions("water")), 0.5 * run.scene.spacing
    assert np.all(np.isfinite(positions))
    assert np.all(positions >= np.asarray(low) - slack)
    assert np.all(positions[..., : len(high)] <= np.asarray(high) + slack)


@pytest.mark.parametrize(("dimension", "particles"), [(2, 16), (3, 10)])
def test_taylor_green(example, dimension, particles):
    run = example("taylor_green", particles=particles, t_end=0.1, dimension=dimension)
    energy = np.asarray(run.observe(observe.energies)["kinetic"])
    # ten to sixteen particles a period of the vortices' squares: the decay to within 10 % of exp(-8 d pi^2 t / Re)
    np.testing.assert_allclose(np.log(energy[-1] / energy[0]), -8 * dimension * np.pi**2 * 0.1 / 100, rtol=0.1)
    # pair forces are equal and opposite; shifting gives that up to a part in a thousand of sum m U
    assert np.linalg.norm(observe.linear_momentum(run.scene, run.final)) < 1e-3


@pytest.mark.slow
def test_poiseuille_and_couette(example):
    runs = example("poiseuille_couette", particles=10, t_end=0.8)
    top = 1.25e-5
    u = np.asarray(runs["poiseuille"].final.systems["water"]["velocity"])[:, 0]
    y = np.asarray(runs["couette"].final.systems["water"]["position"])[:, 1]
    # the steady states, with a hundredth for 10 particles across and for what is left of the start
    np.testing.assert_allclose(u.max(), top * (1 - 0.05**2 * 4), rtol=0.015)
    u = np.asarray(runs["couette"].final.systems["water"]["velocity"])[:, 0]
    np.testing.assert_allclose(u, top * y / 1e-3, atol=0.01 * top)


@pytest.mark.slow
def test_lid_driven_cavity(example):
    run = example("lid_driven_cavity", particles=12, t_end=0.5)
    assert_inside(run, (0, 0), (1, 1))
    np.testing.assert_allclose(volume(run), 1.0, rtol=1e-6)  # a closed box keeps it after every step


@pytest.mark.slow
def test_still_water(example):
    runs = example("still_water", particles=8, t_end=0.2)
    for run, width in ((runs["tank"], 9 * 0.9 / 8), (runs["column"], 2 * 0.9 / 8)):
        assert_inside(run, (0, 0), (width,))
        # water that falls into the compression of rho g H / c^2 = 1/200, and beyond it by as much
        np.testing.assert_allclose(volume(run), volume(run)[0], rtol=0.01)


@pytest.mark.parametrize("depth", [None, pytest.param(0.073, marks=pytest.mark.slow)])
def test_dam_break(example, depth):
    run = example("dam_break", particles=8 if depth else 12, t_end=0.2, depth=depth)
    sides = (4 * 0.146,) if depth is None else (4 * 0.146, depth)
    assert_inside(run, (0,) * run.scene.dimension, sides)
    energies = np.asarray(run.observe(observe.energies)["total"])
    assert energies[-1] < energies[0] * 1.001
    front = float(observe.surge_front(run.scene, run.final, "water"))
    assert 0.3 < front < 0.146 + 2 * np.sqrt(9.81 * 0.292) * 0.2  # not faster than a dry bed allows


@pytest.mark.slow
def test_dam_break_gate(example):
    run = example("dam_break_gate", spacing=0.025, t_end=0.12)
    assert_inside(run, (0, 0), (0.8,))
    gate = np.asarray(run.positions("gate"))[:, :, 1].min(axis=1) - 0.0125
    # it stops after .1 s at -285.115 t^3 + 72.305 t^2 + .1463 t
    np.testing.assert_allclose(gate[-1], -0.285115 + 0.72305 + 0.01463, atol=1e-5)
    early = np.asarray(run.positions("water"))[: len(gate) // 4]  # until the gate has risen a spacing or so
    assert early[..., 0].max() < 0.2 + 3 * 0.025


@pytest.mark.slow
def test_moving_wall(example):
    run = example("moving_wall", particles=6, t_end=1.0)
    assert_inside(run, (0, 0), (4.0,))
    wall = np.asarray(run.positions("wall"))[:, :, 0].max(axis=1)
    water = np.asarray(run.positions("water"))[:, :, 0].min(axis=1)
    assert np.all(water > wall)  # nothing slips past the last layer of the wall
    momentum = np.asarray(run.observe(observe.linear_momentum))[:, 0]
    assert momentum[-1] > 100  # the wall has pushed: rho h U times the way of the bore, some 170 kg m/s per m


def test_oscillating_drop(example):
    run = example("oscillating_drop", particles=10, t_end=0.5)
    momentum = np.asarray(run.observe(observe.linear_momentum))
    mass = 1000 * np.pi
    assert np.abs(momentum).max() < 1e-6 * mass * 0.5  # pair forces cancel, and so does the field's
    size = np.std(np.asarray(run["water"]["position"]), axis=1)
    # incompressible: the product of the semi-axes stays, with .5 % for 10 particles along the radius
    np.testing.assert_allclose(size[:, 0] * size[:, 1], size[0, 0] * size[0, 1], rtol=5e-3)


def test_rotating_square(example):
    run = example("rotating_square", particles=16, t_end=0.6)
    spin = np.asarray(run.observe(observe.angular_momentum))
    np.testing.assert_allclose(spin, spin[0], rtol=0.02)  # shifting near the edges is not exact
    np.testing.assert_allclose(volume(run), 1.0, rtol=2e-3)


@pytest.mark.slow
def test_standing_wave(example):
    run = example("standing_wave", particles=10, t_end=2.4)
    assert_inside(run, (0, 0), (1.0,))
    kinetic = np.asarray(run.observe(observe.energies)["kinetic"])
    # exp(-4 nu k^2 t) at whole periods of 1.134 s, and less for 10 particles over the depth
    period = round(2 * np.pi / np.sqrt(9.81 * np.pi * np.tanh(np.pi)) / 2.4 * 160)
    assert 0.3 < kinetic[period] / kinetic[0] < np.exp(-0.4946 * 1.134) + 0.1


@pytest.mark.slow
def test_falling_column(example):
    run = example("falling_column", particles=12, t_end=0.2)
    assert_inside(run, (0, 0), (1.0,))
    water = np.asarray(run.scene["water"].particles.positions)[:, 1] > 0.2
    center = np.asarray(run["water"]["position"])[:, water, 1].mean(axis=1)
    times = np.asarray(run.times)
    air = times < 0.1  # not yet in reach of the pool, at this spacing from .14 s on
    np.testing.assert_allclose(center[air], center[0] - 0.5 * 9.81 * times[air] ** 2, atol=1e-3)
