"""Fluids, walls and the scenes of both: what follows from what is given, and what is refused."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph import pytree
from jaxsph.geometry import box, jitter, tank

SPACING = 0.1
ABOUT: dict[str, Any] = {"density": 1000.0, "sound_speed": 20.0}


def water(name="water", d=2, kind: Any = np.float64, corner=0.0, **changes):
    return sph.Fluid(name, box((corner,) * d, (0.4,) * d, SPACING, dtype=kind), **{**ABOUT, **changes})


def basin(name="tank", d=2, kind: Any = np.float64, **changes):
    return sph.Wall(name, tank((0,) * d, (0.4,) * d, SPACING, 3, dtype=kind), **changes)


def plate():
    return sph.Structure("plate", box((2, 2), (0.3, 0.3), SPACING), 1000.0, 1e6, 0.3)


def scene(*more, **changes):
    about = {"gravity": (0.0, -9.81), "effects": [sph.ParticleShifting(strength=0.5), sph.DensityDiffusion(0.1)]}
    return sph.Scene(water(viscosity=0.5), basin(), *more, **{**about, **changes})


@pytest.mark.parametrize("law", [sph.LinearStateEquation(), sph.Cole(7.0), sph.LinearStateEquation(500.0)])
def test_initial_density_gives_the_pressure_that_was_asked_for(law):
    fluid = water(pressure=lambda x: 9810 * (0.4 - x[:, 1]), state_equation=law)
    np.testing.assert_allclose(fluid.pressure, 9810 * (0.4 - fluid.particles.positions[:, 1]), rtol=1e-15)
    deviation = fluid.initial_deviation()
    # expm1 and log1p of a density that deviates by a hundredth: a few roundings
    np.testing.assert_allclose(law.pressure(deviation, 1000.0, 20.0), fluid.pressure, rtol=1e-12)
    # The mass is density times volume, so that the volume m / rho at the start is that of the particles.
    np.testing.assert_allclose(fluid.mass() / (1000.0 + deviation), fluid.particles.volumes, rtol=1e-14)
    state = sph.initial_state(sph.Scene(fluid)).systems["water"]
    np.testing.assert_allclose(state["density_deviation"], deviation, rtol=1e-15)


def test_equal_particles_have_one_mass():
    """A mass that is one number is not gathered in the sums; it is the mean, since volumes differ by roundings."""
    assert np.shape(water().mass()) == () and water().mass() == pytest.approx(10.0, rel=1e-14)
    assert np.shape(water(pressure=np.zeros(16)).mass()) == (16,)
    uneven = pytree.replace(water().particles, volumes=np.linspace(0.009, 0.011, 16))
    fluid = sph.Fluid("water", uneven, **ABOUT)
    np.testing.assert_allclose(fluid.mass(), 1000 * uneven.volumes, rtol=1e-15)
    with_background = water(state_equation=sph.LinearStateEquation(400.0))
    assert with_background.mass() == pytest.approx(10.0 + 0.01 * 400 / 20**2, rel=1e-14), "no pressure is p = 0"
    assert water(kind=np.float32).mass().dtype == np.float32


def test_velocity_is_one_or_many_or_a_function():
    function = lambda x: np.stack([x[:, 1], -x[:, 0]], axis=1)  # noqa: E731
    for velocity, expected in ((None, 0), ((1.0, 2.0), (1.0, 2.0)), (function, function(water().particles.positions))):
        fields = sph.initial_state(sph.Scene(water(velocity=velocity))).systems["water"]
        np.testing.assert_array_equal(fields["velocity"], np.broadcast_to(expected, (16, 2)))
        np.testing.assert_array_equal(fields["position"], water().particles.positions)


def test_state_holds_what_the_scene_calls_for():
    plain = {"position", "velocity", "acceleration", "density_deviation"}
    for effects, extra in (
        ([], set()),
        ([sph.ParticleShifting()], {"shift"}),
        ([sph.DeltaDiffusion()], {"density_gradient"}),
        ([sph.DensityDiffusion()], set()),
    ):
        systems = sph.initial_state(scene(effects=effects)).systems
        assert set(systems["water"]) == plain | extra and systems["tank"] == {}
    for pressure in (sph.WallContinuity(), sph.WallSummation()):
        systems = sph.initial_state(sph.Scene(water(), basin(pressure=pressure))).systems
        assert set(systems["tank"]) == {"density_deviation"}
    moving = basin(motion=lambda t, x: jnp.stack([t + 0 * x[:, 0], 0 * x[:, 0]], axis=1))
    fields = sph.initial_state(sph.Scene(water(), moving)).systems["tank"]
    np.testing.assert_array_equal(fields["velocity"], np.broadcast_to([1.0, 0.0], moving.particles.positions.shape))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"name": "my water"}, "name 'my water' must be a word"),
        ({"density": 0.0}, r"density = 0\.0 must be positive and finite \[kg/m\^3\]"),
        ({"density": np.inf}, "density = inf must be positive"),
        ({"sound_speed": -1.0}, r"sound_speed = -1\.0 must be positive and finite \[m/s\]"),
        ({"viscosity": -1e-3}, r"viscosity = -0\.001 must be >= 0\.0 \[Pa s\]"),
        ({"density": np.full(16, 1000.0)}, r"density has shape \(16,\); it must be one number"),
        ({"sound_speed": np.full(2, 10.0)}, r"sound_speed has shape \(2,\); it must be one number"),
        ({"viscosity": np.ones(16)}, r"viscosity has shape \(16,\); it must be one number"),
        ({"velocity": (1.0, 2.0, 3.0)}, r"velocity has shape \(3,\); it must be \(2,\) or \(16, 2\)"),
        ({"velocity": lambda x: x[:, 0]}, r"velocity has shape \(16,\)"),
        ({"velocity": (1.0, np.nan)}, "velocity holds values that are not finite"),
        ({"pressure": 5.0}, r"pressure has shape \(\); it must be \(16,\)"),
        ({"pressure": np.full(16, np.inf)}, "pressure holds values that are not finite"),
        ({"pressure": np.full(16, -5e5)}, r"pressure reaches -5e\+05 Pa, .* a density of -250 kg/m\^3"),
        ({"pressure": np.full(16, -1e5), "state_equation": sph.Cole(7.0)}, r"pressure reaches -1e\+05 Pa"),
    ],
)
def test_a_fluid_that_cannot_be_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        water(**changes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"name": "a.b"}, "name 'a.b' must be a word"),
        ({"velocity": (1.0, 2.0, 3.0)}, r"velocity has shape \(3,\); it must be \(2,\)"),
        ({"velocity": (np.nan, 0.0)}, "velocity holds values that are not finite"),
        ({"velocity": (1.0, 0.0), "motion": lambda t, x: 0 * x}, "tank has both a motion and a velocity"),
    ],
)
def test_a_wall_that_cannot_be_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        basin(**changes)


def test_a_motion_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"motion of 'tank' returned the shape \(2,\); it must be \(54, 2\)"):
        basin(motion=lambda t, x: t * jnp.ones(2))


def test_placed_gives_the_derivatives_of_the_motion():
    """x = X + sin(3 t) (1, Y): velocity and acceleration by hand."""
    wall = basin(motion=lambda t, x: jnp.sin(3 * t) * jnp.stack([jnp.ones_like(x[:, 0]), x[:, 1]], axis=1))
    start = jnp.asarray(wall.particles.positions).T
    t, along = 0.4, np.stack([np.ones(54), wall.particles.positions[:, 1]])
    # a few roundings
    for got, expected in zip(
        wall.placed(start, jnp.asarray(t)),
        (start + np.sin(3 * t) * along, 3 * np.cos(3 * t) * along, -9 * np.sin(3 * t) * along),
        strict=True,
    ):
        np.testing.assert_allclose(got, expected, atol=1e-14)
    position, velocity, acceleration = basin(velocity=(2.0, 0.0)).placed(start, jnp.asarray(t))
    np.testing.assert_array_equal(position, start)
    np.testing.assert_array_equal(velocity, np.broadcast_to([[2.0], [0.0]], start.shape))
    np.testing.assert_array_equal(acceleration, 0)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: scene(water()), "same name: .*'water', 'tank', 'water'"),
        (lambda: sph.Scene(water(), basin(d=3)), "one dimension and one precision"),
        (lambda: sph.Scene(water(), basin(kind=np.float32)), "one dimension and one precision"),
        (lambda: sph.Scene(water("gravity")), "called 'gravity', which names a number of the scene"),
        (lambda: sph.Scene(water("smoothing_length")), "called 'smoothing_length'"),
        (lambda: sph.Scene(basin()), "a scene with walls needs a fluid"),
        (lambda: scene(effects=[sph.PenaltyForce(0.1)]), "PenaltyForce acts on a Structure, and the scene has none"),
        (lambda: scene(effects=[sph.Damping(0.1)]), "Damping acts on a Structure"),
        (lambda: sph.Scene(plate(), effects=[sph.DensityDiffusion()]), "DensityDiffusion acts on a Fluid"),
        (lambda: sph.Scene(plate(), effects=[sph.ParticleShifting()]), "ParticleShifting acts on a Fluid"),
        (
            lambda: scene(effects=[sph.ArtificialViscosity(), sph.ArtificialViscosity(0.1)]),
            "an effect can be listed once",
        ),
        (lambda: scene(domain=sph.Domain((0, 0, 0), (1, 1, 1))), "the domain has 3 axes, the particles 2"),
        (lambda: scene(smoothing_length=0.0), r"smoothing_length = 0\.0 must be positive and finite \[m\]"),
        (lambda: scene().replace({"smoothing_length": -1.0}), r"smoothing_length = -1\.0 must be positive"),
        (lambda: scene().replace({"water.viscosity": -1.0}), r"water\.viscosity = -1\.0 must be >= 0"),
        (lambda: scene().replace({"water.density": 0.0}), r"water\.density = 0\.0 must be positive"),
        (lambda: scene().replace({"water.velocity": np.zeros(3)}), r"water\.velocity has shape \(3,\)"),
        (
            lambda: scene().replace({"ParticleShifting.strength": -1.0}),
            r"ParticleShifting\.strength = -1\.0 must be >=",
        ),
        (lambda: scene().replace({"DensityDiffusion.coefficient": np.nan}), "coefficient = nan must be"),
        (lambda: sph.ContinuityDensity("surface"), "form = 'surface' of ContinuityDensity must be 'volume' or 'mass'"),
        (lambda: sph.ArtificialViscosity(-0.1), r"ArtificialViscosity\.alpha = -0\.1 must be >= 0"),
        (lambda: sph.ArtificialViscosity(0.1, -1.0), r"ArtificialViscosity\.beta = -1\.0 must be >= 0"),
        (lambda: sph.ParticleShifting(speed=0.0), r"ParticleShifting\.speed = 0\.0 must be positive"),
        (lambda: sph.DeltaDiffusion(-0.1), r"DeltaDiffusion\.coefficient = -0\.1 must be >= 0"),
        (lambda: sph.BernoulliExtrapolation(-1.0), r"BernoulliExtrapolation\.factor = -1\.0 must be >= 0"),
        (lambda: sph.Cole(0.0), r"Cole\.exponent = 0\.0 must be positive"),
    ],
)
def test_a_scene_that_does_not_fit_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_body_forces_can_be_many_and_act_on_anything():
    forces = [sph.BodyForce(lambda x, t: x), sph.BodyForce(lambda x, t: -x)]
    assert len(scene(effects=forces).effects) == 2 and len(sph.Scene(plate(), effects=forces).effects) == 2


PLACES = {
    "water.viscosity": 0.7,
    "water.density": 900.0,
    "water.sound_speed": 30.0,
    "water.velocity": (1.0, 2.0),
    "gravity": (0.5, 0.0),
    "smoothing_length": 0.17,
    "ParticleShifting.strength": 0.3,
    "DensityDiffusion.coefficient": 0.2,
}


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_numbers_are_found_and_replaced_by_name(kind):
    before = sph.Scene(
        water(viscosity=0.5, kind=kind), basin(kind=kind), effects=[sph.ParticleShifting(), sph.DensityDiffusion()]
    )
    for path, value in PLACES.items():
        after = before.replace({path: value})
        np.testing.assert_array_equal(after.get(path), np.asarray(value, kind))
        assert jax.jit(lambda v, path=path: before.replace({path: v}).get(path))(jnp.asarray(value)).dtype == kind
        for other in PLACES:
            if other != path:
                np.testing.assert_array_equal(after.get(other), before.get(other))
    assert before.smoothing_length == pytest.approx(0.15) and before.smoothing_length.dtype == kind
    moved = before.replace({"water.particles.positions": jitter(before["water"].particles, 0.1, 1).positions})
    assert not np.array_equal(moved["water"].particles.positions, before["water"].particles.positions)


def test_a_name_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(KeyError, match=r"'viscous' is not one of .*'viscosity'"):
        scene().get("water.viscous")
    with pytest.raises(KeyError, match=r"'ArtificialViscosity' is not one of .*'ParticleShifting'.*'water'"):
        scene().replace({"ArtificialViscosity.alpha": 0.1})


def test_systems_and_effects_are_found_by_kind():
    whole = scene(plate(), effects=[sph.DensityDiffusion(), sph.PenaltyForce(0.1), sph.ParticleShifting()])
    assert [len(kind) for kind in (whole.fluids, whole.walls, whole.structures)] == [1, 1, 1]
    assert [type(effect) for effect in whole.flow_effects] == [sph.DensityDiffusion]
    assert whole.spacing == SPACING
    said = str(whole)
    for words in ("water: 16 particles", "viscosity 0.5 Pa s", "tank: 54 particles", "no slip", "ContinuityDensity"):
        assert words in said
