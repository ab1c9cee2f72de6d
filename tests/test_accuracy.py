"""Work-precision studies: tables whose answers are known, and one small real scene."""

import math
from typing import Any

import jax
import numpy as np
import pytest

import jaxsph as sph
from jaxsph import accuracy
from jaxsph.accuracy import Results, Row, Study
from jaxsph.accuracy.settings import applied, integrator_of, listed

ORDER, GROWTH = 1.5, 3.0


def known(n: Any, constant=0.5, order=ORDER, price=1e-4, **settings: Any) -> Row:
    """error = constant n^-order in price n^GROWTH seconds."""
    return Row({"particles": n, **settings}, {"error": constant * n**-order}, price * n**GROWTH, steps=10 * n,
               n_particles=n * n)  # fmt: skip


def two_families() -> Results:
    """The second is less accurate and cheaper."""
    rows = [known(n, kernel="a") for n in (8, 16, 32)]
    rows += [known(n, constant=2.0, price=1e-5, kernel="b") for n in (8, 16, 32)]
    return Results(tuple(rows))


class KnownStudy(Study):
    """A study whose runs are not made but known."""

    def measure(self, settings: Any):
        n = settings["particles"]
        others: dict[str, Any] = {k: v for k, v in settings.items() if k != "particles"}
        row = known(n, **others)
        scale = self.t_end / 2.0
        row = Row(row.settings, row.errors, row.seconds * scale, steps=row.steps, n_particles=row.n_particles)
        observed = None if self.observe is None else np.array([3.0, 4.0]) * (1 + 0.2 * n**-ORDER)
        return row, observed


def test_pareto_front_against_all_pairs():
    rng = np.random.default_rng(0)
    rows = tuple(Row({"run": i}, {"error": float(e)}, float(s)) for i, (e, s) in enumerate(rng.uniform(size=(60, 2))))
    results = Results(rows, resolution=None)
    errors, seconds = results["error"], results["seconds"]
    beaten = [
        bool(np.any((errors <= errors[i]) & (seconds <= seconds[i]) & ((errors < errors[i]) | (seconds < seconds[i]))))
        for i in range(len(rows))
    ]
    front = results.pareto()
    assert {row.settings["run"] for row in front} == {i for i in range(len(rows)) if not beaten[i]}
    assert np.all(np.diff(front["seconds"]) > 0) and np.all(np.diff(front["error"]) < 0)


def test_cheapest_and_best_read_the_known_answer():
    results = two_families()
    # a: errors .022, .0078, .0028 in .051, .41, 3.3 s; b: errors .088, .031, .011 in a tenth of that
    assert accuracy.cheapest(results, 0.025).settings == {"particles": 8, "kernel": "a"}
    assert accuracy.cheapest(results, 0.05).settings == {"particles": 16, "kernel": "b"}
    assert accuracy.cheapest(results, 0.012).settings == {"particles": 32, "kernel": "b"}
    assert accuracy.best(results, 0.35).settings == {"particles": 32, "kernel": "b"}
    assert accuracy.best(results, 0.5).settings == {"particles": 16, "kernel": "a"}
    assert accuracy.best(results, 5120, cost="particle_steps").settings == {"particles": 8, "kernel": "a"}
    with pytest.raises(ValueError, match=r"the best is 0\.00276"):
        accuracy.cheapest(results, 1e-3)
    with pytest.raises(ValueError, match=r"the cheapest has 0\.00512"):
        accuracy.best(results, 1e-3)
    with pytest.raises(ValueError, match="no runs yet"):
        accuracy.best(Results(()), 1.0)


def test_a_lucky_run_is_not_taken_for_an_accurate_one():
    """An error that changes its sign between 8 and 32 is small at 16 by chance."""
    rows = [known(8), Row({"particles": 16}, {"error": 1e-6}, 0.4), known(32), known(64)]
    results = Results(tuple(rows))
    np.testing.assert_allclose(results.reliable(), [known(n).errors["error"] for n in (8, 32, 32, 64)])
    assert accuracy.cheapest(results, 0.001).settings == {"particles": 64}
    assert accuracy.cheapest(results, 0.003).settings == {"particles": 16}, "the finer one holds it too"


def test_failed_runs_are_in_the_table_but_on_no_front():
    failed = Row({"particles": 64}, {"error": math.nan}, math.nan, failure="NotFinite: at step 3")
    results = Results((known(8), failed))
    assert len(results.pareto()) == 1 and "NotFinite" in str(results)
    assert accuracy.best(results, 1e9).settings == {"particles": 8}


@pytest.mark.parametrize("name", ["table.csv", "table.h5"])
def test_files_give_back_the_same(tmp_path, name):
    rows = (
        known(8, kernel="WendlandC2", tolerance=None, on=True),
        Row({"particles": 16, "kernel": "12", "factor": 0.1}, {"error": 1 / 3, "other": math.inf}, 1.5, 2.5, 7, 11, 3e6,
            1e-3, 'a "quoted", failure\nin two lines'),
    )  # fmt: skip
    results = Results(rows, "particles", "A title")
    loaded = Results.load(results.save(tmp_path / "new" / name))
    assert (loaded.title, loaded.resolution) == ("A title", "particles")
    for old, new in zip(results, loaded, strict=True):
        assert {k: v for k, v in new.settings.items() if v is not None} == {
            k: v for k, v in old.settings.items() if v is not None
        }
        assert all(type(new.settings[k]) is type(v) for k, v in old.settings.items())
        np.testing.assert_equal({k: new.errors[k] for k in old.errors}, old.errors)
        for name in ("seconds", "compile_seconds", "steps", "n_particles", "memory", "time_step", "failure"):
            np.testing.assert_equal(getattr(new, name), getattr(old, name))
    np.testing.assert_equal(loaded["seconds"], results["seconds"])


def test_strange_files_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match="does not begin with the line"):
        Results.load(tmp_path / "a.csv")
    with pytest.raises(ValueError, match="a table is written as"):
        two_families().save(tmp_path / "a.txt")


def test_columns_and_the_table():
    results = two_families()
    assert results.varied == ["particles", "kernel"] and results.where(kernel="a").varied == ["particles"]
    table = results.table
    np.testing.assert_array_equal(table["particles"], [8, 16, 32] * 2)
    np.testing.assert_array_equal(table["particle_steps"], 10 * table["particles"] ** 3)
    assert table["kernel"].tolist() == ["a"] * 3 + ["b"] * 3
    with pytest.raises(KeyError, match="no column 'x'"):
        results["x"]


def test_picture_has_a_line_for_each_family_and_the_front(tmp_path):
    results = two_families()
    (axes,) = results.plot(tmp_path / "a.png").axes
    assert (tmp_path / "a.png").stat().st_size > 10_000
    names = [str(text) for text in axes.get_legend_handles_labels()[1]]
    assert names == ["a", "b", "Pareto front"]
    front = results.pareto()
    assert [text.get_text() for text in axes.texts] == [f"particles {row.settings['particles']}" for row in front]


def test_picture_shows_a_front_of_one_run():
    """Also then there is a mark, which a line through one point would not be, and the run's resolution."""
    rows = [row for row in two_families() if row.settings["kernel"] == "b"][-1:]
    (axes,) = Results(tuple(rows)).plot().axes
    (front,) = [line for line in axes.get_lines() if line.get_label() == "Pareto front"]
    assert np.shape(front.get_xdata()) == (1,) and front.get_marker() == "o"
    assert [text.get_text() for text in axes.texts] == ["particles 32"]


def study(**options: Any):
    about: dict[str, Any] = {"error_of": lambda run: 0.0} if "observe" not in options else {}
    return KnownStudy(lambda **settings: None, 2.0, 0.1, **(about | options))


@pytest.mark.parametrize("blind", [False, True])
def test_recommend_extrapolates_to_a_tolerance(blind, capsys):
    """With a reference, and without one from how runs differ."""
    case = study(observe=lambda run: run) if blind else study()
    size = 0.2 if blind else 0.5
    found = accuracy.recommend(case, tolerance=1e-3, resolutions=(10, 14, 20), settings={"kernel": "a"}, confirm=False)
    wanted = math.ceil((size / 1e-3) ** (1 / ORDER))
    # relative to the finest observed value, not to the limit: 1 + .2 / 20^1.5
    assert found.settings == {"particles": pytest.approx(wanted, abs=1), "kernel": "a"}
    assert found.order == pytest.approx(ORDER, abs=0.01)
    assert found.error == pytest.approx(1e-3, rel=0.05)
    assert found.seconds == pytest.approx(1e-4 * wanted**GROWTH, rel=0.1)
    assert found.growth == pytest.approx(GROWTH, abs=0.05)
    assert f"particles = {found.settings['particles']}" in capsys.readouterr().out


def test_recommend_for_a_time_confirms_with_a_short_run():
    found = accuracy.recommend(study(), seconds=1000.0, resolutions=(10, 20), show=False)
    assert found.settings["particles"] == pytest.approx((1000 / 1e-4) ** (1 / GROWTH), abs=1)
    particles: Any = found.settings["particles"]
    # the start of the run, up to the first save, took its share: t_end / save_every times that
    assert found.seconds == pytest.approx(1e-4 * particles**GROWTH, rel=1e-6)
    assert "more than 4 times the finest run" in str(found)


def test_recommend_does_not_run_a_guess():
    """The scene of an error that is far off may be larger than any machine."""
    ran = []

    class Counted(KnownStudy):
        def measure(self, settings: Any):
            ran.append(settings["particles"])
            return super().measure(settings)

    case = Counted(lambda **settings: None, 2.0, 0.1, error_of=lambda run: 0.0)
    found = accuracy.recommend(case, tolerance=1e-7, resolutions=(10, 20), show=False)
    assert ran == [10, 20] and found.settings["particles"] > 1000  # type: ignore[operator]
    assert "a guess" in str(found)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"resolutions": (10, 20)}, "one of the two"),
        ({"tolerance": 0.1, "resolutions": (10,)}, "with one two"),
        ({"seconds": 1e-9, "resolutions": (10, 20)}, "too few for any resolution"),
    ],
)
def test_recommend_refuses(options, said):
    with pytest.raises(ValueError, match=said):
        accuracy.recommend(study(), show=False, **options)


def test_recommend_says_when_the_resolution_does_not_help():
    class Flat(KnownStudy):
        def measure(self, settings: Any):
            return known(settings["particles"], order=0.0), None

    with pytest.raises(ValueError, match="another setting limits it"):
        accuracy.recommend(Flat(lambda: None, 1.0, error_of=lambda run: 0.0), tolerance=0.1, resolutions=(10, 20))


def test_settings_that_there_are_not():
    scene = sph.scenes.taylor_green(8)
    for settings, said in (
        ({"kernel": "Kernel"}, "must be one of"),
        ({"precision": "float16"}, "must be 'float32' or 'float64'"),
        ({"neighbors": -1}, "neighbors"),
    ):
        with pytest.raises(ValueError, match=said):
            applied(scene, settings)
    with pytest.raises(ValueError, match="give it a name"):
        listed([{"kernel": sph.WendlandC2()}])
    for settings, said in (
        ({"integrator": "Nothing"}, "a solver of diffrax"),
        ({"tolerance": 1e-3}, "KickDriftKick has no tolerance"),
        ({"integrator": "Tsit5", "step_fraction": 0.5}, "chooses its own steps"),
    ):
        with pytest.raises(ValueError, match=said):
            integrator_of(settings)
    with pytest.raises(ValueError, match="one of the two"):
        Study(lambda: None, 1.0)


def test_neighbors_and_kernel_of_fluids_and_structures():
    fluid = sph.scenes.taylor_green(20)
    changed = applied(fluid, {"kernel": "WendlandC2", "neighbors": 28, "precision": "float32"})
    assert isinstance(changed.kernel, sph.WendlandC2) and changed.dtype == np.float32
    # the lattice counts 25 to 32 within a circle whose area is that of 28 cells
    near = np.linalg.norm(np.asarray(fluid["water"].particles.positions) - 0.525, axis=1)
    assert 25 <= np.sum(near < 2 * float(changed.smoothing_length)) <= 32
    solid = applied(sph.scenes.turek_hron_beam(5), {"neighbors": 20})
    expected = solid["beam"].particles.spacing * math.sqrt(20 / math.pi) / 2
    assert float(solid["beam"].smoothing_length) == pytest.approx(expected)


def test_a_real_study_of_a_beam():
    """Its own finer run is the reference; the table has what a run cost."""
    tip = lambda run: run.probe("beam", at=(0.35, 0.0)).displacement[:, 1]  # noqa: E731
    case = Study(
        lambda particles=3: sph.scenes.turek_hron_beam(particles),
        0.04,
        0.02,
        observe=tip,
        reference={"particles": 5},
        title="beam",
    )
    results = case.run(
        [
            {"particles": 3},
            {"particles": 3, "step_fraction": 0.5},
            {"particles": 3, "step_fraction": 1.2},
        ]
    )
    default, half, unstable = results
    assert case.results.rows == results.rows
    # at rest it falls freely for a while: the resolutions differ little, the time steps less
    assert 0 < default.errors["error"] < 0.05
    assert half.errors["error"] == pytest.approx(default.errors["error"], rel=0.05)
    # half of the largest stable step, the default is .9; both are rounded so that saves are hit
    assert half.steps / default.steps == pytest.approx(1.8, rel=0.05)
    assert default.time_step * default.steps == pytest.approx(0.04)
    assert default.n_particles == sph.scenes.turek_hron_beam(3)["beam"].n_particles
    assert default.particle_steps == default.steps * default.n_particles
    assert default.seconds > 0 and default.compile_seconds > 0 and (default.memory >= 0 or math.isnan(default.memory))
    assert "UnstableTimeStep" in unstable.failure and math.isnan(unstable.errors["error"])
    assert accuracy.cheapest(case, 0.1).settings["particles"] == 3


def test_precision_needs_jax_to_allow_it():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match="jax_enable_x64"):
            applied(sph.scenes.turek_hron_beam(3, dtype=np.float32), {"precision": "float64"})
    finally:
        jax.config.update("jax_enable_x64", True)
