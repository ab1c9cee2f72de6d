"""What a scene, a law, a geometry or an observer refuses, with the value, the limit and the cure."""

import inspect
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph import observe, scenes
from jaxsph.checks import check_kind, check_motion
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


def block(**about: Any):
    about = {"density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3, **about}
    return sph.Structure("block", box((0, 0), (0.4, 0.4), SPACING), **about)


def away(t, x):
    return jnp.full_like(x, 0.05) * jnp.cos(t)


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
    "particles of unlike spacings on a surface": (
        lambda: box((0, 0), (0.2, 0.2), 0.1, on_surface=True) | box((0.3, 0), (0.2, 0.2), 0.05),
        r"spacings of 0\.1 and 0\.05 m, .* cannot be joined",
    ),
    "a motion of nobody": (lambda: block(motion=away), "none is clamped"),
    "a motion that begins elsewhere": (
        lambda: block(motion=away, clamped=lambda x: x[:, 0] < 0.1),
        r"block\.motion displaces particles by 0\.05 m at t = 0",
    ),
    "a wall that begins elsewhere": (
        lambda: sph.Wall("tank", tank((0, 0), (0.4, 0.6), SPACING, 4), motion=away),
        r"tank\.motion displaces particles by 0\.05 m",
    ),
    "two laws of viscosity": (
        lambda: sph.Scene(
            water(viscosity=1.0),
            sph.Fluid(
                "oil", box((0, 0.4), (0.4, 0.2), SPACING), 800.0, 20.0, 1.0, viscosity_law=sph.MonaghanViscosity()
            ),
        ),
        "one law of viscosity, or forces are not opposite",
    ),
    "a smoothing length below the spacing": (
        lambda: sph.Scene(water(), smoothing_length=0.05),
        r"0\.05 m is 0\.5 spacings of 'water'",
    ),
    "a tuple for a domain": (lambda: sph.Scene(water(), domain=((0, 0), (1, 1))), "not a Domain"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused(case):
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
    step, h = sph.stable_time_step(scene), float(scene.smoothing_length)
    sound = 0.8 * h / 20.0  # the step of either fluid alone; F35 sweeps the 2.5 for a light one beside a stiff one
    assert step == pytest.approx(0.9 * min(sound, 2.5 * sound * np.sqrt(light / 1000.0)), rel=1e-6)
    run = sph.simulate(scene, 300 * step, time_step=step)
    # it settles; free fall for that long would be 2 to 3 m/s
    assert all(np.abs(run[name]["velocity"][-1]).max() < 0.7 for name in ("heavy", "light"))


def test_a_motion_that_is_a_number_is_refused():
    class Tank:
        name, motion = "tank", 3.0

    with pytest.raises(ValueError, match=r"tank\.motion = 3\.0 is not a function"):
        check_motion(Tank())


def test_one_smoothing_length_serves_the_coarser_of_two_fluids():
    """A divergence of 2 comes out as 2 in both; with 1.5 spacings of the finer one it would be 1.3 in the coarser."""
    coarse = sph.Fluid("coarse", box((0, 0), (1, 0.8), 0.1), 1000.0, 20.0)
    fine = sph.Fluid("fine", box((1, 0), (0.4, 0.8), 0.05), 1000.0, 20.0)
    assert float(sph.Scene(coarse, fine).smoothing_length) == pytest.approx(0.15)


def test_substeps_without_a_fluid_are_refused():
    with pytest.raises(ValueError, match=r"substeps = 7: structures take substeps beside fluids, .* has no fluids"):
        sph.simulate(sph.Scene(block()), 0.01, integrator=sph.KickDriftKick(7))
    with pytest.raises(ValueError, match="has no structures"):
        sph.simulate(sph.Scene(water()), 0.01, integrator=sph.KickDriftKick({"block": 7}))
    for scene in (sph.Scene(block()), sph.Scene(water())):  # where there is nothing to divide
        step = 0.5 * sph.stable_time_step(scene)
        integrator = sph.KickDriftKick(sph.stable_substeps(scene, step))
        assert len(sph.simulate(scene, step, time_step=step, integrator=integrator).times) == 2


def test_scene_keeps_its_precision_whatever_its_laws_are_given():
    """float64 numbers of laws would take a float32 run with them."""
    cole = sph.Cole(np.float64(7.0), np.float64(0.0))
    tank32 = tank((0, 0), (0.4, 0.6), SPACING, 4, dtype=np.float32)
    fluid = sph.Fluid("water", box((0, 0), (0.4, 0.4), SPACING, dtype=np.float32), 1000.0, 20.0, state_equation=cole)
    wall = sph.Wall("tank", tank32, sph.BernoulliExtrapolation(np.float64(0.5)))
    scene = sph.Scene(fluid, wall, density=sph.EDAC(np.float64(0.5), free_surface=True))
    wide = [leaf for leaf in jax.tree.leaves(scene) if getattr(leaf, "dtype", None) == np.float64]
    assert not wide
    assert sph.simulate(scene, 1e-3).final.systems["water"]["position"].dtype == np.float32


def test_particles_of_ones_own_are_taken_in_jaxs_precision():
    """As lists, too; whole numbers become lengths."""
    cloud = sph.Particles([[0, 0], [1, 0], [0, 1]], [1, 1, 1], 1.0)
    assert cloud.positions.dtype == cloud.volumes.dtype == np.dtype(jnp.zeros(()).dtype)
    there = box((0, 0), (0.2, 0.2), 0.1, dtype=np.float32).moved((0.4, 0.2))
    assert there.positions.dtype == np.float32
    np.testing.assert_allclose(there.positions.min(axis=0), [0.45, 0.25], rtol=1e-6)
    with pytest.raises(ValueError, match=r"not 'water' in 2D, float64, 'tank' in 2D, float32; make"):
        sph.Scene(water(), sph.Wall("tank", tank((0, 0), (0.4, 0.6), SPACING, 4, dtype=np.float32)))


def test_a_period_shorter_than_what_fills_it_is_refused():
    long = sph.Fluid("water", box((0, 0), (0.9, 0.4), SPACING), 1000.0, 20.0)
    sph.topologies(sph.Scene(long, domain=sph.Domain((0, -1), (0.9, 1), (True, False))))
    short = sph.Scene(long, domain=sph.Domain((0, -1), (0.8, 1), (True, False)))
    with pytest.raises(ValueError, match=r"4 pairs of particles of 'water' are at one place through the period"):
        sph.topologies(short)


def test_two_forms_of_one_diffusion_are_refused():
    with pytest.raises(ValueError, match="two forms of one effect"):
        sph.Scene(water(), effects=[sph.DensityDiffusion(), sph.DeltaDiffusion()])


def test_a_polygon_that_crosses_itself_is_refused():
    with pytest.raises(ValueError, match="edges 0 and 2 of the polygon cross"):
        sph.polygon([(0, 0), (1, 1), (1, 0), (0, 0.7)], 0.1)
    star = [(np.cos(a) * r, np.sin(a) * r) for a, r in zip(np.arange(10) * np.pi / 5, [1, 0.4] * 5, strict=True)]
    assert len(sph.polygon(star, 0.05)) > 100


@pytest.mark.parametrize("integrator", ["Tsit5", sph.KickDriftKick, None])
def test_what_is_no_integrator_is_refused(integrator):
    with pytest.raises(ValueError, match=r"must be KickDriftKick\(\) or Diffrax"):
        inspect.unwrap(sph.simulate)(sph.Scene(water()), 0.01, integrator=integrator)  # tests check types before


def test_a_class_for_a_solver_is_refused():
    import diffrax

    with pytest.raises(ValueError, match=r"is a class; call it: Diffrax\(diffrax.Tsit5\(\)\)"):
        sph.Diffrax(diffrax.Tsit5)
