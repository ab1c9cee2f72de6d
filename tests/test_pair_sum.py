"""The pair sum against a direct sum over all pairs, its derivatives, and what it conserves."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxsph import Domain, PairList, pair_edges, pair_sum, slots
from jaxsph.neighbors import neighbor_list
from jaxsph.neighbors.lists import raise_if_wrong
from jaxsph.pair_sum import apply, dot, symmetry_error
from jaxsph.pytree import replace
from jaxsph.side_by_side import SideBySide

CUTOFF = 0.45
N = {"one": (40, 40), "two": (40, 25)}

in_2d_and_3d = pytest.mark.parametrize("d", [2, 3])
one_and_two_sets = pytest.mark.parametrize("sets", ["one", "two"])


def pack(index_lists, own):
    """(K, N) indices and (N,) counts; empty slots hold the own index, or 0."""
    count = np.array([len(found) for found in index_lists])
    indices = np.zeros((max(count.max(), 1) + 2, len(index_lists)), np.int32)  # two slots that nobody needs
    if own:
        indices[:] = np.arange(len(index_lists))
    for i, found in enumerate(index_lists):
        indices[: len(found), i] = found
    return jnp.asarray(indices), jnp.asarray(count.astype(np.int32))


def list_of(x, y=None):
    """Neighbor list of positions (d, N) in one set, without the particle itself, or in two."""
    tree = KDTree(x.T)
    if y is None:
        found = [sorted(set(near) - {i}) for i, near in enumerate(tree.query_ball_point(x.T, CUTOFF))]
        return PairList(*pack(found, own=True))
    other = KDTree(y.T)
    back = PairList(*pack(tree.query_ball_point(y.T, CUTOFF), own=False))
    return PairList(*pack(other.query_ball_point(x.T, CUTOFF), own=False), back)


def fields(d, n, kind, seed):
    """Scalar, vector and tensor fields; the last two particles are far from all others."""
    draw = np.random.default_rng(seed)
    x = draw.uniform(0, 1, (d, n))
    x[:, -2:] = [[10.0 + seed, 20.0 + seed]] * d
    made = {"x": x, "m": draw.uniform(1, 2, n), "t": draw.normal(size=(d, d, n)), "v": draw.normal(size=(d, n))}
    return {name: jnp.asarray(value.astype(kind)) for name, value in made.items()}


def problem(sets, d, kind: Any = np.float64):
    a = fields(d, N[sets][0], kind, 0)
    if sets == "one":
        return a, a, list_of(np.asarray(a["x"], float))
    b = fields(d, N[sets][1], kind, 1)
    return a, b, list_of(np.asarray(a["x"], float), np.asarray(b["x"], float))


def physics(a, b, length=0.3):
    """Something of every kind, smooth, not symmetric, and not zero for a particle with itself."""
    r = a["x"] - b["x"]
    w = jnp.exp(-dot(r, r) / length**2)
    return {
        "scalar": a["m"] * b["m"] ** 2 * w,
        "vector": w * (b["m"] * r + apply(a["t"], b["v"])),
        "tensor": w * (a["t"] * b["m"] + a["v"][:, None] * b["x"][None, :]),
    }


def direct(a, b, neighbors, one_set, length=0.3):
    """The same over all pairs, in NumPy and float64."""
    del neighbors
    a, b = ({k: np.asarray(v, np.float64) for k, v in f.items()} for f in (a, b))
    r = a["x"][:, :, None] - b["x"][:, None, :]
    squared = np.sum(r**2, axis=0)
    w = np.exp(-squared / length**2) * (squared <= CUTOFF**2)
    if one_set:
        np.fill_diagonal(w, 0)
    return {
        "scalar": np.einsum("i,j,ij->i", a["m"], b["m"] ** 2, w),
        "vector": np.einsum("ij,j,kij->ki", w, b["m"], r) + np.einsum("ij,kli,lj->ki", w, a["t"], b["v"]),
        "tensor": np.einsum("ij,kli,j->kli", w, a["t"], b["m"]) + np.einsum("ij,ki,lj->kli", w, a["v"], b["x"]),
    }


def weighted(out):
    """A number that depends on all that comes out, each with its own weight."""
    leaves = jax.tree.leaves(out)
    return sum(jnp.sum((leaf + i) ** 2 * np.cos(np.arange(leaf.shape[-1]))) for i, leaf in enumerate(leaves))


@in_2d_and_3d
@one_and_two_sets
@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-13), (np.float32, 1e-5)])
def test_values_are_those_of_the_direct_sum(sets, d, kind, tolerance):
    a, b, neighbors = problem(sets, d, kind)
    expected = direct(a, b, neighbors, sets == "one")
    for forward_mode in (False, True):
        out = jax.jit(lambda a, b, mode=forward_mode: pair_sum(physics, a, b, neighbors, forward_mode=mode))(a, b)
        for name, value in out.items():
            assert value.dtype == kind
            scale = np.abs(expected[name]).max()
            # sums of some twenty terms, each some ten roundings
            np.testing.assert_allclose(value, expected[name], rtol=0, atol=tolerance * scale, err_msg=name)
            np.testing.assert_array_equal(value[..., -2:], 0, err_msg="nobody is near the last two")


@pytest.mark.parametrize("tile", [64, 100])
@one_and_two_sets
def test_tiles_of_receivers_change_nothing(sets, tile, monkeypatch):
    """Values, tangents, adjoints and batches of a sum taken tile by tile, the last tile overlapping the one before."""
    draw = np.random.default_rng(2)
    x, y = (jnp.asarray(draw.uniform(0, 2, (2, n))) for n in (330, 250))
    neighbors = list_of(np.asarray(x)) if sets == "one" else list_of(np.asarray(x), np.asarray(y))

    def loss(x, y, forward_mode=False):
        of_pair = lambda a, b: (a - b) / (1 + dot(a - b, a - b)) * a[0] * b[1] ** 2  # noqa: E731
        return weighted(pair_sum(of_pair, x, x if sets == "one" else y, neighbors, forward_mode=forward_mode))

    def everything(x, y):
        slopes = jax.grad(loss, argnums=(0, 1))
        many = jax.vmap(slopes)(jnp.stack([x, 2 * x]), jnp.stack([y, y]))
        along = (x, y), (y[:, :1] * x, jnp.sin(y))
        tangents = [jax.jvp(partial(loss, forward_mode=mode), *along)[1] for mode in (False, True)]
        return loss(x, y), slopes(x, y), tangents, many

    whole = jax.jit(everything)(x, y)
    monkeypatch.setattr(slots, "TILE", tile)
    text = jax.jit(lambda *both: everything(*both)).lower(x, y).as_text()
    assert "dynamic_update_slice" in text, "tiles were used"
    forward = lambda x, y: jax.jvp(partial(loss, forward_mode=True), (x, y), (x, y))[1]  # noqa: E731
    assert "dynamic_update_slice" in jax.jit(forward).lower(x, y).as_text(), "and also where it is asked for a loop"
    for got, expected in zip(
        jax.tree.leaves(jax.jit(lambda *both: everything(*both))(x, y)), jax.tree.leaves(whole), strict=True
    ):
        # the same terms in the same order; XLA may contract products and sums in another way
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-14 * np.abs(expected).max() * 330)


def test_rows_that_are_not_in_use_change_nothing(monkeypatch):
    """Values and derivatives of lists with rows for those near the other set: in parts, of which one is cut short."""
    monkeypatch.setattr(slots, "SMALLEST_TILE", 50)
    draw = np.random.default_rng(6)
    x, y = draw.uniform(0, 1, (2, 3000)), draw.uniform(0, 1, (2, 2000))
    y[1] *= 0.2
    x, y = jnp.asarray(x), jnp.asarray(y)
    search = neighbor_list(Domain((0, 0), (1, 1)), 0.04, capacity_multiplier=1.5)
    all_rows, few = search.allocate(x, y), search.allocate(x, y, near_only=True)
    raise_if_wrong(few)
    in_use = int(jnp.max(jnp.where(few.count > 0, jnp.arange(few.count.shape[0]) + 1, 0)))
    part = slots._width_of_tiles(few.count.shape[0], partly_used=True)
    assert part < few.count.shape[0] // 7 and in_use % part and in_use + part < few.count.shape[0], "parts are left out"

    def everything(neighbors, x, y):
        def loss(x, y):
            of_pair = lambda a, b: (a - b) / (1 + dot(a - b, a - b)) * a[0] * b[1] ** 2  # noqa: E731
            return weighted(pair_sum(of_pair, x, y, neighbors))

        return loss(x, y), jax.grad(loss, argnums=(0, 1))(x, y), jax.jvp(loss, (x, y), (jnp.cos(x), y))[1]

    got, expected = (jax.tree.leaves(jax.jit(everything)(one, x, y)) for one in (few, all_rows))
    for one, other in zip(got, expected, strict=True):
        assert np.abs(other).max() > 0
        # the same terms in the same order; should XLA contract them in another way, ten roundings for each of some
        # twenty, and a hundred times that for the total, of which most cancels
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-15 * np.abs(other).max() * 20 * (1 if one.ndim else 100))


@pytest.mark.parametrize(("several", "abreast"), [(2, 1), (100, 1), (1, 2), (1, 100), (3, 2)])
@pytest.mark.parametrize(("sets", "sign"), [("one", None), ("one", 1), ("one", -1), ("two", None)])
def test_several_slots_in_a_turn_change_nothing(sets, sign, several, abreast, monkeypatch):
    """Values, tangents and adjoints; two by two, which leaves one of the slots over, and all of them in one turn.

    One after the other, and abreast in one array.
    """
    draw = np.random.default_rng(3)
    x, y = (jnp.asarray(draw.uniform(0, 2, (2, n))) for n in (75, 50))
    neighbors = list_of(np.asarray(x)) if sets == "one" else list_of(np.asarray(x), np.asarray(y))
    # As full as a list can be: the turn that goes beyond the last slot must not take that one twice.
    neighbors = replace(neighbors, indices=neighbors.indices[: int(neighbors.count.max())])
    assert neighbors.indices.shape[0] % 2 == 1
    # Zero for a particle with itself only where the sum is antisymmetric, so that empty slots have to be left out.
    factor = {None: lambda a, b: a[0] * b[1] ** 2, 1: lambda a, b: a[0] * b[0], -1: lambda a, b: a[1] - b[1]}[sign]

    def loss(x, y, forward_mode=False):
        of_pair = lambda a, b: factor(a, b) / (1 + dot(a - b, a - b))  # noqa: E731
        return weighted(
            pair_sum(of_pair, x, x if sets == "one" else y, neighbors, symmetry=sign, forward_mode=forward_mode)
        )

    def everything(x, y):
        slopes = jax.grad(loss, argnums=(0, 1))
        tangents = [jax.jvp(partial(loss, forward_mode=mode), (x, y), (jnp.cos(x), y))[1] for mode in (False, True)]
        return loss(x, y), slopes(x, y), tangents

    one = jax.jit(everything)(x, y)
    monkeypatch.setattr(slots, "UNROLL_FROM", 1)
    monkeypatch.setattr(slots, "UNROLL", several)
    monkeypatch.setattr(slots, "UNROLL_NARROW", several)
    monkeypatch.setattr(slots, "ABREAST", {np.dtype(np.float64): abreast * 75})
    for got, expected in zip(
        jax.tree.leaves(jax.jit(lambda *both: everything(*both))(x, y)), jax.tree.leaves(one), strict=True
    ):
        # the same terms, abreast in another order; XLA may contract products and sums in another way
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-14 * np.abs(expected).max() * 75)


def test_sums_side_by_side_are_those_of_each_alone():
    """Four numbers in float32 are carried as one: their bits, whatever they are, and their first two derivatives."""
    a, _, neighbors = problem("one", 2, np.float32)

    def of_pair(a, b):
        r = a["x"] - b["x"]
        w = 1 / (1 + dot(r, r) / 0.3**2)
        return {"vector": w * r, "number": b["m"] * w, "five": [w * a["m"] ** k for k in range(5)], "flag": 1}

    together = pair_sum(of_pair, a, a, neighbors)
    for name, found in together.items():
        alone = pair_sum(lambda a, b, name=name: {name: of_pair(a, b)[name]}, a, a, neighbors)[name]
        for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(alone), strict=True):
            # the same terms in the same order; should XLA contract them in another way, a rounding for each of 22
            np.testing.assert_allclose(one, other, rtol=0, atol=22 * 6e-8 * np.abs(other).max())
    assert jnp.issubdtype(together["flag"].dtype, jnp.integer)
    np.testing.assert_array_equal(together["flag"], neighbors.count)

    def loss(a):
        of_real = lambda a, b: {name: out for name, out in of_pair(a, b).items() if name != "flag"}  # noqa: E731
        return weighted(pair_sum(of_real, a, a, neighbors))

    direction = jax.tree.map(jnp.cos, a)
    second = jax.jit(lambda a, v: jax.jvp(jax.grad(loss), (a,), (v,)))
    wide = second(*jax.tree.map(lambda v: v.astype(np.float64), (a, direction)))
    for got, expected in zip(jax.tree.leaves(second(a, direction)), jax.tree.leaves(wide), strict=True):
        # 22 terms, with ten roundings in each
        np.testing.assert_allclose(got, expected, rtol=0, atol=22 * 10 * 6e-8 * np.abs(expected).max())


@pytest.mark.parametrize("x64", [False, True])
def test_numbers_side_by_side_keep_their_bits(x64):
    """Whether types of 64 bits are switched on or not, and also where physics closes over NumPy's."""
    odd = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e-45, -3.4e38, np.pi], np.float32)
    with jax.enable_x64(x64):
        values = [jnp.asarray(np.roll(odd, k)) for k in range(7)]
        both = SideBySide([value.dtype for value in values], differentiable=False)
        assert [len(group) for group in both.groups] == [4, 3]
        with both.types_allowed():
            back = both.apart(both.joined(values))
        for one, other in zip(back, values, strict=True):
            np.testing.assert_array_equal(np.asarray(one).view(np.uint32), np.asarray(other).view(np.uint32))
        a, _, neighbors = problem("one", 2, np.float32)
        of_pair = lambda a, b: [np.float64(k) * b["m"] for k in range(4)]  # noqa: E731
        out = pair_sum(of_pair, a, a, neighbors)
        assert {one.dtype for one in out} == {jnp.promote_types(np.float64 if x64 else np.float32, np.float32)}


def test_only_for_cpus_are_numbers_put_side_by_side(monkeypatch):
    """Other compilers make one pass of several arrays, and some have no types of 128 bits."""
    monkeypatch.setattr(jax, "default_backend", lambda: "tpu")
    both = SideBySide([np.float32] * 5, differentiable=False)
    assert both.groups == [[0], [1], [2], [3], [4]]
    a, _, neighbors = problem("one", 2, np.float32)

    def program(n_sums):
        of_pair = lambda a, b: [(k + 1) * b["m"] for k in range(n_sums)]  # noqa: E731
        return jax.jit(lambda a: pair_sum(of_pair, a, a, neighbors)).lower(a).as_text()

    assert "f64" not in program(5)
    assert program(5).count("stablehlo.gather") == program(1).count("stablehlo.gather") > 0, "nothing twice"


def test_any_number_of_fields():
    a, _, neighbors = problem("one", 2)
    count = np.asarray(neighbors.count)
    np.testing.assert_array_equal(pair_sum(lambda a, b: jnp.ones(()), a["m"], a["m"], neighbors), count)
    many = [a["m"] * k for k in range(12)]
    out = pair_sum(lambda a, b: [p * q for p, q in zip(a, b, strict=True)], many, many, neighbors)
    for k, value in enumerate(out):
        np.testing.assert_allclose(value, k**2 * out[1], rtol=1e-13)  # sums of twenty terms


@pytest.mark.parametrize("symmetry", [None, 1])
def test_empty_slots_never_leak(symmetry):
    """Physics that is huge for a particle with itself, in value and slope, is not noticed."""
    a, _, neighbors = problem("one", 2)
    x = a["x"]

    def of_pair(p, q):
        return p[0] * q[0] / (dot(p - q, p - q) + 1e-30)

    def loss(x):
        return jnp.sum(pair_sum(of_pair, x, x, neighbors, symmetry=symmetry))

    value, slope = jax.jit(jax.value_and_grad(loss))(x)
    x = np.asarray(x)
    r = np.sum((x[:, :, None] - x[:, None, :]) ** 2, axis=0)
    near = (r > 0) & (r <= CUTOFF**2)
    terms = x[0][:, None] * x[0] / np.where(near, r, np.inf)
    assert value == pytest.approx(np.sum(terms), rel=1e-13)  # a sum of some hundred terms
    across = x[1][:, None] - x[1]
    expected = np.sum(-4 * terms * across / np.where(near, r, np.inf), axis=1)
    np.testing.assert_allclose(slope[1], expected, rtol=0, atol=1e-12 * np.abs(expected).max())  # round-off


def test_nobody_near_anybody():
    x = jnp.asarray(np.arange(10.0).reshape(2, 5))
    alone = list_of(np.asarray(x))
    out = pair_sum(lambda a, b: dot(a, b), x, x, alone)
    np.testing.assert_array_equal(out, 0)
    np.testing.assert_array_equal(jax.grad(lambda x: jnp.sum(pair_sum(lambda a, b: dot(a, b), x, x, alone)))(x), 0)


def lean(a, b, length):
    """As `physics`, with less to compile: all fields of both, and the length, in every kind of product."""
    r = a["x"] - b["x"]
    w = 1 / (1 + dot(r, r) / length**2)
    return w * (b["m"] ** 2 * r + apply(a["t"], b["v"]) + a["m"] * apply(b["t"], a["v"]))


@pytest.fixture(scope="module", params=["one", "two"], ids=lambda sets: f"{sets} set")
def loss_of(request):
    """loss(everything, forward_mode) of all fields and of a number that the physics closes over."""
    sets = request.param
    a, b, neighbors = problem(sets, 3 if sets == "one" else 2)
    everything = {"a": a, "length": jnp.asarray(0.3)} | ({} if sets == "one" else {"b": b})

    def loss(x, forward_mode=False):
        closed = partial(lean, length=x["length"])
        return weighted(pair_sum(closed, x["a"], x.get("b", x["a"]), neighbors, forward_mode=forward_mode))

    return loss, everything


@pytest.fixture(scope="module")
def derivatives(loss_of):
    """Gradient and Hessian-vector product (forward over reverse mode), by the rule and by JAX through the loop."""
    loss, x = loss_of
    direction = jax.tree.map(lambda v: jnp.cos(jnp.arange(v.size * 1.0)).reshape(v.shape), x)

    @jax.jit
    def of(x):
        return [jax.jvp(jax.grad(partial(loss, forward_mode=mode)), (x,), (direction,)) for mode in (False, True)]

    return direction, *of(x)


def test_gradient_and_hessian_are_those_of_the_loop(derivatives):
    _, by_rule, by_loop = derivatives
    for got, expected in zip(jax.tree.leaves(by_rule), jax.tree.leaves(by_loop), strict=True):
        # the same terms added in another order
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_derivatives_are_those_of_finite_differences(loss_of, derivatives):
    loss, x = loss_of
    direction, (gradient, product), _ = derivatives

    def along(tree):
        return sum(float(np.vdot(g, v)) for g, v in zip(jax.tree.leaves(tree), jax.tree.leaves(direction), strict=True))

    for forward_mode in (False, True):
        forward = jax.jit(lambda x, m=forward_mode: jax.jvp(partial(loss, forward_mode=m), (x,), (direction,))[1])(x)
        scale = sum(np.sum(np.abs(leaf)) for leaf in jax.tree.leaves(gradient))
        assert forward == pytest.approx(along(gradient), abs=1e-14 * scale), "the transpose of the tangent"

    compiled = jax.jit(loss)
    at = lambda step: compiled(jax.tree.map(lambda v, e: v + step * e, x, direction))  # noqa: E731
    slope = lambda h: (at(h) - at(-h)) / (2 * h)  # noqa: E731
    bend = lambda h: (at(h) - 2 * at(0.0) + at(-h)) / h**2  # noqa: E731
    # Central differences, extrapolated: h^4 = 1e-14 times the fifth derivative (lengths of .3: some 1e5 slopes)
    # remains of the truncation, and 1e-15 / h of the rounding; of the second derivative 1e-15 / h^2.
    h = 3e-4
    assert (4 * slope(h / 2) - slope(h)) / 3 == pytest.approx(along(gradient), rel=1e-7)
    h = 3e-3
    assert (4 * bend(h / 2) - bend(h)) / 3 == pytest.approx(along(product), rel=1e-5)


def test_batches_of_gradients(loss_of):
    loss, x = loss_of
    gradient = jax.jit(jax.grad(loss))
    many = jax.tree.map(lambda v: jnp.stack([v, 1.01 * v, 0.99 * v]), x)
    together = jax.jit(jax.vmap(jax.grad(loss)))(many)
    for i in range(3):
        alone = gradient(jax.tree.map(lambda v, i=i: v[i], many))
        for got, expected in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            # the same operations, vectorized in another way
            np.testing.assert_allclose(got[i], expected, rtol=0, atol=1e-13 * np.abs(expected).max())


def test_reverse_mode_does_not_scatter(loss_of):
    loss, x = loss_of
    lowered = lambda f: jax.jit(f).lower(x).as_text()  # noqa: E731
    assert "scatter" not in lowered(jax.grad(loss))
    assert "scatter" not in lowered(jax.vmap(jax.grad(loss), axis_size=1, in_axes=None))
    assert "scatter" in lowered(jax.grad(lambda x: loss(x, True))), "the loop differentiated by JAX scatters"


def test_nothing_of_the_size_of_all_pairs_is_stored(loss_of):
    """No array in the gradient has a slot axis beside a particle axis, but the lists themselves."""
    loss, x = loss_of
    text = jax.jit(jax.grad(loss)).lower(x).as_text()
    slots = {f"{k}x{n}x{kind}>" for k in range(5, 40) for n in (40, 25) for kind in ("f64", "f32")}
    assert not [shape for shape in slots if f"x{shape}" in text or f"<{shape}" in text]


def test_gradient_of_float32_is_float32_and_close():
    a, _, neighbors = problem("one", 2, np.float32)
    of_pair = partial(lean, length=np.float32(0.3))
    gradient = jax.jit(jax.grad(lambda a: weighted(pair_sum(of_pair, a, a, neighbors))))
    single = gradient(a)
    exact = gradient(jax.tree.map(lambda v: v.astype(np.float64), a))
    for got, expected in zip(jax.tree.leaves(single), jax.tree.leaves(exact), strict=True):
        assert got.dtype == np.float32
        # sums of some twenty terms with ten roundings of 6e-8 each
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_integer_fields_and_closures_over_traced_integers():
    """Kinds of particles, as fields and as numbers that the physics closes over."""
    a, _, neighbors = problem("one", 2)
    kinds = jnp.arange(40, dtype=jnp.int32) % 3

    @partial(jax.jit, static_argnums=2)
    def gradient(m, wanted, forward_mode):
        def of_pair(a, b):
            return jnp.where((a["kind"] != b["kind"]) & (b["kind"] == wanted), a["m"] * b["m"] ** 2, 0.0)

        def loss(m):
            filled = {"m": m, "kind": kinds}
            return weighted(pair_sum(of_pair, filled, filled, neighbors, forward_mode=forward_mode))

        return jax.grad(loss)(m)

    expected = gradient(a["m"], 1, True)
    np.testing.assert_allclose(gradient(a["m"], 1, False), expected, atol=1e-13 * np.abs(expected).max())  # round-off


def test_edges_are_the_geometry_of_each_pair():
    a, _, neighbors = problem("one", 2)
    geometry = lambda p, q: {"r": p["x"] - q["x"], "m": p["m"] * q["m"] ** 2}  # noqa: E731
    edges = pair_edges(geometry, a, neighbors)

    def with_edges(m, forward_mode=False):
        of_pair = lambda p, q, edge: p**2 * q * edge["m"] * edge["r"]  # noqa: E731
        return pair_sum(of_pair, m, m, neighbors, edges, forward_mode=forward_mode)

    def without(m):
        of_pair = lambda p, q: p["v"] ** 2 * q["v"] * p["m"] * q["m"] ** 2 * (p["x"] - q["x"])  # noqa: E731
        return pair_sum(of_pair, a | {"v": m}, a | {"v": m}, neighbors)

    m = jnp.cos(jnp.arange(40.0))
    for f in (lambda g: g, lambda g: jax.grad(lambda m: weighted(g(m)))):
        expected, got = (jax.jit(f(g))(m) for g in (without, with_edges))
        np.testing.assert_allclose(got, expected, atol=1e-13 * np.abs(expected).max())  # round-off
    empty = np.arange(neighbors.indices.shape[0])[:, None] >= np.asarray(neighbors.count)
    for leaf in jax.tree.leaves(edges):
        np.testing.assert_array_equal(np.asarray(leaf)[..., empty], 0)


def test_edges_are_differentiated():
    """Geometry from traced positions and a traced length: the gradient through edges is that without them."""
    a, _, neighbors = problem("one", 2)

    def with_edges(x, length, forward_mode):
        kernel = lambda p, q: jnp.exp(-dot(p - q, p - q) / length**2) * (p - q) * p[0]  # noqa: E731
        edges = pair_edges(kernel, x, neighbors)
        of_pair = lambda p, q, e: p * q**2 * e  # noqa: E731
        return pair_sum(of_pair, a["m"], a["m"], neighbors, edges, forward_mode=forward_mode)

    def gradient(forward_mode):
        of = lambda x, length: weighted(with_edges(x, length, forward_mode))  # noqa: E731
        return jax.jit(jax.grad(of, argnums=(0, 1)))(a["x"], 0.3)

    for got, expected in zip(gradient(False), gradient(True), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-13 * np.abs(expected).max())  # round-off


def attraction(p, q):
    r = p["x"] - q["x"]
    return (p["m"] * q["m"] * (p["t"][0, 0] + q["t"][0, 0])) * r * jnp.exp(-dot(r, r))


def closeness(p, q):
    r = p["x"] - q["x"]
    return {"apart": r * (p["m"] + q["m"]), "near": p["m"] * q["m"] * jnp.exp(-dot(r, r)) + p["m"] + q["m"]}


SYMMETRIES = [(attraction, -1), (closeness, {"apart": -1, "near": 1})]


@pytest.mark.parametrize(("of_pair", "symmetry"), SYMMETRIES, ids=["antisymmetric", "both kinds"])
def test_stated_symmetry_changes_nothing_but_the_cost(of_pair, symmetry):
    a, _, neighbors = problem("one", 2)

    @partial(jax.jit, static_argnums=2)
    def everything(a, strength, stated):
        def loss(a, strength):
            stronger = lambda p, q: jax.tree.map(lambda value: strength * value, of_pair(p, q))  # noqa: E731
            return weighted(pair_sum(stronger, a, a, neighbors, symmetry=symmetry if stated else None))

        change = jax.jvp(loss, (a, strength), jax.tree.map(jnp.cos, (a, strength)))
        return change, jax.grad(loss, argnums=(0, 1))(a, strength)

    pairs = zip(*(jax.tree.leaves(everything(a, 1.3, stated)) for stated in (True, False)), strict=True)
    for got, expected in pairs:
        # the same terms added in another order
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    some, others = (jax.tree.map(lambda v, part=part: v[..., part], a) for part in (slice(0, 20), slice(20, 40)))
    assert symmetry_error(of_pair, some, others, symmetry) < 1e-15, "exact but for the rounding of a sum"
    assert symmetry_error(of_pair, some, others, 1) > 0.1


def test_symmetry_is_refused_where_it_means_nothing():
    a, b, neighbors = problem("two", 2)
    with pytest.raises(ValueError, match="edges and symmetry belong to pairs of one set"):
        pair_sum(attraction, a, b, neighbors, symmetry=-1)
    a, _, neighbors = problem("one", 2)
    with pytest.raises(ValueError, match="symmetry is 2; it must be made of"):
        pair_sum(attraction, a, a, neighbors, symmetry=2)
    with pytest.raises(ValueError, match="pass the same object"):
        pair_sum(attraction, a, dict(a), neighbors, symmetry=-1)


@in_2d_and_3d
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_antisymmetric_pairs_conserve_linear_momentum(d, kind):
    a, _, neighbors = problem("one", d, kind)

    forces = np.asarray(jax.jit(lambda a: pair_sum(attraction, a, a, neighbors))(a))
    assert np.abs(forces).max() > 1
    # a rounding for each of the 40 x 20 terms, at most as large as the sum of their sizes
    assert np.abs(forces.sum(axis=1)).max() < np.finfo(kind).eps * np.abs(forces).sum() * 4


@pytest.mark.parametrize(
    ("receivers", "senders", "said"),
    [
        ({"m": (39,)}, {"m": (40,)}, r"receiver field \['m'\] has shape \(39,\).* the 40 receivers"),
        ({"x": (40, 2)}, {"x": (2, 40)}, r"receiver field \['x'\] has shape \(40, 2\).*component first, particle last"),
        ({"m": ()}, {"m": (40,)}, r"shape \(\)"),
        ({"m": (40,)}, {"m": (41,)}, r"sender field \['m'\] has shape \(41,\).* the 40 senders"),
    ],
)
def test_wrong_lengths_are_refused(receivers, senders, said):
    _, _, neighbors = problem("one", 2)
    a, b = ({k: jnp.zeros(shape) for k, shape in f.items()} for f in (receivers, senders))
    with pytest.raises(ValueError, match=said):
        pair_sum(lambda a, b: jnp.zeros(()), a, b, neighbors)


def test_wrong_lengths_of_two_sets_and_their_edges_are_refused():
    a, b, neighbors = problem("two", 2)
    with pytest.raises(ValueError, match=r"sender field .* shape \(40,\).* the 25 senders"):
        pair_sum(lambda p, q: p * q, a["m"], a["m"], neighbors)
    edges = pair_edges(lambda p, q: p * q, a["m"], PairList(neighbors.indices, neighbors.count))
    with pytest.raises(ValueError, match="edges and symmetry belong to pairs of one set"):
        pair_sum(lambda p, q, e: p * q * e, a["m"], b["m"], neighbors, edges)


def test_dot_and_apply():
    a, b = jnp.array([1.0, 2.0, 3.0]), jnp.array([4.0, 5.0, 6.0])
    assert dot(a, b) == 32
    np.testing.assert_array_equal(apply(jnp.arange(9.0).reshape(3, 3), a), [8, 26, 44])
