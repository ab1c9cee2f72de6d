"""Runs: saved and read back, continued bit for bit, stopped with a reason; a wave, and both precisions."""

import csv
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import beam, block, with_particles

import jaxsph as sph
from jaxsph import checks, pytree
from jaxsph.files import read_state, read_trajectory

FIELDS = ("displacement", "velocity", "acceleration")
REFERENCE = Path(__file__).parent / "reference"


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_file_holds_the_trajectory(tmp_path, kind):
    scene = beam(kind)
    run = sph.simulate(scene, 0.03, 0.01, out=tmp_path / "run.vtkhdf")
    times, systems, about = read_trajectory(tmp_path / "run.vtkhdf")
    np.testing.assert_array_equal(times, run.times)
    for field in FIELDS:
        assert systems["beam"][field].dtype == kind
        np.testing.assert_array_equal(systems["beam"][field], run["beam"][field])
    np.testing.assert_array_equal(systems["beam"]["position"], run.positions("beam"))
    stresses = jax.jit(lambda state: sph.observe.stresses(scene, state, "beam", sph.topologies(scene)))(run.final)
    # the same operations, compiled apart: some roundings of the largest stress
    tolerance = 100 * np.finfo(kind).eps * np.abs(stresses["cauchy"]).max()
    np.testing.assert_allclose(systems["beam"]["cauchy_stress"][-1], stresses["cauchy"], rtol=0, atol=tolerance)
    np.testing.assert_allclose(systems["beam"]["von_mises"][-1], stresses["von_mises"], rtol=0, atol=tolerance)
    assert about["units"]["cauchy_stress"] == "Pa" and about["units"]["velocity"] == "m/s"
    named = {item["name"]: (item["value"], item["unit"]) for item in about["parameters"]}
    assert named["beam.youngs_modulus"] == (1e6, "Pa")
    assert about["time_step"] == run.time_step and "42 particles" in about["scene"]
    assert read_state(tmp_path / "run.vtkhdf", sph.initial_state(scene), scene).time == run.times[-1]


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_run_is_continued_bit_for_bit(tmp_path, kind):
    """In one go, from the last state, and from the file."""
    scene = beam(kind, effects=[sph.Damping(3.0)])
    whole = sph.simulate(scene, 0.04, 0.01)
    half = sph.simulate(scene, 0.02, 0.01, out=tmp_path / "half.vtkhdf")
    read = read_state(tmp_path / "half.vtkhdf", sph.initial_state(scene), scene)
    for start in (half.final, read):
        rest = sph.simulate(scene, 0.02, 0.01, state=start)
        assert jax.tree.structure(rest.final) == jax.tree.structure(whole.final)
        for got, expected in zip(jax.tree.leaves(rest.final), jax.tree.leaves(whole.final), strict=True):
            assert got.dtype == expected.dtype
            np.testing.assert_array_equal(got, expected)
        np.testing.assert_array_equal(rest.times, whole.times[2:])
        for field in FIELDS:
            np.testing.assert_array_equal(rest["beam"][field], whole["beam"][field][2:])


def test_traced_and_plain_runs_agree():
    """The compiled whole and the run from save to save are the same steps."""
    scene = beam()
    dt = sph.stable_time_step(scene)
    plain = sph.simulate(scene, 20 * dt, 10 * dt, time_step=dt)
    for mode in ("reverse", "forward"):
        of = lambda e, mode=mode: sph.simulate(  # noqa: E731
            scene.replace({"beam.youngs_modulus": e}), 20 * dt, 10 * dt, time_step=dt, mode=mode
        )
        traced = jax.jit(of)(1e6)
        for field in FIELDS:
            largest = np.abs(plain["beam"][field]).max()
            # the same operations, fused in another way, twenty times
            np.testing.assert_allclose(traced["beam"][field], plain["beam"][field], rtol=0, atol=1e-11 * largest)


def test_the_state_alone_may_be_traced():
    scene = beam()
    dt = sph.stable_time_step(scene)
    plain = sph.simulate(scene, 20 * dt, time_step=dt)
    traced = jax.jit(lambda state: sph.simulate(scene, 20 * dt, state=state).states)(sph.initial_state(scene))
    for field in FIELDS:
        largest = np.abs(plain["beam"][field]).max()
        # the same operations, fused in another way, twenty times
        np.testing.assert_allclose(traced.systems["beam"][field], plain["beam"][field], rtol=0, atol=1e-11 * largest)


def test_order_of_the_particles_is_the_users():
    scene = beam()
    structure = scene["beam"]
    order = np.random.default_rng(2).permutation(structure.n_particles)
    particles = structure.particles
    mixed = with_particles(structure, positions=particles.positions[order], volumes=particles.volumes[order])
    mixed = pytree.replace(scene, systems=(pytree.replace(mixed, clamped=structure.clamped[order]),))
    one, other = (sph.simulate(s, 0.01, time_step=2e-4)["beam"] for s in (scene, mixed))
    for field in FIELDS:
        # sums of the same terms in another order, for some fifty steps
        np.testing.assert_allclose(other[field], one[field][:, order], rtol=0, atol=1e-10 * np.abs(one[field]).max())


def test_float32_is_close_to_float64():
    """Rounding of 6e-8 a step, 200 steps, and the moduli and spacings that differ by a rounding from the start."""
    runs = [sph.simulate(beam(kind), 0.04, 0.01, time_step=2e-4)["beam"] for kind in (np.float32, np.float64)]
    single, double = (np.asarray(run["displacement"]) for run in runs)
    assert single.dtype == np.float32
    assert np.abs(single - double).max() < 2e-4 * np.abs(double).max()


def test_two_structures_do_not_feel_each_other():
    one, other = beam()["beam"], pytree.replace(block(2, on_surface=True), velocity=np.array([1.0, 0.0]))
    both = sph.simulate(sph.Scene(one, other, gravity=(0.0, -5.0)), 0.002, time_step=1e-4)
    for structure in (one, other):
        alone = sph.simulate(sph.Scene(structure, gravity=(0.0, -5.0)), 0.002, time_step=1e-4)
        got, expected = both[structure.name]["displacement"], alone[structure.name]["displacement"]
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-13 * np.abs(expected).max())  # round-off


def exploding(kind: Any = np.float64):
    """A beam of which one end is thrown through the other: neo-Hookean stress is not defined inside out."""
    scene = beam(kind)
    x = np.asarray(scene["beam"].particles.positions)
    velocity = np.where(x[:, :1] > 0.05, [-80.0, 0.0], [0.0, 0.0])
    structure = pytree.replace(scene["beam"], law=sph.NeoHookean(), velocity=velocity.astype(kind))
    return pytree.replace(scene, systems=(structure,))


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_run_that_blows_up_stops_with_the_reason_and_keeps_the_rest(tmp_path, kind):
    said = (
        r"not finite at or before step \d+ \(t = [\d.e-]+ s\): \w+ of particle \d+ of 'beam' \(\d+ particles in all\); "
        r".*smaller time_step.*PenaltyForce"
    )
    with pytest.raises(sph.NotFinite, match=said) as caught:
        sph.simulate(exploding(kind), 5e-3, 5e-5, out=tmp_path / "run.vtkhdf")
    kept = caught.value.trajectory
    times, systems, _ = read_trajectory(tmp_path / "run.vtkhdf")
    assert 2 <= len(kept.times) < 100
    np.testing.assert_array_equal(times, kept.times)
    for field in FIELDS:
        assert np.all(np.isfinite(kept["beam"][field]))
        np.testing.assert_array_equal(systems["beam"][field], kept["beam"][field])
    went_on = sph.initial_state(exploding(kind))
    assert read_state(tmp_path / "run.vtkhdf", went_on).time == times[-1]
    assert not list(tmp_path.glob("*.part"))


def test_progress_counts_the_saves(capsys):
    sph.simulate(beam(), 0.003, 0.001, progress=True)
    assert "3/3" in capsys.readouterr().err


def test_steps_divide_the_interval_of_the_saves():
    scene = beam()
    run = sph.simulate(scene, 0.01, 0.005, time_step=3e-4)
    assert run.time_step == pytest.approx(0.005 / 17) and list(run.states.step) == [0, 17, 34]
    whole = sph.simulate(scene, 0.01)
    assert list(whole.times) == [0, 0.01] and whole.time_step <= sph.stable_time_step(scene)


def test_wave_in_a_bar_arrives_when_it_should():
    """A slab pushed at one face: no sound from its sides reaches the middle of the far face before the wave does.

    The front counts as arrived when half of the speed that it brings is there. It is late by one spacing, 5 % at 20
    of them along the bar and 1 % at 80.
    """
    with open(REFERENCE / "solid" / "bar_wave.csv", encoding="utf-8") as file:
        row = {key: float(value) for key, value in next(iter(csv.DictReader(file))).items()}
    length, arrival = row["L"], row["arrival_time"]
    spacing, rise, speed = 0.0125, 0.3 * row["arrival_time"], 1e-3

    def pushed(t, x):
        s = jnp.clip(t / rise, 0.0, 1.0)
        way = rise * (s**3 - 0.5 * s**4) + jnp.maximum(t - rise, 0.0)
        return jnp.stack([speed * way + 0 * x[:, 0], 0 * x[:, 0]], axis=1)

    slab = sph.Structure(
        "slab",
        sph.box((-3 * spacing, -1.0), (length + 3 * spacing, 2.0), spacing, on_surface=True),
        density=row["rho"],
        youngs_modulus=row["E"],
        poisson_ratio=row["nu"],
        clamped=lambda x: x[:, 0] < 0.01 * spacing,
        motion=pushed,
    )
    run = sph.simulate(sph.Scene(slab), 1.35 * arrival, 0.015 * arrival)
    end = np.asarray(run.probe("slab", (length, 0.0)).velocity)[:, 0]
    times, rising = np.asarray(run.times), slice(None, int(np.argmax(end)) + 1)
    # the free face doubles the speed of the wave, so half of it is the speed of the push
    found = np.interp(speed, end[rising], times[rising]) - rise / 2
    assert found == pytest.approx(arrival, rel=0.02)
    assert end[times < 0.9 * arrival].max() < 0.1 * speed


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"t_end": 0.0}, r"t_end = 0\.0 must be positive and finite \[s\]"),
        ({"t_end": float("nan")}, "t_end = nan must be positive"),
        ({"save_every": -1e-3}, r"save_every = -0\.001 must be positive"),
        (
            {"save_every": 3e-3},
            r"t_end = 0\.01 s is not a multiple of save_every = 0\.003 s; the nearest is t_end = 0\.009 s",
        ),
        ({"save_every": 0.05}, r"the nearest is t_end = 0\.05 s"),
        ({"time_step": 0.0}, r"time_step = 0\.0 must be positive"),
        ({"time_step": -1e-4}, r"time_step = -0\.0001 must be positive"),
        ({"mode": "backward"}, "mode 'backward' must be 'reverse' or 'forward'"),
        ({"out": "/nowhere/at/all/run.vtkhdf"}, "does not exist; create it first"),
        ({"state": sph.initial_state(sph.Scene(block(2)))}, r"state has the systems \['block'\], the scene \['beam'\]"),
        (
            {"state": sph.initial_state(beam(np.float32))},
            r"is \(42, 2\) float32; the scene needs .* float64",
        ),
        (
            {"state": sph.initial_state(sph.scenes.turek_hron_beam(3))},
            r"is \(117, 2\) float64; the scene needs \(42, 2\)",
        ),
    ],
)
def test_what_does_not_fit_is_refused(options, said):
    with pytest.raises(ValueError, match=said):
        sph.simulate(beam(), **{"t_end": 0.01, **options})


def test_what_does_not_work_on_traced_numbers_is_refused(tmp_path):
    def run(**options):
        scene = beam()
        return jax.jit(lambda e: sph.simulate(scene.replace({"beam.youngs_modulus": e}), 0.001, **options).times)(1e6)

    with pytest.raises(ValueError, match="time_step is needed when numbers of the scene are traced"):
        run()
    with pytest.raises(ValueError, match="out= and progress= need plain numbers"):
        run(time_step=1e-4, out=tmp_path / "run.vtkhdf")
    with pytest.raises(ValueError, match="t_end must be a plain number, not a traced one"):
        jax.jit(lambda t: checks.check_time("t_end", t))(0.001)
    with pytest.raises(ValueError, match=r"positions or the smoothing length of 'beam' are traced.*topologies"):
        scaled = lambda h: beam().replace({"beam.smoothing_length": h})  # noqa: E731
        jax.jit(lambda h: sph.simulate(scaled(h), 0.001, time_step=1e-4).times)(0.01)


def test_a_scene_in_which_nothing_can_move_is_refused():
    scene = sph.Scene(block(2, clamped=np.ones(36, bool)))
    with pytest.raises(ValueError, match="no particle of the scene can move"):
        sph.simulate(scene, 0.01)


def test_the_file_of_a_run_is_not_replaced_by_what_continues_it(tmp_path):
    """Its states would be lost; a file of another run, or no file of ours, is replaced."""
    scene, path = sph.Scene(block()), tmp_path / "run.vtkhdf"
    half = sph.simulate(scene, 2e-3, 1e-3, out=path)
    with pytest.raises(ValueError, match=r"run\.vtkhdf: holds the run that this one continues"):
        sph.simulate(scene, 2e-3, 1e-3, state=half.final, out=path)
    sph.simulate(scene, 1e-3, 1e-3, out=path)
    sph.simulate(scene, 2e-3, 1e-3, state=half.final, out=path)
    (tmp_path / "text").write_text("not a file of ours")
    sph.simulate(scene, 2e-3, 1e-3, state=half.final, out=tmp_path / "text")
    with pytest.raises(ValueError, match="does not exist; create it first"):
        sph.simulate(scene, 2e-3, 1e-3, out=tmp_path / "nowhere" / "run.vtkhdf")
