"""What goes wrong with a neighbor list is reported with the numbers and the cure."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from neighbor_oracles import all_pairs, pairs_of, random

from jaxsph.errors import NeighborOverflow, ParticleOutside, SkinExceeded
from jaxsph.neighbors import Capacity, Domain, is_valid, moved, neighbor_list, raise_if_wrong, safe_steps
from jaxsph.pytree import replace

DOMAIN = Domain((0, 0), (1, 1))
SEARCH = neighbor_list(DOMAIN, 0.18, 0.02)
POSITIONS = jnp.asarray(random(2, 200))
NEIGHBORS = SEARCH.allocate(POSITIONS)


def test_slot_overflow_names_the_number_that_is_needed():
    capacity = Capacity(5, NEIGHBORS.capacity.range, NEIGHBORS.capacity.range_round)
    small = replace(NEIGHBORS, indices=NEIGHBORS.indices[:5], capacity=capacity, needed_slots=jnp.int32(0))
    overflowing = SEARCH.update(POSITIONS, small)
    needed = max(map(len, _neighbors_of_each()))
    assert int(overflowing.needed_slots) == needed > 5
    assert int(jnp.max(overflowing.count)) == 5
    with pytest.raises(NeighborOverflow, match=f"{needed} neighbors.* of fluid has 5 slots.*capacity_multiplier"):
        raise_if_wrong(overflowing, name="fluid")


def _neighbors_of_each():
    pairs = all_pairs(DOMAIN, POSITIONS, POSITIONS, 0.2, same=True)
    return [[j for i, j in pairs if i == k] for k in range(200)]


def test_an_overflow_of_candidates_is_flagged():
    heap = jnp.full_like(POSITIONS, 0.5)
    overflowing = SEARCH.update(heap, NEIGHBORS)
    assert overflowing.did_buffer_overflow
    assert int(overflowing.needed_range[0]) == 200
    with pytest.raises(NeighborOverflow, match=f"200 candidates.*room for {NEIGHBORS.capacity.range} "):
        raise_if_wrong(overflowing)


def test_flags_stay_and_allocation_clears_them():
    overflowing = SEARCH.update(jnp.full_like(POSITIONS, 0.5), NEIGHBORS)
    later = SEARCH.update(POSITIONS, overflowing)
    assert later.did_buffer_overflow
    raise_if_wrong(SEARCH.allocate(POSITIONS))


@pytest.mark.parametrize("value", [1.001, -0.001, np.nan, np.inf, -np.inf, 1e30])
def test_a_particle_outside_is_named_with_its_place(value):
    lost = POSITIONS.at[1, 17].set(value)
    flagged = SEARCH.update(lost, NEIGHBORS)
    assert int(flagged.outside) == 17
    np.testing.assert_array_equal(flagged.outside_position, lost[:, 17])  # NaN counts as equal here
    assert flagged.is_wrong
    cure = "widen the domain" if np.isfinite(value) else "smaller time step"
    with pytest.raises(ParticleOutside, match=f"particle 17 is at .*{cure}"):
        raise_if_wrong(flagged)
    with pytest.raises(ParticleOutside, match="particle 17 is at"):
        SEARCH.allocate(lost)
    # The first one stays noted, and nothing is flagged for particles on the bounds.
    assert int(SEARCH.update(POSITIONS.at[0, 3].set(2.0), flagged).outside) == 17
    assert int(SEARCH.update(POSITIONS.at[:, 3].set(1.0).at[:, 4].set(0.0), NEIGHBORS).outside) == -1


def test_a_sender_outside_is_told_from_a_receiver():
    two = SEARCH.allocate(POSITIONS, POSITIONS[:, :20])
    flagged = SEARCH.update(POSITIONS, two, POSITIONS[:, :20].at[0, 2].set(3.0))
    assert flagged.is_wrong
    assert not flagged.did_buffer_overflow
    with pytest.raises(ParticleOutside, match="sender 2 of water-wall is at"):
        raise_if_wrong(flagged, name="water-wall")


def test_a_periodic_particle_more_than_a_period_away_is_outside():
    search = neighbor_list(Domain((0, 0), (1, 1), True), 0.18, 0.02)
    neighbors = search.allocate(POSITIONS)
    assert int(search.update(POSITIONS.at[0, 5].add(2.5), neighbors).outside) == 5
    with pytest.raises(ParticleOutside, match="wrap the positions"):
        raise_if_wrong(search.update(POSITIONS.at[0, 5].add(2.5), neighbors))


def test_a_broken_promise_of_cell_order_is_flagged():
    flagged = SEARCH.update(POSITIONS, NEIGHBORS, in_cell_order=True)
    with pytest.raises(ValueError, match="not in cell order"):
        raise_if_wrong(flagged)


def test_use_beyond_the_skin():
    raise_if_wrong(NEIGHBORS, POSITIONS)
    near = POSITIONS.at[0, 5].add(0.009)
    assert is_valid(NEIGHBORS, near)
    far = POSITIONS.at[0, 5].add(0.011)
    assert not is_valid(NEIGHBORS, far)
    with pytest.raises(SkinExceeded, match=r"0\.022 m closer.*skin is 0\.02 m; rebuild"):
        raise_if_wrong(NEIGHBORS, far)
    assert not is_valid(NEIGHBORS, POSITIONS.at[0, 5].set(np.nan))
    with pytest.raises(SkinExceeded):
        raise_if_wrong(NEIGHBORS, POSITIONS.at[0, 5].set(np.nan))


def test_motion_of_two_sets_adds_up_and_periods_do_not_count():
    search = neighbor_list(Domain((0, 0), (1, 1), True), 0.18, 0.02)
    senders = POSITIONS[:, :20]
    two = search.allocate(POSITIONS, senders)
    # Round-off of coordinates near 1.
    assert moved(two, POSITIONS + 1.003, senders - 0.99) == pytest.approx(np.sqrt(2) * 0.013, abs=1e-14)
    with pytest.raises(ValueError, match="positions of its senders too"):
        moved(two, POSITIONS)
    with pytest.raises(ValueError, match="do not give senders"):
        moved(NEIGHBORS, POSITIONS, senders)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.0, 0.03))
def test_a_valid_list_misses_no_pair(seed, step):
    """The rule: while is_valid says so, every pair closer than the cutoff is in the list."""
    directions = np.random.default_rng(seed).normal(size=(2, 200))
    shifted = POSITIONS + step * jnp.asarray(directions / np.linalg.norm(directions, axis=0))
    valid = bool(is_valid(NEIGHBORS, shifted))
    assert valid == (2 * step < 0.02) or abs(2 * step - 0.02) < 1e-12  # round-off at the limit itself
    if valid:
        assert all_pairs(DOMAIN, shifted, shifted, 0.18, same=True) <= pairs_of(NEIGHBORS)


@given(st.floats(1e-6, 1.0), st.floats(1e-9, 1.0), st.floats(0.0, 100.0), st.none() | st.floats(0.0, 100.0))
def test_safe_steps_is_the_largest_safe_number(skin, time_step, speed, sender_speed):
    closing = 2 * speed if sender_speed is None else speed + sender_speed
    steps = safe_steps(skin, time_step, speed, sender_speed)
    if steps == 2**31 - 1:
        assert closing * time_step * steps <= skin * (1 + 1e-9)
        return
    assert steps == 0 or steps * time_step * closing < skin
    assert (steps + 1) * time_step * closing >= skin * (1 - 1e-9)  # round-off of the quotient


def test_bad_arguments_say_what_would_be_right():
    for lower, upper, word in [
        ((0, 0), (1, 1, 1), "same number"),
        ((0,), (1,), "2 or 3 axes"),
        ((0, 2), (1, 1), "axis 1 .*lower=2.0 >= upper=1.0"),
        ((0, -np.inf), (1, 1), "finite bounds"),
    ]:
        with pytest.raises(ValueError, match=word):
            Domain(lower, upper)
    with pytest.raises(ValueError, match="one entry for each of the 2 axes"):
        Domain((0, 0), (1, 1), (True, False, True))
    for keywords, word in [
        ({"cutoff": -1.0}, "cutoff=-1.0 must be positive"),
        ({"cutoff": 0.1, "skin": -0.1}, "skin=-0.1"),
        ({"cutoff": 0.1, "capacity_multiplier": 0.5}, "at least 1"),
        ({"cutoff": 0.1, "builder": "jaxmd"}, "choose one of"),
    ]:
        with pytest.raises(ValueError, match=word):
            neighbor_list(DOMAIN, **keywords)
    with pytest.raises(ValueError, match=r"support radius is too large for the box.*0\.52 m.*axis 1 .*1\.04 m"):
        neighbor_list(Domain((0, 0), (3, 1), (False, True)), 0.5, 0.02)
    for positions, word in [
        (np.zeros((200, 2)), "component first"),
        (np.zeros((2, 0)), "at least one particle"),
        (np.zeros((2, 5), int), "real numbers"),
    ]:
        with pytest.raises(ValueError, match=word):
            SEARCH.allocate(positions)
    with pytest.raises(ValueError, match="allocate a new list if the set changed"):
        SEARCH.update(POSITIONS[:, :100], NEIGHBORS)
    with pytest.raises(ValueError, match="allocate a list with this search"):
        neighbor_list(DOMAIN, 0.1).update(POSITIONS, NEIGHBORS)
    with pytest.raises(ValueError, match="cannot run inside jit"):
        jax.jit(SEARCH.allocate)(POSITIONS)


def test_one_particle_alone():
    neighbors = SEARCH.allocate(np.full((2, 1), 0.5))
    raise_if_wrong(neighbors)
    assert np.asarray(neighbors.count).tolist() == [0]


def test_domain_around_particles():
    domain = Domain.around(POSITIONS, 0.1)
    assert domain.lower == pytest.approx(np.asarray(POSITIONS).min(1) - 0.1)
    assert domain.upper == pytest.approx(np.asarray(POSITIONS).max(1) + 0.1)
    flat = Domain.around(np.zeros((3, 4)), 0.0)
    assert flat.contains(np.zeros((3, 4))).all()
    with pytest.raises(ValueError, match="finite"):
        Domain.around(np.full((2, 3), np.nan), 0.1)
    with pytest.raises(ValueError, match="margin=-1"):
        Domain.around(POSITIONS, -1.0)
