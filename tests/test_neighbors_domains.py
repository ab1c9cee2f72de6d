"""Neighbor lists between two sets, and in domains that are periodic, small, large or almost empty."""

import jax.numpy as jnp
import numpy as np
import pytest
from neighbor_oracles import all_pairs, pairs_of, random

from jaxsph import scenes
from jaxsph.neighbors import CellGrid, Domain, cells, neighbor_list, raise_if_wrong


@pytest.mark.parametrize("periodic", [(False, True), (True, True)])
def test_two_sets_and_their_transpose(periodic):
    domain = Domain((-1, 2), (0.5, 3), periodic)
    rng = np.random.default_rng(5)
    receivers = jnp.asarray(rng.uniform((-1, 2), (0.5, 3), (300, 2)).T, jnp.float32)
    senders = jnp.asarray(rng.uniform((-1, 2), (0.5, 3), (170, 2)).T, jnp.float32)
    neighbors = neighbor_list(domain, 0.2, 0.02).allocate(receivers, senders)
    raise_if_wrong(neighbors)
    found = pairs_of(neighbors)
    assert found == all_pairs(domain, receivers, senders, 0.22, same=False)
    assert {(j, i) for i, j in found} == pairs_of(neighbors.transpose)
    turned = neighbors.transposed()
    assert pairs_of(turned) == pairs_of(neighbors.transpose)
    assert turned.transpose is not None
    assert pairs_of(turned.transpose) == found
    assert turned.transpose.transpose is None


def test_two_sets_in_3d_of_very_different_size():
    domain = Domain((0, 0, 0), (1, 1, 1), (True, False, True))
    receivers, senders = jnp.asarray(random(3, 500)), jnp.asarray(random(3, 3, seed=9))
    neighbors = neighbor_list(domain, 0.3).allocate(receivers, senders)
    found = pairs_of(neighbors)
    assert found == all_pairs(domain, receivers, senders, 0.3, same=False)
    assert {(j, i) for i, j in found} == pairs_of(neighbors.transpose)


@pytest.mark.parametrize(("axis", "length"), [(0, 0.5), (0, 0.7), (1, 0.5), (1, 0.55), (1, 0.76), (1, 1.3)])
def test_few_cells_along_a_periodic_axis(axis, length):
    """From two reaches, where both neighbors of a cell are the same one, to the first length with ordinary cells."""
    upper = [1.0, 1.0]
    upper[axis] = length
    domain = Domain((0, 0), upper, True)
    positions = jnp.asarray(random(2, 200) * np.asarray(upper)[:, None])
    neighbors = neighbor_list(domain, 0.25).allocate(positions)
    assert pairs_of(neighbors) == all_pairs(domain, positions, positions, 0.25, same=True)


def test_a_domain_smaller_than_the_reach_along_free_axes():
    domain = Domain((0, 0, 0), (0.1, 0.2, 0.1))
    positions = jnp.asarray(random(3, 50) * np.asarray([[0.1], [0.2], [0.1]]))
    neighbors = neighbor_list(domain, 1.0).allocate(positions)
    assert np.asarray(neighbors.count).tolist() == [49] * 50


def test_positions_up_to_a_period_beyond_a_periodic_box():
    domain = Domain((0.2, 0.1), (1.2, 1.1), True)
    inside = jnp.asarray(random(2) + np.asarray([[0.2], [0.1]]), jnp.float32)
    shifts = np.random.default_rng(4).integers(-1, 2, inside.shape)
    beyond = jnp.clip(inside + jnp.asarray(shifts, jnp.float32), -0.79, 2.09)
    neighbors = neighbor_list(domain, 0.2).allocate(beyond)
    raise_if_wrong(neighbors)
    assert pairs_of(neighbors) == all_pairs(domain, beyond, beyond, 0.2, same=True)


def test_a_domain_with_far_too_many_cells_is_searched_with_fewer():
    grid = CellGrid.covering(Domain((0, 0, 0), (100, 100, 100)), 0.05)
    assert grid.number_of_cells <= cells.CELLS_AT_MOST
    domain = Domain((-50, -50, -50), (50, 50, 50))
    positions = jnp.asarray(random(3, 300))
    assert pairs_of(neighbor_list(domain, 0.2).allocate(positions)) == all_pairs(
        domain, positions, positions, 0.2, same=True
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_neighbors_of_particles_that_left_the_box_are_found_and_they_do_not_crowd(dimension):
    """They flow out of the box to three times its length on either side, and some of them above it."""
    domain, box = Domain((-4.0,) * dimension, (5.0,) * dimension), ((0.0,) * dimension, (1.0,) * dimension)
    rng = np.random.default_rng(8)
    low, high = (-3.0,) + (0.0,) * (dimension - 1), (4.0,) + (1.2,) * (dimension - 1)
    positions, others = (jnp.asarray(rng.uniform(low, high, (n, dimension)).T) for n in (700, 300))
    search = neighbor_list(domain, 0.15, 0.02, box=box)
    inside = jnp.asarray(rng.uniform(0, 1, (700, dimension)).T)
    assert search.grid.repeats(0)
    neighbors = search.update(positions, search.template(positions))
    raise_if_wrong(neighbors)
    assert pairs_of(neighbors) == all_pairs(domain, positions, positions, 0.17, same=True)
    # Spread over seven boxes that are laid over each other, they are as dense as in one.
    assert int(neighbors.needed_range[0]) < 2 * int(search.allocate(inside).needed_range[0])
    expected = all_pairs(domain, positions, others, 0.17, same=False)
    assert pairs_of(search.update(positions, search.template(positions, others), others)) == expected
    few = jnp.full((dimension, 2), 0.6).at[0].set(jnp.array([1.02, -1.98]))  # just beyond an end: in the first cells
    rows = search.update(positions, search.template(positions, few, near_only=True), few)
    raise_if_wrong(rows)
    assert rows.members is not None and rows.transpose is not None and rows.transpose.members is not None
    here, there = np.asarray(rows.members), np.asarray(rows.transpose.members)
    found = {(int(here[i]), int(there[j])) for i, j in pairs_of(rows)}
    assert found == all_pairs(domain, positions, few, 0.17, same=False)
    assert 0 < int(rows.needed_members) < 700, "only some are near"


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_what_is_at_the_end_of_the_box_is_in_its_last_cells(kind):
    """The walls of a tank end where the box does. In the first cells, where rounding may put them, they would crowd
    those so much that lists with the reserve of a whole run are too small for its first step: all is compiled twice."""
    scene = scenes.dam_break(71, smoothing=1.3, dtype=kind)
    walls = np.asarray(scene.walls[0].particles.positions).T
    box = tuple(walls.min(1).tolist()), tuple(walls.max(1).tolist())
    search = neighbor_list(Domain((-20, -20), (20, 20)), 0.022, 0.009, capacity_multiplier=1.0, box=box)
    assert search.grid.repeats(0)
    last = np.asarray(search.grid.coordinates(jnp.asarray(walls)))[0, walls[0] == walls[0].max()]
    assert (last == search.grid.cells[0] - 1).all()
    neighbors = search.update(jnp.asarray(walls), search.template(walls))
    raise_if_wrong(neighbors)
    assert int(neighbors.needed_range[0]) == neighbors.capacity.range, "counted for the sizes as in the search"


def test_positions_for_a_tree_are_within_one_period():
    """Also what is left of the lower bound by less than rounding, whose remainder comes out as the whole period."""
    domain = Domain((-0.5, 0), (0.5, 1), (True, False))
    points, period = domain.for_tree(np.array([[-0.5 - 1e-20, -3.0], [0.5, 2.0], [-0.6, 0.0], [2.25, 0.5]]))
    tiny, _ = Domain((0, 0), (1, 1), (True, True)).for_tree(np.array([[-1e-20, 0.3]]))
    np.testing.assert_array_equal(tiny, [[0.0, 0.3]])
    np.testing.assert_array_equal(period, [1.0, 0.0])
    np.testing.assert_allclose(points, [[0, -3], [0, 2], [0.9, 0], [0.75, 0.5]], atol=1e-15)
    assert Domain((0, 0), (1, 1)).for_tree(np.zeros((1, 2)))[1] is None
