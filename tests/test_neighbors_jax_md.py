"""jax-md's builder as the oracle of ours, as a choice, and lists converted in both directions."""

import importlib.util
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from neighbor_oracles import N, clusters, lattice, pairs_of, random

from jaxsph.errors import NeighborOverflow
from jaxsph.neighbors import Domain, from_jax_md, jax_md, neighbor_list, raise_if_wrong, to_jax_md


@pytest.mark.parametrize(
    ("dimension", "periodic", "dtype"),
    [(2, (False, False), "float32"), (2, (True, False), "float64"), (3, (True, True, True), "float32")],
)
def test_both_builders_find_the_same_pairs(dimension, periodic, dtype):
    # An origin inside the domain, where jax-md alone goes wrong.
    domain = Domain((-0.5,) * dimension, (0.5,) * dimension, periodic)
    ours = neighbor_list(domain, 0.2, 0.03, capacity_multiplier=3.0)
    theirs = neighbor_list(domain, 0.2, 0.03, capacity_multiplier=3.0, builder="jax-md")
    first = jnp.asarray(clusters(dimension) - 0.5, dtype)
    lists = ours.allocate(first), theirs.allocate(first)
    for arrange in (random, lambda d: lattice(d, 0.3)):
        positions = jnp.asarray(arrange(dimension) - 0.5, dtype)
        found = [search.update(positions, neighbors) for search, neighbors in zip((ours, theirs), lists, strict=True)]
        for neighbors in found:
            raise_if_wrong(neighbors, positions)
        assert pairs_of(found[0]) == pairs_of(found[1])
        assert np.asarray(found[0].count).tolist() == np.asarray(found[1].count).tolist()


def test_an_axis_of_fewer_than_three_cells():
    domain = Domain((0, 0), (1, 0.5), True)
    positions = jnp.asarray(random(2, 200) * [[1.0], [0.5]])
    lists = [neighbor_list(domain, 0.2, builder=name).allocate(positions) for name in ("cells", "jax-md")]
    assert pairs_of(lists[0]) == pairs_of(lists[1])


def test_jax_md_overflow_and_update_inside_jit():
    search = neighbor_list(Domain((0, 0), (1, 1)), 0.18, 0.02, builder="jax-md")
    positions = jnp.asarray(random(2))
    neighbors = search.allocate(positions)
    raise_if_wrong(jax.jit(search.update)(positions, neighbors))
    crowded = jax.jit(search.update)(0.5 + 0.3 * positions, neighbors)
    with pytest.raises(NeighborOverflow, match="allocate the list again"):
        raise_if_wrong(crowded)
    lost = jax.jit(search.update)(positions.at[0, 7].set(jnp.nan), neighbors)  # jax-md itself does not notice
    assert int(lost.outside) == 7


def test_lists_between_two_sets_are_refused():
    search = neighbor_list(Domain((0, 0), (1, 1)), 0.2, builder="jax-md")
    with pytest.raises(ValueError, match=r'no lists between two sets.*builder="cells"'):
        search.allocate(random(2), random(2, 50))


@pytest.mark.parametrize("lower", [(0, 0), (-2, 1)])
def test_there_and_back(lower):
    """A list of ours goes to jax-md, is updated there, comes back, and is updated here."""
    corner = np.asarray(lower, float)[:, None]
    domain = Domain(lower, np.asarray(lower) + 1)
    search = neighbor_list(domain, 0.15, 0.02)
    positions = jnp.asarray(random(2) + corner)
    neighbors = search.allocate(positions)
    there = to_jax_md(neighbors)
    assert there.idx.shape == (N, neighbors.indices.shape[0])
    assert pairs_in(there) == pairs_of(neighbors)
    back = from_jax_md(there, domain, 0.15, 0.02)
    assert pairs_of(back) == pairs_of(neighbors)
    raise_if_wrong(back, positions)

    moved = jnp.asarray(lattice(2, 0.3) + corner)  # far beyond the skin, so that jax-md rebuilds too
    expected = pairs_of(search.update(moved, neighbors))
    assert pairs_in(there.update((moved - corner).T)) == expected
    assert pairs_of(search.update(moved, back)) == expected


def pairs_in(theirs):
    """A list of jax-md's as a set of (receiver, sender)."""
    return {(i, int(j)) for i, row in enumerate(np.asarray(theirs.idx)) for j in row if j < N}


def test_only_dense_lists_of_one_set_convert():
    domain = Domain((0, 0), (1, 1))
    partition = jax_md.load()
    distance = lambda a, b, **_: jnp.sqrt(jnp.sum((a - b) ** 2))  # noqa: E731
    search = partition.neighbor_list(distance, 1.0, 0.2, format=partition.NeighborListFormat.Sparse)
    sparse = search.allocate(jnp.asarray(random(2).T))
    with pytest.raises(ValueError, match="Dense"):
        from_jax_md(sparse, domain, 0.2)
    two = neighbor_list(domain, 0.2).allocate(random(2), random(2, 30))
    with pytest.raises(ValueError, match="no lists between two sets"):
        to_jax_md(two)


def test_jax_md_loads_without_the_rest_of_its_package_and_leaves_room_for_it():
    code = (
        "import sys, jaxsph.neighbors.jax_md as m; assert 'jax_md' not in str(sys.modules.get('jax_md'));"
        "p = m.load(); assert 'jax_md' not in sys.modules; assert 'jax_md.energy' not in sys.modules;"
        "assert sys.modules['jax_md.partition'] is p and p.neighbor_list"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_without_jax_md_the_error_says_what_to_install(monkeypatch):
    jax_md.load.cache_clear()
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r'pip install "jaxsph\[jax-md\]"'):
        neighbor_list(Domain((0, 0), (1, 1)), 0.2, builder="jax-md")
    jax_md.load.cache_clear()
