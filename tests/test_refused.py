"""What a scene, a law, a geometry or an observer refuses, with the value, the limit and the cure."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph import observe, scenes
from jaxsph.checks import check_kind
from jaxsph.geometry import box, tank
from jaxsph.materials import MorrisViscosity, ViscosityLaw

SPACING = 0.1


def water(**changes):
    about: dict[str, Any] = {"density": 1000.0, "sound_speed": 20.0}
    return sph.Fluid("water", box((0, 0), (0.4, 0.4), SPACING), **{**about, **changes})


def oil():
    return sph.Fluid("oil", box((0, 0.4), (0.4, 0.2), SPACING), 800.0, 20.0)


def basin(pressure: Any = None):
    return sph.Wall("tank", tank((0, 0), (0.4, 0.6), SPACING, 4), pressure or sph.AdamiExtrapolation())


REFUSED = {
    "a class for a kernel": (lambda: sph.Scene(water(), kernel=sph.WendlandC4), "not a Kernel; call it"),
    "a class for a density": (lambda: sph.Scene(water(), density=sph.SummationDensity), "not a DensityCalculator"),
    "repulsion without walls": (lambda: sph.Scene(water(), effects=[sph.WallRepulsion()]), "acts at a Wall"),
    "a wall's density without a rate": (
        lambda: sph.Scene(water(), basin(sph.WallContinuity()), density=sph.SummationDensity()),
        "follows the density's rate, which SummationDensity does not calculate",
    ),
    "a solid's density without a rate": (
        lambda: sph.Scene(
            water(),
            sph.RigidBody("ball", box((0.5, 0), (0.2, 0.2), SPACING), density=500.0, pressure=sph.WallContinuity()),
            density=sph.EDAC(free_surface=True),
        ),
        "takes its pressure from an equation of state",
    ),
    "a wall of two fluids": (lambda: sph.Scene(water(), oil(), basin(sph.WallSummation())), "and the scene has 2"),
    "one particle over a gate": (lambda: scenes.elastic_gate(across=1), "across = 1"),
    "one over a plate": (lambda: scenes.water_column_on_plate(1), "across = 1"),
    "one over a beam": (lambda: scenes.falling_column_on_beam(across=1), "across = 1"),
    "no spheres": (lambda: scenes.falling_spheres(spheres=[]), "spheres is empty"),
    "a wall at rest": (lambda: scenes.moving_wall(speed=0.0), r"speed = 0\.0 .* other than zero"),
    "no Reynolds number": (lambda: scenes.lid_driven_cavity(reynolds=0.0), r"reynolds = 0\.0 must be positive"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_scene_is_refused(case):
    make, said = REFUSED[case]
    with pytest.raises(ValueError, match=said):
        make()


def test_laws_are_given_as_such():
    """What the types of signatures say too; they are checked in tests alone."""
    for law, cure in (("morris", "give one"), (MorrisViscosity, "call it")):
        with pytest.raises(ValueError, match=f"is not a ViscosityLaw; {cure}, such as MonaghanViscosity"):
            check_kind("water.viscosity_law", law, ViscosityLaw, "MonaghanViscosity()")


SIZES = {
    "a tank shorter than its water": (lambda: scenes.dam_break(10, width=1.2, tank_length=0.9), "start in 'tank'"),
    "a ball in the water": (
        lambda: scenes.falling_spheres(0.1, spheres=[((0.5, 0.9), 0.3, 500.0, 7e4)]),
        "start in 'sphere_1'",
    ),
    "a fluid in a fluid": (lambda: sph.Scene(water(), sph.Fluid("oil", box((0, 0), (0.2, 0.2), SPACING), 800.0, 20.0)),
                           "4 particles of 'water' start in 'oil'"),
}  # fmt: skip


@pytest.mark.parametrize("case", SIZES)
def test_fluids_that_start_in_something_else_are_refused(case):
    make, said = SIZES[case]
    with pytest.raises(ValueError, match=said + r", the first at .* \(limit 0\.0\d+ m, from 4"):
        sph.topologies(make())


def test_observers_refuse_what_they_cannot_see():
    scene = sph.Scene(water(), basin())
    state = sph.initial_state(scene)
    front = lambda **about: observe.surge_front(scene, state, "water", **about)  # noqa: E731
    for about, said in (
        ({"blur": 0.0}, "blur = 0.0 must be a positive length"),
        ({"axis": 5}, "axis = 5 is not an axis of a scene in 2D"),
        ({"spray": 2.0}, "spray = 2.0 must be a share"),
    ):
        with pytest.raises(ValueError, match=said):
            front(**about)
    with pytest.raises(ValueError, match="up = 5 is not an axis"):
        observe.free_surface_height(scene, state, "water", [0.2], up=5)
    with pytest.raises(ValueError, match="a normal of a sensor is zero"):
        observe.wall_pressure(scene, state, "tank", [[0.4, 0.1]], normal=(0.0, 0.0))


def test_float64_that_is_not_enabled_is_refused_with_the_way_to_enable_it():
    with jax.enable_x64(False):
        for make in (lambda: box((0, 0), (1, 1), 0.5, dtype=np.float64), lambda: scenes.dam_break(10, dtype="float64")):
            with pytest.raises(ValueError, match="JAX_ENABLE_X64=1"):
                make()


def test_a_number_that_was_none_and_those_of_the_density_are_replaced_in_the_scenes_precision():
    scene = sph.Scene(sph.Fluid("water", box((0, 0), (0.4, 0.4), SPACING, dtype=np.float32), 1000.0, 20.0))
    assert scene.replace({"water.viscosity": np.float64(1.0)})["water"].viscosity.dtype == np.float32
    edac = sph.Scene(water(), density=sph.EDAC(free_surface=True))
    assert edac.replace({"density.alpha": 0.1}).get("density.alpha") == 0.1
    slope = jax.grad(lambda alpha: edac.replace({"density.alpha": alpha}).get("density.alpha") ** 2)(3.0)
    assert slope == 6.0
    squared = lambda mu: scene.replace({"water.viscosity": mu}).get("water.viscosity") ** 2  # noqa: E731
    slope = jax.grad(squared)(jnp.float64(3.0))
    assert slope == 6.0, "a traced number in the place of None"


def test_one_effect_is_a_list_of_one():
    one, listed = (
        sph.Scene(water(), effects=effects) for effects in (sph.DeltaDiffusion(0.2), [sph.DeltaDiffusion(0.2)])
    )
    assert str(one.effects) == str(listed.effects) and len(one.effects) == 1


def test_a_wall_is_drawn_away_as_it_is_pushed_and_for_any_time():
    """Displacement speed (t - start log 2) long after the start, in float32 too, where cosh overflows."""
    for speed in (0.5, -0.5):
        wall = scenes.moving_wall(10, speed=speed, dtype=np.float32)["wall"]
        place = wall.placed(jnp.asarray(wall.particles.positions).T, jnp.float32(100.0))[0]
        way = np.asarray(place)[0] - np.asarray(wall.particles.positions)[:, 0]
        # start = .2 s; positions of 50 m are rounded by 4e-6
        np.testing.assert_allclose(way, speed * (100.0 - 0.2 * np.log(2)), atol=1e-4)


@pytest.mark.parametrize("light", [10.0, 30.0])
def test_a_light_fluid_on_a_heavy_one_is_stable_at_the_default_step(light):
    """Stiff water pushes light particles: with the step of each fluid alone they flew apart within ten steps."""
    spacing, g = 0.05, 9.81
    heavy = sph.Fluid("heavy", box((0, 0), (0.4, 0.2), spacing), 1000.0, 20.0,
                      pressure=lambda x: g * (light * 0.2 + 1000 * (0.2 - x[:, 1])))  # fmt: skip
    above = sph.Fluid("light", box((0, 0.2), (0.4, 0.2), spacing), light, 20.0,
                      pressure=lambda x: light * g * (0.4 - x[:, 1]))  # fmt: skip
    walls = sph.Wall("tank", tank((0, 0), (0.4, 0.5), spacing, 4))
    scene = sph.Scene(heavy, above, walls, gravity=(0.0, -g), effects=[sph.DeltaDiffusion(0.1)])
    step = sph.stable_time_step(scene)
    run = sph.simulate(scene, 300 * step, time_step=step)
    # it settles; free fall for that long would be 2 to 3 m/s
    assert all(np.abs(run[name]["velocity"][-1]).max() < 0.7 for name in ("heavy", "light"))
