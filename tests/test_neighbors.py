"""Neighbor lists hold exactly the pairs within reach, judged by a k-d tree and by comparing all pairs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from neighbor_oracles import PARTICLES, N, all_pairs, clusters, pairs_of, random, tree_pairs
from scipy.spatial import KDTree

from jaxsph.neighbors import CellGrid, Domain, cells, filling, neighbor_list, raise_if_wrong


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("periodic", [False, True], ids=["free", "periodic"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_one_set(dimension, periodic, dtype):
    domain = Domain((0,) * dimension, (1,) * dimension, periodic)
    search = neighbor_list(domain, 0.22, 0.03, capacity_multiplier=3.0)
    neighbors = search.allocate(jnp.asarray(clusters(dimension), dtype))
    for name, arrange in PARTICLES.items():
        positions = jnp.asarray(arrange(dimension), dtype)
        updated = search.update(positions, neighbors)
        raise_if_wrong(updated, name=name)
        found = pairs_of(updated)
        surely, at_most = tree_pairs(domain, positions, positions, 0.25, same=True)
        assert surely <= found <= at_most, name
        # Many of these pairs are exactly 0.25 apart; whichever way rounding decides, it must decide alike for both.
        assert found == {(j, i) for i, j in found}, f"the list of {name} is not symmetric"


@pytest.mark.parametrize("periodic", [(False, False), (True, False), (False, True, False)])
def test_rows_for_those_near_the_other_set_alone(periodic):
    """So many rows that they are searched in several tiles, and so many left over that whole tiles are left out."""
    dimension = len(periodic)
    domain, draw = Domain((0,) * dimension, (1,) * dimension, periodic), np.random.default_rng(5)
    a, b = draw.uniform(0, 1, (dimension, 5000)), draw.uniform(0, 1, (dimension, 4000))
    b[-1] *= 0.3  # nobody of it in the rest of the box
    a, b = jnp.asarray(a), jnp.asarray(b)
    search = neighbor_list(domain, 0.05, capacity_multiplier=2.0)
    neighbors = search.allocate(a, b, near_only=True)
    raise_if_wrong(neighbors)
    back, rows = neighbors.transpose, neighbors.capacity.members
    assert back is not None and rows is not None
    assert 1024 < int(neighbors.needed_members) < rows - 1024
    surely, at_most = tree_pairs(domain, a, b, 0.05, same=False)
    for part, other, flip in ((neighbors, back, False), (back, neighbors, True)):
        members, others = np.asarray(part.members), np.asarray(other.members)
        found = {(int(members[i]), int(others[j])) for i, j in pairs_of(part)}
        found = {(j, i) for i, j in found} if flip else found
        assert surely <= found <= at_most
        n_near = int(part.needed_members)
        assert (np.asarray(part.count)[n_near:] == 0).all()
        # Their places are those of the members, and one beyond all rows for the others.
        place = np.asarray(part.place)
        np.testing.assert_array_equal(place[members[:n_near]], np.arange(n_near))
        assert (np.delete(place, members[:n_near]) == len(members)).all()


def test_many_rows_are_in_the_order_of_their_number_of_neighbors():
    """A tile of receivers then takes few turns; the pairs are those of the list whose receivers all have a row."""
    domain, draw = Domain((0, 0, 0), (1, 1, 1)), np.random.default_rng(6)
    a, b = draw.uniform(0, 1, (3, 32_000)), draw.uniform(0, 1, (3, 5000))
    b[-1] = 0.1 * b[-1] ** 2  # crowded, so that some have many more than others
    search = neighbor_list(domain, 0.05, capacity_multiplier=2.0)
    rows = search.allocate(jnp.asarray(a, jnp.float32), jnp.asarray(b, jnp.float32), near_only=True)
    raise_if_wrong(rows)
    back = rows.transpose
    assert back is not None and back.members is not None and rows.members is not None
    assert max(len(rows.members), len(back.members)) >= filling.ORDERED_FROM
    pairs = pairs_of(search.allocate(jnp.asarray(a, jnp.float32), jnp.asarray(b, jnp.float32)))
    for part, other, flip in ((rows, back, False), (back, rows, True)):
        assert part.place is not None and part.used is not None
        count, members, others = (np.asarray(values) for values in (part.count, part.members, other.members))
        assert (np.diff(count) <= 0).all() and 0 < count[int(part.used) - 1] < count[0]
        found = {(int(members[i]), int(others[j])) for i, j in pairs_of(part)}
        assert ({(j, i) for i, j in found} if flip else found) == pairs
        used = members[members < part.place.shape[0]]
        np.testing.assert_array_equal(np.asarray(part.place)[used], np.arange(len(used)))


def test_empty_slots_hold_indices_that_exist():
    domain = Domain((0, 0), (1, 1))
    positions = jnp.asarray(clusters(2))
    one = neighbor_list(domain, 0.05).allocate(positions)
    empty = np.arange(one.indices.shape[0])[:, None] >= np.asarray(one.count)
    assert empty.any()
    own = np.broadcast_to(np.arange(N), empty.shape)
    assert (np.asarray(one.indices)[empty] == own[empty]).all()
    two = neighbor_list(domain, 0.05).allocate(positions, positions[:, :7])
    empty = np.arange(two.indices.shape[0])[:, None] >= np.asarray(two.count)
    assert (np.asarray(two.indices)[empty] == 0).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_cell_order_gives_the_same_pairs_and_keeps_identities(dimension):
    domain = Domain((0,) * dimension, (1,) * dimension, True)
    positions = jnp.asarray(random(dimension, 900), jnp.float32)
    search = neighbor_list(domain, 0.2)
    neighbors = search.allocate(positions)
    identity = np.asarray(jax.jit(search.sort)(positions))
    assert sorted(identity.tolist()) == list(range(900))
    in_order = positions[:, identity]
    again = search.update(in_order, neighbors, in_cell_order=True)
    raise_if_wrong(again)
    assert {(int(identity[i]), int(identity[j])) for i, j in pairs_of(again)} == pairs_of(neighbors)


def test_cell_order_is_the_stable_sort_by_cell_also_when_the_keys_need_several_digits():
    grid = CellGrid.covering(Domain((0, 0), (1, 1)), 0.004)  # 500 x 1,000 cells are 19 bits, and 20,000 particles 15
    assert grid.number_of_cells > 2**17
    positions = jnp.asarray(random(2, 20_000), jnp.float32)
    expected = np.argsort(np.asarray(grid.number(grid.coordinates(positions))), kind="stable")
    assert (np.asarray(cells.cell_order(grid, positions)) == expected).all()


def test_many_tiles_give_what_one_gives(monkeypatch):
    """5,000 particles in tiles of 1,024, the last one overlapping, against the tree's number of pairs."""
    monkeypatch.setattr("jaxsph.neighbors.search.TILE_BYTES", 1)
    positions = jnp.asarray(random(2, 5000))
    neighbors = neighbor_list(Domain((0, 0), (1, 1)), 0.05).allocate(positions)
    tree = KDTree(np.asarray(positions).T)
    assert (np.asarray(neighbors.count) + 1 == tree.query_ball_point(tree.data, 0.05, return_length=True)).all()
    assert pairs_of(neighbors) == {(j, i) for i, j in pairs_of(neighbors)}


def test_vmap_over_positions():
    domain = Domain((0, 0), (1, 1), (True, False))
    sets = jnp.asarray(np.stack([random(2, 300, seed) for seed in range(3)]), jnp.float32)
    search = neighbor_list(domain, 0.15, capacity_multiplier=2.0)
    neighbors = search.allocate(sets[0])
    batch = jax.jit(jax.vmap(search.update, (0, None)))(sets, neighbors)
    for number in range(3):
        one = jax.tree.map(lambda leaf, number=number: leaf[number], batch)
        raise_if_wrong(one)
        assert pairs_of(one) == all_pairs(domain, sets[number], sets[number], 0.15, same=True)


def test_update_inside_scan_follows_the_particles():
    domain = Domain((0, 0), (1, 1), True)
    positions = jnp.asarray(random(2, 300))
    velocity = jnp.asarray(random(2, 300, seed=8) - 0.5)
    search = neighbor_list(domain, 0.15, capacity_multiplier=2.0)

    @jax.jit
    def run(positions, neighbors):
        def step(carry, _):
            moved = carry[0] + 0.1 * velocity
            return (moved, search.update(moved, carry[1])), None

        return jax.lax.scan(step, (positions, neighbors), length=5)[0]

    final, neighbors = run(positions, search.allocate(positions))
    raise_if_wrong(neighbors, final)
    assert pairs_of(neighbors) == all_pairs(domain, final, final, 0.15, same=True)


def test_derivatives_stop_at_the_list():
    domain = Domain((0, 0), (1, 1))
    positions = jnp.asarray(random(2, 100))
    search = neighbor_list(domain, 0.2)
    neighbors = search.allocate(positions)

    def sum_of_squared_distances(positions):
        updated = search.update(positions, neighbors)
        difference = positions[:, updated.indices] - positions[:, None, :]
        return jnp.sum(difference**2)

    for gradient in (jax.grad(sum_of_squared_distances)(positions), jax.jacfwd(sum_of_squared_distances)(positions)):
        assert np.isfinite(np.asarray(gradient)).all()
        assert np.abs(np.asarray(gradient)).max() > 0
