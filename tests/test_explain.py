"""What a scene says of itself: its numbers by hand, what it lacks when something is taken away, what could go."""

import inspect
import math

import jax
import numpy as np
import pytest

import jaxsph as sph
from jaxsph.explain import Explanation, arrangement, cost
from jaxsph.geometry import tank
from jaxsph.pytree import replace

ARGUMENTS = {
    "cantilever": {"args": (0.35, 0.02), "density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3},
    "column_in_tank": {"args": ((0.4, 0.4), (1.0, 0.8), 0.02)},
}
"""Of scenes that have no defaults for all of theirs."""


def ready_made():
    for name in sph.scenes.__all__:
        make = getattr(sph.scenes, name)
        if inspect.signature(make, eval_str=True).return_annotation is not sph.Scene:
            continue
        given = dict(ARGUMENTS.get(name, {}))
        yield pytest.param(lambda make=make, given=given: make(*given.pop("args", ()), **given), id=name)


@pytest.mark.parametrize("make", list(ready_made()))
def test_no_ready_made_scene_lacks_what_it_calls_for(make):
    assert [str(found) for found in make().explain().missing] == []


def without(scene, *kinds):
    return replace(scene, effects=tuple(effect for effect in scene.effects if not isinstance(effect, kinds)))


def with_systems(scene, **changes):
    return cost.with_systems(scene, {name: replace(scene[name], **about) for name, about in changes.items()})


def lacks(scene, **about):
    return [found.effect for found in scene.explain(**about).missing]


def dam(**about):
    return sph.scenes.dam_break(20, **about)


def cavity(**about):
    return sph.scenes.lid_driven_cavity(20, **about)


def thin_walls():
    scene, dx = dam(), 0.03
    inside = [107 * dx, 60 * dx]
    return with_systems(scene, tank={"particles": tank((0, 0), inside, dx, 2)})


def beam(particles, penalty=0.05):
    body = sph.Structure("beam", sph.box((0, 0), (1.0, particles * 0.1), 0.1), 1000.0, 1e6, 0.3)
    return sph.Scene(body, effects=[sph.PenaltyForce(penalty)] if penalty else [])


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        pytest.param(lambda: without(dam(), sph.DeltaDiffusion), "density diffusion", id="gravity without diffusion"),
        pytest.param(
            lambda: dam(effects=[sph.DensityDiffusion(), sph.ArtificialViscosity()]),
            "DeltaDiffusion",
            id="diffusion that levels the weight",
        ),
        pytest.param(lambda: dam(sound_speed=20.0), "sound speed", id="Mach number of a fall"),
        pytest.param(thin_walls, "layers of tank", id="two layers of wall"),
        pytest.param(
            lambda: with_systems(dam(), tank={"pressure": sph.AdamiExtrapolation()}), "clipping of tank", id="no clip"
        ),
        pytest.param(
            lambda: with_systems(dam(viscosity=300.0), tank={"no_slip": False}), "no slip of tank", id="slip at Re 7"
        ),
        pytest.param(
            lambda: with_systems(cavity(reynolds=10.0), cavity={"no_slip": False}),
            "no slip of cavity",
            id="slip at Re 10",
        ),
        pytest.param(
            lambda: with_systems(cavity(), cavity={"pressure": sph.AdamiExtrapolation(clip=True)}),
            "negative pressure of cavity",
            id="clip in a full domain",
        ),
        pytest.param(lambda: without(cavity(), sph.ParticleShifting), "ParticleShifting", id="full without shifting"),
        pytest.param(
            lambda: without(sph.scenes.taylor_green(20), sph.ParticleShifting), "ParticleShifting", id="vortices"
        ),
        pytest.param(
            lambda: without(sph.scenes.rotating_square(20), sph.TensileControl), "TensileControl", id="torn patch"
        ),
        pytest.param(
            lambda: sph.scenes.oscillating_drop(10, frequency=0.0, effects=[]), "dissipation", id="nothing damps"
        ),
        pytest.param(lambda: dam(smoothing=0.9), "neighbors", id="few neighbors"),
        pytest.param(lambda: dam(smoothing=3.5), "spacing", id="many neighbors"),
        pytest.param(lambda: sph.scenes.dam_break(3), "resolution", id="three particles high"),
        pytest.param(lambda: beam(5, penalty=0), "PenaltyForce", id="thin without penalty"),
        pytest.param(lambda: beam(2), "particles across beam", id="two across"),
    ],
)
def test_what_is_taken_away_is_missed(make, expected):
    assert expected in lacks(make())


def test_it_misses_nothing_that_the_user_rules_out():
    """Water falls at 3.4 m/s, for which 20 m/s is too slow a sound; not for a flow of 1 m/s."""
    assert lacks(dam(sound_speed=20.0), speed=1.0) == []


def test_surface_tension_is_missed_where_the_weber_number_is_small():
    small = sph.scenes.oscillating_drop(10, radius=1e-3, rate=30.0, frequency=0.0, sound_speed=1.0)
    assert lacks(small) == []
    assert lacks(small, surface_tension=0.072) == ["surface tension"]
    assert lacks(dam(), surface_tension=0.072) == []


def test_numbers_of_a_dam_by_hand():
    """U = sqrt(2 g H), c = 20 sqrt(g H), L = H."""
    about = sph.scenes.dam_break(20, viscosity=2.0, dtype=np.float64).explain(surface_tension=0.07)
    speed, value = math.sqrt(2 * 9.81 * 0.6), {name: number.value for name, number in about.numbers.items()}
    h, c = 2 * 0.03, 20 * math.sqrt(9.81 * 0.6)
    by_hand = {
        "Re": 1000 * speed * 0.6 / 2.0,
        "Re of artificial viscosity": speed * 0.6 / (0.02 * h * c / 16),
        "Ma": math.sqrt(2) / 20,
        "Fr": math.sqrt(2),
        "compression by weight": 1 / 400,
        "We": 1000 * speed**2 * 0.6 / 0.07,
        "Bo": 1000 * 9.81 * 0.6**2 / 0.07,
        "particles per length": 20,
        "smoothing length in spacings": 2,
        "Re of a spacing": 1000 * speed * 0.03 / 2.0,
        "viscous layer in spacings": 20 / math.sqrt(1000 * speed * 0.6 / 2.0),
    }
    for name, expected in by_hand.items():
        assert value.pop(name) == pytest.approx(expected, rel=1e-9), name
    assert set(value) == {"neighbors"}
    # pi 4^2 = 50 less itself less those on the rim, for all but the particles at the surface
    assert 40 < value["neighbors"] < 50


def test_a_given_speed_and_length_are_taken():
    numbers = cavity(reynolds=100.0).explain(speed=0.5, length=0.2).numbers
    assert numbers["Re"].value == pytest.approx(10.0, rel=1e-6)  # float32 numbers of the scene
    assert numbers["Ma"].value == pytest.approx(0.05, rel=1e-6)
    assert numbers["particles per length"].value == pytest.approx(4.0, rel=1e-6)


@pytest.mark.parametrize(
    ("make", "fall", "depth"),
    [
        (lambda: dam(), 0.6, 0.6),
        (lambda: sph.scenes.still_water(10), 0.0, 0.9),
        # its top, .7 m up, onto the pool
        (lambda: sph.scenes.falling_column(20), 0.6, 0.1),
        # beyond the gate the floor is dry
        (lambda: sph.scenes.dam_break_gate(), 0.4, 0.4),
        (lambda: sph.scenes.dam_break(10, depth=0.3), 0.6, 0.6),
    ],
    ids=["dam break", "still water", "falling column", "gate", "dam break in 3D"],
)
def test_how_far_water_can_fall(make, fall, depth):
    scene = make()
    up = np.eye(scene.dimension)[-1]
    # float32 positions
    assert arrangement.fall_and_depth(scene, up) == pytest.approx((fall, depth), abs=1e-5)


def test_where_the_surface_is_free():
    """A row of 40 particles of 20 rows, one of 40 columns: the top and the front; nowhere in a full domain."""
    share = arrangement.open_share(dam())
    assert share == pytest.approx((40 + 20) / 800, rel=0.1)  # corners count or do not
    assert arrangement.open_share(cavity()) == 0
    assert arrangement.open_share(sph.scenes.taylor_green(20)) == 0


@pytest.mark.parametrize("layers", [1, 2, 3, 5])
def test_layers_of_a_wall_are_counted(layers):
    scene = with_systems(dam(), tank={"particles": tank((0, 0), [107 * 0.03, 60 * 0.03], 0.03, layers)})
    assert arrangement.layers(scene, scene["tank"]) == layers


def beside_water(**about):
    """A block of 5 particles across in the middle of the dry floor; 12 cm is the support radius."""
    block = sph.Structure("block", sph.box((2.0, 0.0), (0.1, 0.3), 0.02), 500.0, 1e7, 0.3, **about)
    scene = dam()
    return replace(scene, systems=(*scene.systems, block), effects=(*scene.effects, sph.PenaltyForce(0.05)))


def test_a_plate_thinner_than_the_support_radius_says_how_thick_it_is():
    assert lacks(beside_water()) == ["thickness of block"]
    assert lacks(beside_water(thickness=0.1)) == []


def test_structures_beside_a_fluid_have_their_ratios():
    """Half as dense; so stiff that it needs more steps than the fluid."""
    both = beside_water()
    block, numbers = both["block"], both.explain().numbers
    assert numbers["density ratio of block"].value == pytest.approx(0.5)
    assert numbers["particles across block"].value == 5
    exact = sph.stable_time_step(sph.Scene(block, effects=[sph.PenaltyForce(0.05)]))
    fluid = 0.8 * 0.06 / (20 * math.sqrt(9.81 * 0.6))
    assert numbers["time-step ratio of block"].value == pytest.approx(exact / fluid, rel=1e-5)


def could_go(scene):
    return {found.effect: found.error for found in scene.explain().spare}


def test_what_does_nothing_at_these_numbers_could_go():
    """At Re 1e6 the layer is a thousandth of the cavity thick; at Re 10 the fluid's own viscosity is the larger."""
    spare = could_go(cavity(reynolds=1e6))
    assert spare["no slip of lid"] == pytest.approx(1e-3, rel=1e-5)
    assert spare["viscosity"] == pytest.approx(4 * np.pi**2 * 1e-6, rel=1e-5)
    thick = cavity(
        reynolds=10.0, effects=[sph.DensityDiffusion(), sph.ParticleShifting(1.0), sph.ArtificialViscosity(0.02)]
    )
    # alpha h c / 16 = .02 / 20 * 10 / 16 of 1 / 10
    assert could_go(thick) == {"ArtificialViscosity": pytest.approx(0.00625, rel=1e-5)}
    assert could_go(cavity(reynolds=100.0)) == {}
    both = dam(effects=[sph.DeltaDiffusion(), sph.ShepardFilter(), sph.TensileControl()])
    assert set(could_go(both)) == {"ShepardFilter", "TensileControl"}


def test_everything_that_is_on_is_named():
    about = cavity(effects=[sph.ArtificialViscosity(), sph.DensityDiffusion(), sph.ParticleShifting(1.0)]).explain()
    assert [found.effect for found in about.on] == [
        "MorrisViscosity of water",
        "ContinuityDensity with LinearStateEquation",
        "AdamiExtrapolation of cavity",
        "no slip of cavity",
        "AdamiExtrapolation of lid",
        "no slip of lid",
        "velocity of lid",
        "ArtificialViscosity",
        "DensityDiffusion",
        "ParticleShifting",
    ]
    assert all(found.why for found in about.on)


def test_it_is_shown_as_text_and_as_tables():
    about = dam(sound_speed=20.0).explain()
    said, shown = str(about), about._repr_html_()
    assert said.startswith("U = 3.431 m/s (a fall of 0.6 m), L = 0.6 m (height of the fluid)\nnumbers:\n  Re of")
    assert "missing:\n  sound speed: Ma = 0.172 at U = 3.43 m/s" in said
    assert "could be left out: nothing" in said
    for tag in ("table", "tr", "td", "p"):
        assert shown.count(f"<{tag}>") == shown.count(f"</{tag}>") > 0
    assert "<td>sound speed</td>" in shown


def test_costs_are_measured_on_request():
    scene = beam(3)
    assert scene.explain().costs is None
    costs = scene.explain(measure=True).costs
    assert costs is not None
    (found,) = costs
    assert found.effect == "PenaltyForce"
    assert found.without is not None and found.with_it > 0 and found.without > 0
    assert found.share == pytest.approx(1 - found.without / found.with_it)
    about = Explanation(**{**vars(scene.explain()), "costs": [found, cost.Cost("x", 1.0, None)]})
    assert "x: does not run without it" in str(about) and "<td>PenaltyForce</td>" in about._repr_html_()


def test_each_effect_is_left_out_in_turn():
    variants = cost.variants(cavity())
    assert list(variants) == ["DensityDiffusion", "ParticleShifting", "viscosity", "no slip"]
    assert [type(effect) for effect in variants["DensityDiffusion"].effects] == [sph.ParticleShifting]
    assert variants["viscosity"]["water"].viscosity is None
    assert not variants["no slip"]["lid"].no_slip and not variants["no slip"]["cavity"].no_slip
    assert cost.variants(sph.scenes.dam_break_gate())["motion of walls"]["gate"].motion is None


def test_a_scene_prints_its_step_lists_memory_and_numbers():
    said = str(dam())
    for words in (
        "largest stable steps, about: water 0.000989 s",
        "lists water-water, water-tank: ",
        "at most 44, room for 96",
        "memory, about: 57.6 kB of state, ",
        "inviscid, Ma 0.071, 20 particles over L = 0.6 m, U = 3.43 m/s (a fall of 0.6 m)",
    ):
        assert words in said
    assert "beam is 5 particles across" in str(beam(5))


def test_what_cannot_be_explained_is_refused():
    with pytest.raises(ValueError, match="traced; explain the scene outside of jit"):
        jax.jit(lambda g: dam().replace({"gravity": g}).explain().facts.speed)(np.array([0.0, -9.81]))
    with pytest.raises(ValueError, match=r"speed = -1.0 must be positive"):
        dam().explain(speed=-1.0)
    with pytest.raises(ValueError, match=r"surface_tension = 0.0 must be positive"):
        dam().explain(surface_tension=0.0)
