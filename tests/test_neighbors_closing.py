"""How much closer pairs can have come, by region: no pair is missed, and going together is not taken for closing."""

import jax.numpy as jnp
import numpy as np
import pytest
from neighbor_oracles import all_pairs, lattice, pairs_of, random

from jaxsph.neighbors import Domain, closing, far_enough, moved, neighbor_list

CUTOFF, SKIN = 0.06, 0.03


def ways(positions, kind, seed):
    """How particles go: all the same way and each a little its own, sheared, block against block, or some alone."""
    draw, d = np.random.default_rng(seed), len(positions)
    together = draw.normal(size=(d, 1))
    if kind == "flow":
        return together + 0.05 * draw.normal(size=positions.shape)
    if kind == "shear":
        return np.stack([np.sin(2 * np.pi * positions[(axis + 1) % d]) for axis in range(d)]) + 3 * together
    if kind == "blocks":  # as large as the regions: within each, nobody comes closer to anybody
        return together * (1 - 2 * (np.floor(5 * positions).sum(axis=0) % 2))
    alone = np.zeros(positions.shape)
    alone[:, draw.integers(positions.shape[1], size=3)] = draw.normal(size=(d, 3))
    return alone


@pytest.mark.parametrize("kind", ["flow", "shear", "blocks", "alone"])
@pytest.mark.parametrize("sets", ["one", "two"])
@pytest.mark.parametrize(
    ("dimension", "periodic", "box"),
    [
        (2, (False, False), None),
        (2, (False, False), ((0.1, 0.05), (0.85, 0.8))),  # of 4 x 4 regions, which half of the particles have left
        (2, (True, False), None),
        (3, (True, True, True), None),
    ],
)
def test_no_pair_is_missed_as_long_as_none_came_closer_than_the_skin(dimension, periodic, box, sets, kind):
    """Ways are made so long that the first of the two bounds is just kept."""
    domain = Domain((0,) * dimension, (1,) * dimension, periodic)
    search = neighbor_list(domain, CUTOFF, SKIN, box=box)
    for seed in range(5):
        a, b = lattice(dimension, 0.4, seed), random(dimension, seed=seed + 10)
        parts = (a,) if sets == "one" else (a, b)
        neighbors = search.allocate(*map(jnp.asarray, parts))
        all_ways = [ways(part, kind, seed) for part in parts]
        found = closing(neighbors, *map(jnp.asarray, all_ways))
        # Less than half a period, beyond which another image is nearer.
        longest = max(float(np.abs(way).max()) for way in all_ways)
        worst = max(float(found.near.max()) / SKIN, float(found.far) / far_enough(neighbors), longest / 0.45)
        after = [jnp.asarray(part + 0.999 * way / worst) for part, way in zip(parts, all_ways, strict=True)]
        wide = Domain((-1,) * dimension, (2,) * dimension) if not any(periodic) else domain
        meet = set(all_pairs(wide, after[0], after[-1], CUTOFF, same=sets == "one"))
        assert meet <= set(pairs_of(neighbors))
        assert meet, "some pairs are within the cutoff"


def test_particles_on_both_sides_of_an_end_of_the_box_are_seen_to_close():
    """Their regions are the last and the first of it; everybody else stays."""
    domain, inside = Domain((-4, -4), (5, 5)), np.array([[0.2, 0.2], [0.6, 0.8]])
    for axis in (0, 1):
        pair = np.full((2, 2), 0.5)
        pair[axis] = 0.98, 1.05
        positions = jnp.asarray(np.concatenate([pair, inside], axis=1))
        ways = jnp.zeros((2, 4)).at[axis, :2].set(jnp.array([0.015, -0.015]))
        neighbors = neighbor_list(domain, CUTOFF, SKIN, box=((0.0, 0.0), (1.0, 1.0))).allocate(positions)
        assert pairs_of(neighbors) == {(0, 1), (1, 0)}
        found = closing(neighbors, ways)
        assert float(found.near.max()) == pytest.approx(0.03)  # .015 each, towards each other


@pytest.mark.parametrize("sets", ["one", "two"])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("axis", [0, 1])
def test_with_a_region_between_them_only_what_they_come_closer_along_that_axis_counts(axis, side, sets):
    """Of eleven regions along each axis one stands in the sixth, and the other in the fourth or the eighth."""
    a = jnp.full((2, 1), 0.5)
    b = a.at[axis].add(0.19 * side)
    towards = jnp.full((2, 1), 0.05).at[axis].set(-0.01 * side)
    search = neighbor_list(Domain((0, 0), (1, 1)), CUTOFF, SKIN)
    for ways, closer in ((towards, 0.01), (-towards, 0.0)):
        if sets == "two":
            found = closing(search.allocate(a, b), jnp.zeros_like(a), ways)
            at_rest = closing(search.allocate(a, b), 0, ways)
            np.testing.assert_array_equal(found.near, at_rest.near)
        else:
            found = closing(search.allocate(jnp.hstack([a, b])), jnp.hstack([jnp.zeros_like(a), ways]))
        assert float(found.near.max()) == pytest.approx(closer, abs=1e-17)  # one difference of numbers of .01
        assert float(found.far) == pytest.approx(float(jnp.linalg.norm(ways)))


def test_closing_has_the_precision_of_the_list():
    positions = jnp.asarray(lattice(2, 0.1), jnp.float32)
    neighbors = neighbor_list(Domain((0, 0), (1, 1)), CUTOFF, SKIN).allocate(positions)
    found = closing(neighbors, positions)
    assert found.near.dtype == found.far.dtype == jnp.float32


def test_particles_that_go_together_do_not_close():
    search = neighbor_list(Domain((0, 0), (1, 1)), CUTOFF, SKIN)
    positions = jnp.asarray(lattice(2, 0.4))
    neighbors = search.allocate(positions)
    together = jnp.full_like(positions, 0.1)
    found = closing(neighbors, together)
    assert float(found.near.max()) == float(found.far) == 0
    assert float(moved(neighbors, positions + together)) == pytest.approx(0.2 * np.sqrt(2))
    # A shear that a region hardly sees: .1 from one end of the box to the other.
    shear = jnp.stack([0.1 * positions[1], jnp.zeros_like(positions[1])])
    found = closing(neighbors, shear)
    assert float(found.far) == pytest.approx(0.1, rel=0.1)  # particles do not reach the walls
    assert float(found.near.max()) == pytest.approx(0.1 * 3 / 11, rel=0.1), "three regions of eleven"


def test_senders_belong_to_lists_of_two_sets():
    search = neighbor_list(Domain((0, 0), (1, 1)), CUTOFF, SKIN)
    positions = jnp.asarray(lattice(2, 0.1))
    with pytest.raises(ValueError, match="senders"):
        closing(search.allocate(positions, positions), positions)
    with pytest.raises(ValueError, match="senders"):
        closing(search.allocate(positions), positions, positions)
