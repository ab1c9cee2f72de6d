"""Neighbor lists hold exactly the pairs within reach, judged by a k-d tree and by comparing all pairs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxsph.neighbors import CellGrid, Domain, cells, neighbor_list, raise_if_wrong

SPACING = 0.1


def lattice(dimension, jitter, seed=0):
    """Particles (d, N) in the unit box, spacing 0.1; jitter as a fraction of the spacing."""
    coordinates = np.arange(10) * SPACING + SPACING / 2
    points = np.stack([g.ravel() for g in np.meshgrid(*[coordinates] * dimension, indexing="ij")])
    moved = points + np.random.default_rng(seed).uniform(-jitter, jitter, points.shape) * SPACING
    return np.clip(moved, 1e-6, 1 - 1e-6)


def random(dimension, n=400, seed=1):
    return np.random.default_rng(seed).uniform(0, 1, (dimension, n))


def clusters(dimension, seed=2):
    """Dense blobs in an almost empty box."""
    rng = np.random.default_rng(seed)
    centers = rng.uniform(0.1, 0.9, (dimension, 6))
    return np.clip(np.repeat(centers, 40, axis=1) + rng.normal(0, 0.03, (dimension, 240)), 0, 1)


def on_cell_boundaries(dimension):
    """Particles exactly on the corners of the cells of a search with reach 0.25."""
    grid = CellGrid.covering(Domain((0,) * dimension, (1,) * dimension), 0.25)
    ticks = [np.arange(n + 1) / n for n in (grid.cells[0], *[6] * (dimension - 1))]
    return np.stack([g.ravel() for g in np.meshgrid(*ticks, indexing="ij")])


def coincident(dimension):
    """Every particle four times in the same place."""
    return np.repeat(random(dimension, 60, seed=3), 4, axis=1)


PARTICLES = {
    "lattice": lambda d: lattice(d, 0.0),
    "jittered": lambda d: lattice(d, 0.3),
    "random": random,
    "clusters": clusters,
    "on boundaries": on_cell_boundaries,
    "coincident": coincident,
}


def pairs_of(neighbors):
    """The list as a set of (receiver, sender)."""
    indices, count = np.asarray(neighbors.indices), np.asarray(neighbors.count)
    found = [(i, int(j)) for i in range(indices.shape[1]) for j in indices[: count[i], i]]
    assert len(found) == len(set(found)), "a neighbor is listed twice"
    return set(found)


def all_pairs(domain, a, b, reach, same):
    """Pairs within reach by comparing all with all, in the arithmetic of the arrays."""
    displacement = domain.displacement(a[:, :, None], b[:, None, :])
    near = np.array(jnp.sum(displacement * displacement, axis=0) < jnp.asarray(reach, a.dtype) ** 2)
    if same:
        np.fill_diagonal(near, False)
    return set(zip(*(index.tolist() for index in np.nonzero(near)), strict=True))


def tree_pairs(domain, a, b, reach, same):
    """Pairs surely within reach and pairs surely not beyond it: rounding decides between the two."""
    lower, box = np.asarray(domain.lower), np.where(domain.periodic, domain.lengths, 1e6)
    trees = [cKDTree((np.asarray(x, float).T - lower) % box, boxsize=box) for x in (a, b)]
    bounds = []
    for radius in (reach * (1 - 1e-5), reach * (1 + 1e-5)):
        near = trees[0].query_ball_tree(trees[1], radius)
        bounds.append({(i, j) for i, row in enumerate(near) for j in row if not (same and i == j)})
    return bounds


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("periodic", [False, True], ids=["free", "periodic"])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("particles", PARTICLES)
def test_one_set(particles, dimension, periodic, dtype):
    domain = Domain((0,) * dimension, (1,) * dimension, periodic)
    positions = jnp.asarray(PARTICLES[particles](dimension), dtype)
    neighbors = neighbor_list(domain, 0.22, 0.03).allocate(positions)
    raise_if_wrong(neighbors)
    found = pairs_of(neighbors)
    # The direct sum uses the same arithmetic, so that not one pair may differ; the tree bounds it independently.
    assert found == all_pairs(domain, positions, positions, 0.25, same=True)
    surely, at_most = tree_pairs(domain, positions, positions, 0.25, same=True)
    assert surely <= found <= at_most
    assert found == {(j, i) for i, j in found}, "the list is not symmetric"


@pytest.mark.parametrize("periodic", [(False, False), (True, False), (False, True), (True, True)])
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
    assert pairs_of(turned.transpose) == found
    assert turned.transpose.transpose is None


def test_two_sets_in_3d_of_very_different_size():
    domain = Domain((0, 0, 0), (1, 1, 1), (True, False, True))
    receivers, senders = jnp.asarray(random(3, 500)), jnp.asarray(random(3, 3, seed=9))
    neighbors = neighbor_list(domain, 0.3).allocate(receivers, senders)
    found = pairs_of(neighbors)
    assert found == all_pairs(domain, receivers, senders, 0.3, same=False)
    assert {(j, i) for i, j in found} == pairs_of(neighbors.transpose)


@pytest.mark.parametrize("length", [0.5, 0.55, 0.7, 0.76, 1.1, 1.3])
@pytest.mark.parametrize("axis", [0, 1])
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
    inside = jnp.asarray(random(2) + [[0.2], [0.1]], jnp.float32)
    shifts = np.random.default_rng(4).integers(-1, 2, inside.shape)
    beyond = jnp.clip(inside + jnp.asarray(shifts, jnp.float32), -0.79, 2.09)
    neighbors = neighbor_list(domain, 0.2).allocate(beyond)
    raise_if_wrong(neighbors)
    assert pairs_of(neighbors) == all_pairs(domain, beyond, beyond, 0.2, same=True)


def test_empty_slots_hold_indices_that_exist():
    domain = Domain((0, 0), (1, 1))
    positions = jnp.asarray(clusters(2))
    one = neighbor_list(domain, 0.05).allocate(positions)
    empty = np.arange(one.indices.shape[0])[:, None] >= np.asarray(one.count)
    assert empty.any()
    own = np.broadcast_to(np.arange(240), empty.shape)
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
    again = jax.jit(search.update, static_argnames="in_cell_order")(in_order, neighbors, in_cell_order=True)
    raise_if_wrong(again)
    assert {(int(identity[i]), int(identity[j])) for i, j in pairs_of(again)} == pairs_of(neighbors)


def test_cell_order_is_the_stable_sort_by_cell_also_when_the_keys_need_several_digits(monkeypatch):
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
    tree = cKDTree(np.asarray(positions).T)
    assert (np.asarray(neighbors.count) + 1 == tree.query_ball_point(tree.data, 0.05, return_length=True)).all()
    assert pairs_of(neighbors) == {(j, i) for i, j in pairs_of(neighbors)}


def test_a_domain_with_far_too_many_cells_is_searched_with_fewer():
    grid = CellGrid.covering(Domain((0, 0, 0), (100, 100, 100)), 0.05)
    assert grid.number_of_cells <= cells.CELLS_AT_MOST
    domain = Domain((-50, -50, -50), (50, 50, 50))
    positions = jnp.asarray(random(3, 300))
    assert pairs_of(neighbor_list(domain, 0.2).allocate(positions)) == all_pairs(
        domain, positions, positions, 0.2, same=True
    )


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
