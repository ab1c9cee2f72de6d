"""Runs with fluids that need more than was thought, leave their domain, or are told too little."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fluids import column

import jaxsph as sph
from jaxsph import plain_run, surroundings
from jaxsph.health import BEYOND_SKIN, GOOD, OVERFLOW, Health
from jaxsph.pytree import replace

FIELDS = ("position", "velocity", "acceleration", "density_deviation", "density_gradient")
RAISED_IN_JIT = (RuntimeError, ValueError)  # as one or the other jax hands on what a callback raised


@pytest.fixture(scope="module")
def scene():
    return column()


def test_too_little_room_is_enlarged_in_a_plain_run_and_an_error_under_jit(scene):
    whole = sph.simulate(scene, 0.02)
    tight = sph.topologies(scene)
    for a, b in surroundings.pairs_of(scene):
        tight[f"{a}-{b}"] = surroundings.enlarged(tight[f"{a}-{b}"], 0.6)
    run = sph.simulate(scene, 0.02, topologies_of_scene=tight)
    for field in FIELDS:
        # the neighbors are the same and in the same order; only the number of empty slots differs
        largest = np.abs(whole["water"][field]).max()
        np.testing.assert_allclose(run["water"][field], whole["water"][field], rtol=0, atol=1e-10 * largest)
    of = lambda mu: sph.simulate(  # noqa: E731
        scene.replace({"water.viscosity": mu}), 0.01, time_step=1e-3, topologies_of_scene=tight, mode="forward"
    )
    with pytest.raises(RAISED_IN_JIT, match="more neighbors than the neighbor list has slots"):
        jax.block_until_ready(jax.jit(of)(1.0))


def test_a_thin_plate_that_water_will_surround_has_room_from_the_start():
    """At the start no water is near it. Then it is wet all over, on both sides: a lattice of water through it."""
    scene = sph.scenes.dam_break_plate(10, 3, dtype=np.float32)
    found = sph.topologies(scene)
    places = {system.name: jnp.asarray(system.particles.positions).T for system in scene.systems}
    assert int(surroundings.rebuild(scene, found, places, [("water", "plate")])["water-plate"].needed_members) == 0
    middle = jnp.mean(places["plate"], axis=1) - jnp.mean(places["water"], axis=1)
    places["water"] = places["water"] + middle[:, None]
    lists = surroundings.rebuild(scene, found, places, [("water", "plate")])
    plate = lists["water-plate"].transpose
    assert plate is not None and int(plate.needed_members) == scene["plate"].n_particles
    assert not bool(lists["water-plate"].did_buffer_overflow)


@pytest.mark.parametrize(("array", "needed"), [("slots", "needed_slots"), ("range", "needed_range")])
def test_what_is_noted_is_the_array_that_was_too_small(scene, array, needed):
    """Not the neighbors, of which there were enough, where a row of cells held too many candidates."""
    found = sph.topologies(scene)
    template = found["water-water"]
    small = replace(template, capacity=dataclasses.replace(template.capacity, **{array: 2}))
    place = {"water": jnp.asarray(scene["water"].particles.positions).T}
    lists = surroundings.rebuild(scene, {"water-water": small}, place, [("water", "water")])
    health = surroundings.note(scene, Health.good(scene.dtype), lists, place, 0)
    assert int(health.limit) == 2
    assert int(health.number) == np.max(getattr(lists["water-water"], needed)) > 2


def test_lists_grow_by_more_each_time(scene, monkeypatch):
    asked, grow = [], plain_run._with_room

    def a_little(scene, found, factor):
        asked.append(factor)
        return grow(scene, found, 1.1)

    monkeypatch.setattr(plain_run, "_with_room", a_little)
    tight = sph.topologies(scene)
    for a, b in surroundings.pairs_of(scene):
        tight[f"{a}-{b}"] = surroundings.enlarged(tight[f"{a}-{b}"], 0.6)
    sph.simulate(scene, 0.002, topologies_of_scene=tight)
    assert len(asked) >= 2
    for k, factor in enumerate(asked, start=1):
        assert factor >= plain_run.MORE_ROOM**k * (1 - 1e-12)


def test_what_lists_did_not_suffice_for_is_done_again_and_no_more(scene, monkeypatch):
    """An interval of twelve steps, four at a time, of which the second four find too little room."""
    whole = sph.simulate(scene, 0.012, time_step=1e-3)
    asked, advance = [], plain_run.advance_compiled

    def with_too_little_room(*arguments, **options):
        columns, state = advance(*arguments, **options)
        asked.append((int(arguments[4].step), int(options["n_steps"]), float(options["reserve"])))
        reason = {3: BEYOND_SKIN, 4: OVERFLOW}.get(len(asked), GOOD)
        health = state.health.note(reason != GOOD, reason, state.step, 1e-3, 1e-3)
        return columns, replace(state, health=health)

    monkeypatch.setattr(plain_run, "advance_compiled", with_too_little_room)
    monkeypatch.setattr(plain_run, "STEPS_AT_ONCE", 4)
    run = sph.simulate(scene, 0.012, time_step=1e-3)
    usual, large = plain_run.RESERVE, plain_run.LARGE_RESERVE
    # the first is the step of no duration before any other
    assert asked == [(0, 1, usual), (0, 4, usual), (4, 4, usual), (4, 4, large), (4, 4, large), (8, 4, usual)]
    assert int(run.final.step) == 12
    # lists built at other steps: the same neighbors in another order
    for name, there in whole.final.systems["water"].items():
        np.testing.assert_allclose(run["water"][name][-1], there, rtol=0, atol=1e-10 * max(np.abs(there).max(), 1e-30))


def test_lists_hold_as_long_as_no_pair_can_have_come_closer_than_the_skin(scene):
    found = sph.topologies(scene)
    positions = {name: jnp.asarray(scene[name].particles.positions).T for name in ("water", "tank")}
    lists = surroundings.rebuild(scene, found, positions)
    skin = lists["water-water"].skin
    still = {name: jnp.zeros_like(places) for name, places in positions.items()}

    def steps(moved, step, reserve=1.0):
        return surroundings.steps_left(lists, moved, step, reserve)

    # One particle goes .4 of the skin towards the others, and goes on by a tenth in a step.
    moved = {**positions, "water": positions["water"].at[0, 0].add(0.4 * skin)}
    step = {**still, "water": still["water"].at[0, 0].set(0.1 * skin)}
    for name in ("water-water", "water-tank"):
        left, closer, limit = steps(moved, step)[name]
        assert (closer, limit) == (pytest.approx(0.4 * skin), lists[name].skin)
        further = 10 * lists[name].skin / skin - 4  # steps: along the walls particles may go further
        assert left == pytest.approx(further)
        assert steps(moved, step, reserve=2.0)[name].steps == pytest.approx(further / 2)
    assert lists["water-tank"].skin == pytest.approx(surroundings.SKIN_BETWEEN_SETS * skin)
    # All of the water goes the same way: it comes closer to the tank alone.
    moved = {**positions, "water": positions["water"] + 0.4 * skin}
    rounding = 1e-15  # of positions of up to a meter
    assert steps(moved, still)["water-water"].closer == pytest.approx(0.0, abs=rounding)
    assert steps(moved, still)["water-tank"].closer == pytest.approx(0.4 * skin * np.sqrt(2))


@pytest.mark.slow
def test_faster_than_stated(scene):
    """A plain run builds its lists when they are due; a compiled one as often as stated, or says that it was seldom."""
    fast = scene.replace({"water.velocity": (5.0, 0.0)})

    def of(mu, max_speed):
        changed = fast.replace({"water.viscosity": mu})
        run = sph.simulate(
            changed, 0.008, time_step=1e-3, max_speed=max_speed, mode="forward", topologies_of_scene=found
        )
        return run["water"]["position"]

    found = sph.topologies(fast)
    own = sph.simulate(fast, 0.008, time_step=1e-3, topologies_of_scene=found)["water"]["position"]
    often = jax.jit(of, static_argnames="max_speed")(float(fast["water"].viscosity), 50.0)  # in every step
    # sums over the same neighbors in another order
    np.testing.assert_allclose(own, often, rtol=0, atol=1e-10 * np.abs(often).max())
    with pytest.raises(RAISED_IN_JIT, match="larger max_speed, or take a smaller time_step"):
        jax.block_until_ready(jax.jit(of, static_argnames="max_speed")(1.0, 0.2))


def test_a_particle_that_leaves_the_domain_stops_the_run():
    scene = column(domain=((-0.2, -0.2), (0.75, 0.5)), velocity=(0.0, 5.0))
    with pytest.raises(sph.ParticleOutside, match=r"stopped at or before step \d+ .* left the domain; widen") as caught:
        sph.simulate(scene, 0.08, 0.01, time_step=1e-3)
    kept = caught.value.trajectory
    assert 2 <= len(kept.times) < 9
    assert np.asarray(kept["water"]["position"])[-1, :, 1].max() < 0.5


def test_a_step_that_is_too_large_is_refused(scene):
    limit = sph.stable_time_step(scene) / 0.9
    with pytest.raises(sph.UnstableTimeStep, match="larger than the largest stable one"):
        sph.simulate(scene, 0.01, time_step=1.01 * limit)
    thick = scene.replace({"water.viscosity": 1e4})
    assert sph.stable_time_step(thick) == pytest.approx(0.9 * 0.25 * 0.075**2 / 10), "h^2 / (4 nu)"
    assert 0.9 * limit == pytest.approx(0.9 * 0.8 * 0.075 / 20), "h / c"


def test_what_has_to_be_stated_under_jit(scene):
    of = lambda c, **options: sph.simulate(scene.replace({"water.sound_speed": c}), 0.01, **options)  # noqa: E731
    with pytest.raises(ValueError, match="time_step is needed when numbers of the scene are traced"):
        jax.jit(lambda c: of(c))(20.0)
    with pytest.raises(ValueError, match="max_speed is needed when the sound speed is traced"):
        jax.jit(lambda c: of(c, time_step=1e-3))(20.0)
    with pytest.raises(ValueError, match="the smoothing length are traced"):
        jax.jit(lambda h: sph.simulate(scene.replace({"smoothing_length": h}), 0.01, time_step=1e-3))(0.075)


def test_a_particle_that_left_is_named_where_it_is():
    """By its number in the scene, not that in memory."""
    scene = column(domain=((-0.2, -0.2), (0.75, 0.5)), velocity=(0.0, 0.0))
    velocity = np.zeros((36, 2))
    velocity[17] = [0.0, 15.0]
    with pytest.raises(
        sph.ParticleOutside, match=r": particle 17 of 'water' is at .* m \(1 of its particles"
    ) as caught:
        sph.simulate(scene.replace({"water.velocity": velocity}), 0.08, 0.01, time_step=1e-3)
    assert "reaches from (-0.2, -0.2) to (0.75, 0.5) m" in str(caught.value)


def test_what_is_not_a_number_did_not_leave_the_domain(scene):
    """In a plain run and under jit."""
    force = sph.BodyForce(lambda x, t: jnp.where(t > 5e-3, jnp.nan, 0.0) * x)
    broken = sph.Scene(*scene.systems, effects=[force], domain=scene.domain, smoothing_length=scene.smoothing_length)
    with pytest.raises(sph.NotFinite, match="not finite at or before step"):
        sph.simulate(broken, 0.01, time_step=1e-3)
    found = sph.topologies(broken)
    of = lambda mu: sph.simulate(  # noqa: E731
        broken.replace({"water.viscosity": mu}), 0.01, time_step=1e-3, topologies_of_scene=found, mode="forward"
    )["water"]["position"]
    with pytest.raises(RAISED_IN_JIT, match="a field became infinite or not a number"):
        jax.block_until_ready(jax.jit(of)(1.0))


def test_a_smoothing_length_that_outgrows_its_lists_is_noticed():
    """A plain run makes lists that suffice; a traced one says that they do not. Within the skin both go on."""
    scene = column(effects=[])
    found, h = sph.topologies(scene), float(scene.smoothing_length)

    def end(h, found=found):
        run = sph.simulate(
            scene.replace({"smoothing_length": h}), 4e-3, time_step=1e-3, topologies_of_scene=found, max_speed=2.0
        )
        return run.final.systems["water"]["velocity"]

    for larger in (1.02 * h, 1.3 * h):
        right = end(larger, sph.topologies(scene.replace({"smoothing_length": larger})))
        # the same neighbors in another order of slots, four steps: some hundred roundings of 1e-16 of larger forces
        np.testing.assert_allclose(end(larger), right, rtol=0, atol=1e-11 * np.abs(right).max())
    np.testing.assert_allclose(jax.jit(end)(1.02 * h), end(1.02 * h), rtol=0, atol=1e-11)
    with pytest.raises(RAISED_IN_JIT, match="largest smoothing length"):
        jax.block_until_ready(jax.jit(end)(1.3 * h))


def test_a_structure_that_outgrows_its_neighbors_is_noticed():
    body = sph.Structure("block", sph.box((0, 0), (0.4, 0.4), 0.1), 1000.0, 1e6, 0.3)  # .87 spacings, 8 neighbors
    scene, found = sph.Scene(body), sph.topologies(sph.Scene(body))
    assert float(found["block"].next_distance) == pytest.approx(0.2)

    def end(h):
        changed = scene.replace({"block.smoothing_length": h, "block.velocity": (1.0, 0.0)})
        return sph.simulate(changed, 1e-3, time_step=1e-3, topologies_of_scene=found)["block"]["displacement"]

    assert np.isfinite(jax.jit(end)(0.099)).all()
    with pytest.raises(RAISED_IN_JIT, match="is larger than that for which its neighbors were found"):
        jax.block_until_ready(jax.jit(end)(0.11))
    with pytest.raises(ValueError, match=r"smoothing length of 'block', 0\.11 m, is larger"):
        end(0.11)
