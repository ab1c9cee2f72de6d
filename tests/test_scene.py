"""A scene finds and replaces its numbers by name, keeps its precision, and refuses what does not fit."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph

ABOUT: dict[str, Any] = {"density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}


def plate(name="plate", d=2, kind: Any = np.float64):
    return sph.Structure(name, sph.box((0,) * d, (0.3,) * d, 0.1, dtype=kind), **ABOUT)


def scene(**changes):
    about = {"gravity": (0.0, -9.81), "effects": [sph.PenaltyForce(0.05), sph.Damping(2.0)]}
    return sph.Scene(plate(), **{**about, **changes})


PLACES = {
    "plate.youngs_modulus": 2e6,
    "plate.poisson_ratio": 0.1,
    "plate.density": np.full(9, 900.0),
    "plate.velocity": (1.0, 2.0),
    "plate.smoothing_length": 0.1,
    "plate.particles.volumes": np.full(9, 0.02),
    "gravity": (0.5, 0.0),
    "PenaltyForce.coefficient": 0.1,
    "Damping.rate": 0.0,
}


@pytest.mark.parametrize("path", PLACES)
def test_numbers_are_found_and_replaced_by_name(path):
    before = scene()
    old = np.array(before.get(path))
    after = before.replace({path: PLACES[path]})
    np.testing.assert_array_equal(after.get(path), PLACES[path])
    np.testing.assert_array_equal(before.get(path), old, err_msg="the scene itself does not change")
    for other in PLACES:
        if other != path:
            np.testing.assert_array_equal(after.get(other), before.get(other))


def test_all_at_once_and_a_system_by_name():
    after = scene().replace(PLACES)
    for path, value in PLACES.items():
        np.testing.assert_array_equal(after.get(path), value)
    assert after["plate"].name == "plate" and after.effect(sph.Damping).rate == 0
    assert sph.Scene(plate()).effect(sph.Damping) is None


def test_precision_is_kept():
    single = sph.Scene(plate(kind=np.float32), effects=[sph.PenaltyForce(0.05)])
    assert single.dtype == np.float32 and single.gravity.dtype == np.float32
    for path in ("plate.youngs_modulus", "gravity", "PenaltyForce.coefficient"):
        value = np.zeros(2) if path == "gravity" else 2e6
        assert single.replace({path: value}).get(path).dtype == np.float32
        traced = jax.jit(lambda v, path=path: single.replace({path: v}).get(path))(value)
        assert traced.dtype == np.float32
    of_array = sph.Scene(plate(kind=np.float32), effects=[sph.Damping(np.float64(2.0))])  # type: ignore[arg-type]
    assert np.asarray(of_array.get("Damping.rate")).dtype == np.float32, "one float64 would make the whole run float64"


def test_traced_numbers_are_let_through_and_differentiated():
    def of(e):
        inside = scene().replace({"plate.youngs_modulus": e, "gravity": jnp.stack([e, e])})
        assert "(traced)" in str(inside)
        return inside.get("plate.youngs_modulus") ** 2 + inside.get("gravity")[0]

    assert jax.grad(of)(3.0) == 7.0


def test_a_scene_is_a_pytree_of_its_numbers():
    doubled = jax.tree.map(lambda v: 2 * v if np.asarray(v).dtype.kind == "f" else v, scene())
    assert doubled.get("plate.youngs_modulus") == 2e6 and doubled.effect(sph.Damping).rate == 4.0


def test_it_says_what_is_in_it():
    said = str(scene())
    for words in (
        "2D, float64",
        "plate: 9 particles, spacing 0.1 m, 0 clamped",
        "E 1e+06 Pa",
        "(0, -9.81) m/s^2",
        "PenaltyForce",
    ):
        assert words in said


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: sph.Scene(), "at least one system"),
        (lambda: sph.Scene("plate"), "made of fluids, walls, structures and rigid bodies, not of str"),
        (lambda: sph.Scene(plate(), plate()), r"same name: \['plate', 'plate'\]"),
        (lambda: sph.Scene(plate(), plate("b", 3)), "one dimension and one precision"),
        (lambda: sph.Scene(plate(), plate("b", kind=np.float32)), "one dimension and one precision"),
        (lambda: scene(gravity=(0.0, 0.0, -9.81)), r"gravity has shape \(3,\); it must be \(2,\)"),
        (lambda: scene(gravity=(0.0, np.inf)), "gravity holds values that are not finite"),
        (lambda: scene(effects=["drag"]), "'drag' is not an effect"),
        (lambda: scene(effects=[sph.Damping(1.0), sph.Damping(2.0)]), "an effect can be listed once"),
        (lambda: sph.Damping(-1.0), r"Damping\.rate = -1\.0 must be >= 0\.0 \[1/s\]"),
        (lambda: sph.PenaltyForce(-0.1), r"PenaltyForce\.coefficient = -0\.1 must be >= 0\.0"),
        (lambda: sph.PenaltyForce(float("nan")), "coefficient = nan must be"),
        (lambda: scene().replace({"plate.youngs_modulus": -1.0}), r"plate\.youngs_modulus = -1\.0 must be positive"),
        (lambda: scene().replace({"plate.density": 0.0}), r"plate\.density = 0\.0 must be positive"),
        (lambda: scene().replace({"plate.poisson_ratio": 0.5}), "poisson_ratio = 0.5 must lie between"),
        (lambda: scene().replace({"plate.density": np.ones(4)}), r"plate\.density has shape \(4,\)"),
        (lambda: scene().replace({"plate.smoothing_length": -0.1}), r"smoothing_length = -0\.1 must be positive"),
        (lambda: scene().replace({"plate.velocity": (1.0, np.nan)}), "velocity holds values that are not finite"),
        (lambda: scene().replace({"plate.velocity": 1.0}), r"plate\.velocity has shape \(\)"),
        (lambda: scene().replace({"gravity": 9.81}), r"gravity has shape \(\); it must be \(2,\)"),
        (lambda: scene().replace({"gravity": (0.0, np.nan)}), "gravity holds values that are not finite"),
        (
            lambda: scene().replace({"PenaltyForce.coefficient": -1.0}),
            r"PenaltyForce\.coefficient = -1\.0 must be >= 0",
        ),
        (lambda: scene().replace({"plate.particles.volumes": np.zeros(9)}), r"volumes\[0\] = 0\.0 must be positive"),
        (lambda: scene().replace({"plate.particles.positions": np.zeros((4, 2))}), r"volumes has shape \(9,\)"),
        (lambda: sph.scenes.turek_hron_beam(2), "particles = 2 across the thickness"),
    ],
)
def test_what_does_not_fit_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("plat.youngs_modulus", r"nothing stands at 'plat.youngs_modulus': 'plat' is not one of .*'plate'"),
        ("plate.young", "'young' is not one of .*'youngs_modulus'"),
        ("plate.youngs_modulus.x", "'x' is not one of"),
        ("Viscosity.coefficient", "'Viscosity' is not one of .*'PenaltyForce'"),
    ],
)
def test_a_name_that_is_not_there_is_refused_with_those_that_are(path, said):
    with pytest.raises(KeyError, match=said):
        scene().get(path)
    with pytest.raises(KeyError, match=said):
        scene().replace({path: 1.0})
    with pytest.raises(KeyError, match=r"no system is called 'tank'; there are \['plate'\]"):
        scene()["tank"]
