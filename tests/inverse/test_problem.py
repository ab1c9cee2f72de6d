"""A problem checks what it is given, and its default simulation asks jaxsph for what the data need."""

import types
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import inverse
from inverse.jaxsph_simulation import JaxsphSimulation, common_interval, corners

DATA = inverse.Observations(np.array([0.1, 0.2]), np.array([1.0, 2.0]))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"data": [1.0, 2.0]}, "inverse.Observations"),
        ({"unknown": {}}, "unknown is empty"),
        ({"unknown": {"a": 3.0}}, r"unknown\['a'\] is a float"),
        ({"replace": None}, "pass replace="),
        ({"time_step": 1e-3}, "belong to the default simulate"),
    ],
)
def test_bad_arguments(options, words):
    arguments = {
        "scene": {"a": 1.0},
        "observe": lambda run: run,
        "data": DATA,
        "unknown": {"a": inverse.log(1, 2)},
        "simulate": lambda scene, times, mode: jnp.asarray(times) * scene["a"],
        "replace": lambda scene, values: {**scene, **values},
    } | options
    with pytest.raises(ValueError, match=words):
        inverse.Problem(**arguments)


def test_observation_of_another_shape_is_refused():
    problem = inverse.Problem(
        {"a": 1.0},
        lambda run: run,
        DATA,
        {"a": inverse.log(1, 2)},
        simulate=lambda scene, times, mode: scene["a"] * jnp.ones(3),
        replace=lambda scene, values: {**scene, **values},
    )
    with pytest.raises(ValueError, match=r"observe\(run\) has shape \(3,\), data.values \(2,\)"):
        inverse.fit(problem)


def test_scene_with_its_own_replace_and_array_unknowns():
    class Scene(dict):
        def replace(self, values):
            return Scene({**self, **values})

    problem = inverse.Problem(
        Scene(a=np.zeros(2), b=1.0),
        lambda run: run,
        DATA,
        {"a": inverse.linear(-1, 1, start=np.array([0.5, -0.5])), "b": inverse.log(0.1, 10, start=2.0)},
        simulate=lambda scene, times, mode: scene["a"] * scene["b"],
    )
    assert problem.labels == ["a[0]", "a[1]", "b"]
    np.testing.assert_allclose(problem.vector(problem.start), [0.5, -0.5, 2.0], rtol=1e-15)
    np.testing.assert_allclose(problem.model(problem.vector(problem.start), "forward"), [1.0, -1.0])


@pytest.mark.parametrize(
    ("times", "interval"),
    [
        (np.arange(1, 91) / 100, 0.01),
        (np.array([0.0, 0.02, 0.05, 0.09]), 0.01),  # shortest distance .02, halved
        (np.array([0.3333, 0.6667, 1.0]), 1 / 3),  # written with four digits
        (np.array([0.5]), 0.5),
    ],
)
def test_saving_interval_hits_all_times(times, interval):
    # the rounding of the written times goes into the interval
    assert common_interval(times) == pytest.approx(interval, rel=1e-2)
    steps = times / common_interval(times)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)


def test_irregular_times_get_an_interval_to_interpolate_over():
    times = np.sort(np.random.default_rng(0).uniform(0, 1, 50))
    assert times[-1] / 4000 <= common_interval(times) <= times[-1] / 400


def test_corners_of_the_bounds():
    unknown = {"a": inverse.log(1, 10), "b": inverse.linear(0, 1, start=np.full(2, 0.5))}
    found = [(float(c["a"]), *c["b"]) for c in corners(unknown)]
    assert sorted(found) == [(1, 0, 0), (1, 1, 1), (10, 0, 0), (10, 1, 1)]
    many = {str(i): inverse.log(1, 10) for i in range(12)}
    assert len(list(corners(many))) == 2 + 2 * 12


def test_default_simulation_asks_for_the_stiffest_time_step(monkeypatch):
    calls = {}

    class Scene(dict):
        def replace(self, values):
            return Scene({**self, **values})

    def simulate(scene, **options):
        calls.update(options)
        return types.SimpleNamespace(at=lambda times: (scene, times))

    fake = types.SimpleNamespace(
        stable_time_step=lambda scene: 1e-3 / np.sqrt(scene["stiffness"] * (1 + scene["ratio"])),
        simulate=simulate,
    )
    monkeypatch.setitem(__import__("sys").modules, "jaxsph", fake)
    times = np.arange(1, 10) / 10
    scene = Scene(stiffness=4.0, ratio=0.0)
    unknown = {"stiffness": inverse.log(1, 100), "ratio": inverse.linear(-0.5, 0.44)}
    simulation = JaxsphSimulation(scene, lambda s, v: s.replace(v), unknown, times)
    run: Any = simulation(scene, times, "reverse")
    assert run == (scene, times)
    assert calls["time_step"] == pytest.approx(1e-3 / np.sqrt(144))
    assert calls["save_every"] == pytest.approx(0.1)
    assert calls["t_end"] == pytest.approx(0.9)
    assert calls["mode"] == "reverse"
