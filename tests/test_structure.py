"""Total-Lagrangian SPH: patch tests on disordered particles, forces as gradients of the energy, conservation."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import SPACING, block, in_columns, in_rows, with_particles
from scipy.spatial.transform import Rotation

import jaxsph as sph
from jaxsph.elastic_forces import displacement_gradient, elastic_acceleration
from jaxsph.structure import reference, topology

in_2d_and_3d = pytest.mark.parametrize("d", [2, 3])
# Rounding of about 1e-16 and 6e-8, times the hundred or so by which the sums over neighbors amplify it: the
# displacements of a block of six spacings over one spacing, and the correction matrices of disordered particles.
in_both_precisions = pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1e-12), (np.float32, 1e-5)])


@partial(jax.jit, static_argnames="penalty")
def prepared(structure, found, penalty=False):
    return reference(structure, found, penalty=penalty)


@jax.jit
def gradient_and_stress(structure, ready, displacement):
    gradient = displacement_gradient(ready, displacement)
    return gradient, structure.law.stress(gradient, ready.uniform["lam"], ready.uniform["mu"])


@jax.jit
def acceleration(structure, ready, displacement, penalty=None):
    return elastic_acceleration(structure, ready, displacement, penalty)


def deformed(structure, matrix):
    """Displacements (N, d) of x = matrix X."""
    exact = np.asarray(structure.particles.positions, np.float64)
    return (exact @ (matrix - np.eye(len(matrix))).T).astype(structure.dtype)


@in_2d_and_3d
@in_both_precisions
def test_affine_deformation_is_exact(d, kind, tolerance):
    body = block(d, kind)
    found = topology(body)
    ready = prepared(body, found)
    for seed in range(3):
        matrix = np.eye(d) + 0.5 * np.random.default_rng(seed).uniform(-1, 1, (d, d))
        gradient, _ = gradient_and_stress(body, ready, in_columns(deformed(body, matrix), found))
        assert gradient.dtype == kind
        error = np.abs(gradient - (matrix - np.eye(d))[:, :, None]).max()
        assert error <= tolerance * np.abs(matrix - np.eye(d)).max()


@in_2d_and_3d
@in_both_precisions
def test_rotation_makes_no_stress(d, kind, tolerance):
    body = block(d, kind)
    found = topology(body)
    ready = prepared(body, found)
    for degrees in (1, 10, 45, 90, 135, 180):
        axis = np.array([0.0, 0.0, 1.0]) if d == 2 else np.array([2.0, -1.0, 3.0]) / 14**0.5
        matrix = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()[:d, :d]
        _, stress = gradient_and_stress(body, ready, in_columns(deformed(body, matrix), found))
        assert np.abs(stress).max() <= tolerance * 1e6, f"{degrees} degrees"


@in_2d_and_3d
def test_particles_of_other_volumes_pass_the_patch_test_too(d):
    """Half and quarter cells at the surface change the weights, not the exactness."""
    body = block(d, on_surface=True, disorder=0.1)
    found = topology(body)
    matrix = np.eye(d) + 0.3 * np.random.default_rng(1).uniform(-1, 1, (d, d))
    gradient, _ = gradient_and_stress(body, prepared(body, found), in_columns(deformed(body, matrix), found))
    assert np.abs(gradient - (matrix - np.eye(d))[:, :, None]).max() <= 1e-12  # a hundred roundings


def free_displacement(body, size, seed=0):
    return size * SPACING * np.random.default_rng(seed).uniform(-1, 1, body.particles.positions.shape)


SVK, NEO_HOOKEAN = sph.StVenantKirchhoff(), sph.NeoHookean()


@pytest.mark.parametrize(
    ("d", "law", "varied"),
    [(2, SVK, False), (2, SVK, True), (2, NEO_HOOKEAN, True), (3, SVK, True), (3, NEO_HOOKEAN, False)],
    ids=["SvK 2D", "SvK 2D varied", "neo-Hookean 2D varied", "SvK 3D varied", "neo-Hookean 3D"],
)
def test_force_is_minus_the_gradient_of_the_energy(d, law, varied):
    """Mass times acceleration is -dE/du, with E the sum of V times the stored energy: nothing is lost or made.

    Also where density and moduli change from particle to particle.
    """
    changes: dict[str, Any] = {}
    if varied:
        draw = np.random.default_rng(3)
        n = block(d).n_particles
        changes = {
            "density": draw.uniform(500, 2000, n),
            "youngs_modulus": draw.uniform(5e5, 2e6, n),
            "poisson_ratio": draw.uniform(0, 0.4, n),
        }
    body = block(d, law=law, **changes)
    found = topology(body)
    ready = prepared(body, found)
    material = {**ready.uniform, **ready.varying}

    @jax.jit
    def force_of_energy(displacement):
        def energy(u):
            density = law.energy_density(displacement_gradient(ready, u), material["lam"], material["mu"])
            return jnp.sum(ready.volume * density)

        return -jax.grad(energy)(displacement)

    u = in_columns(free_displacement(body, 0.1), found)
    force = material["density"] * ready.volume * acceleration(body, ready, u)
    expected = force_of_energy(u)
    # the same sum over pairs, in another order
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(("d", "kind", "tolerance"), [(2, np.float32, 1e-5), (3, np.float64, 1e-12)])
def test_penalty_force_vanishes_for_affine_deformation(d, kind, tolerance):
    """What is left is rounding: of positions over a spacing, as above."""
    body, penalty = block(d, kind), sph.PenaltyForce(0.1)
    found = topology(body)
    ready = prepared(body, found, penalty=True)
    matrix = np.eye(d) + 0.3 * np.random.default_rng(1).uniform(-1, 1, (d, d))

    def of_penalty(u):
        u = in_columns(np.asarray(u, kind), found)
        return np.abs(acceleration(body, ready, u, penalty) - acceleration(body, ready, u)).max()

    assert of_penalty(deformed(body, matrix)) <= tolerance * of_penalty(free_displacement(body, 1.0))


def test_penalty_force_opposes_what_the_stress_does_not_see():
    """Displacements that alternate from particle to particle have no gradient inside, and no stress."""
    body, penalty = block(2, disorder=0.0, smoothing_length=None), sph.PenaltyForce(0.1)
    found = topology(body)
    ready = prepared(body, found, penalty=True)
    x = body.particles.positions
    sign = (-1.0) ** np.sum(np.round((x - x.min(axis=0)) / SPACING), axis=1)
    u = 1e-3 * SPACING * sign[:, None] * np.array([1.0, 0.5])
    inside = np.all(np.abs(x) < 0.3 - 1.9 * SPACING, axis=1)
    assert inside.sum() == 4, "two spacings from the surface"
    columns = in_columns(u, found)
    gradient, _ = gradient_and_stress(body, ready, columns)
    gradient = in_rows(gradient, found)
    inner = np.all(np.abs(x) < 0.3 - 0.9 * SPACING, axis=1)
    assert np.abs(gradient[inner]).max() < 1e-16 * 100, "a hundred roundings of a displacement of 1e-3 spacings"
    elastic = in_rows(acceleration(body, ready, columns), found)
    total = in_rows(acceleration(body, ready, columns, penalty), found)
    force = total - elastic
    assert np.all(np.sum(force[inside] * u[inside], axis=1) < 0)
    assert np.sum(force * u) < 0, "and takes energy as a whole"
    # A third of the stiffness that the same displacement would meet from the modulus, to an order of magnitude
    size = np.linalg.norm(force[inside], axis=1) / np.linalg.norm(u[inside], axis=1)
    assert np.all(size > 0.01 * 0.1 * 1e6 / 1000 / SPACING**2)


@in_2d_and_3d
def test_penalty_force_is_as_stiff_in_a_torn_body_as_in_one_at_rest(d):
    """It is linear in the displacements, whatever they are; two particles may even be at the same place."""
    body, penalty = block(d), sph.PenaltyForce(0.1)
    found = topology(body)
    ready = prepared(body, found, penalty=True)

    def of_penalty(u):
        elastic, total = acceleration(body, ready, u), acceleration(body, ready, u, penalty)
        return np.asarray(total - elastic), np.abs(elastic).max()

    torn = np.array(free_displacement(body, 1.0))
    x = np.asarray(body.particles.positions)
    torn[1] = x[0] + torn[0] - x[1]
    torn, small = in_columns(torn, found), in_columns(free_displacement(body, 1e-3), found)
    (alone, _), (base, size), (both, _) = of_penalty(small), of_penalty(torn), of_penalty(torn + small)
    # 1e-14: the rounding of the elastic force, which is taken away, with some tens of neighbors
    assert np.abs(both - base - alone).max() < 1e-14 * size < 1e-3 * np.abs(alone).max()


@in_2d_and_3d
def test_forces_conserve_linear_and_angular_momentum(d):
    """Pairs are antisymmetric, and no energy sees rotations."""
    body = block(d, youngs_modulus=np.random.default_rng(0).uniform(5e5, 2e6, block(d).n_particles))
    found = topology(body)
    ready = prepared(body, found, penalty=True)
    u = in_columns(free_displacement(body, 0.2), found)
    mass = np.asarray(1000.0 * ready.volume)
    place = np.asarray(ready.positions + u)
    for penalty in (None, sph.PenaltyForce(0.1)) if d == 2 else (sph.PenaltyForce(0.1),):
        force = mass * np.asarray(acceleration(body, ready, u, penalty))
        sizes = np.abs(force).sum()
        assert np.abs(force.sum(axis=1)).max() < 1e-14 * sizes, "a rounding for each pair"
        torque = np.einsum("in,jn->ij", place, force)
        assert np.abs(torque - torque.T).max() < 1e-13 * sizes * np.abs(place).max(), "ten roundings for each pair"


def test_user_order_does_not_matter():
    body = block(2)
    order = np.random.default_rng(5).permutation(body.n_particles)
    particles = body.particles
    shuffled = with_particles(body, positions=particles.positions[order], volumes=particles.volumes[order])
    u = free_displacement(body, 0.2)
    out = []
    for one, displacement in ((body, u), (shuffled, u[order])):
        found = topology(one)
        ready = prepared(one, found)
        out.append(in_rows(acceleration(one, ready, in_columns(displacement, found)), found))
    # the same sums in another order
    np.testing.assert_allclose(out[1], out[0][order], rtol=0, atol=1e-12 * np.abs(out[0]).max())


@in_2d_and_3d
def test_topology_holds_all_pairs_within_the_support(d):
    body = block(d)
    found = topology(body)
    x = np.asarray(body.particles.positions)
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    near = (distance < 2 * 1.3 * SPACING) & (distance > 0)
    np.testing.assert_array_equal(found.order[found.rank], np.arange(len(x)))
    for a in range(len(x)):
        place = found.rank[a]
        count = found.neighbors.count[place]
        neighbors = found.order[found.neighbors.indices[:count, place]]
        assert sorted(neighbors) == sorted(np.flatnonzero(near[a]))
        assert np.all(found.neighbors.indices[count:, place] == place), "empty slots hold the own index"


BOX = sph.box((0, 0), (0.4, 0.2), 0.1)
ABOUT: dict[str, Any] = {"density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"density": -1.0}, r"density = -1\.0 must be positive and finite \[kg/m\^3\]"),
        ({"density": np.array([1.0] * 7 + [0.0])}, r"density = 0\.0 \(at index \(7,\)\) must be positive"),
        ({"density": np.ones(3)}, r"density has shape \(3,\); it must be one number or \(8,\)"),
        ({"youngs_modulus": 0.0}, r"youngs_modulus = 0\.0 must be positive and finite \[Pa\]"),
        ({"youngs_modulus": float("inf")}, "youngs_modulus = inf must be positive and finite"),
        ({"poisson_ratio": 0.5}, r"poisson_ratio = 0\.5 must lie between -1 and 0\.5"),
        ({"poisson_ratio": -1.0}, r"poisson_ratio = -1\.0 must lie between -1 and 0\.5"),
        ({"poisson_ratio": float("nan")}, "poisson_ratio = nan must lie between"),
        ({"clamped": np.zeros(5, bool)}, r"clamped has shape \(5,\) .* must be \(8,\) booleans"),
        ({"clamped": lambda x: x[:, 0]}, r"type float64; it must be \(8,\) booleans"),
        ({"velocity": (1.0, 0.0, 0.0)}, r"velocity has shape \(3,\); it must be \(2,\) or \(8, 2\)"),
        ({"velocity": (np.nan, 0.0)}, "velocity holds values that are not finite"),
        ({"smoothing_length": 0.0}, r"smoothing_length = 0\.0 must be positive and finite \[m\]"),
        ({"name": "my plate"}, "name 'my plate' must be a word"),
        ({"name": ""}, "name '' must be a word"),
    ],
)
def test_what_does_not_fit_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        sph.Structure(**{"name": "plate", "particles": BOX, **ABOUT, **changes})


@pytest.mark.parametrize(
    ("particles", "changes", "said"),
    [
        (
            sph.box((0, 0), (1.0, 0.1), 0.1),
            {},
            r"has \d neighbors, which do not span 2 dimensions.*two particles thick",
        ),
        (sph.box((0, 0, 0), (0.4, 0.4, 0.1), 0.1), {}, "do not span 3 dimensions"),
        (sph.box((0, 0), (0.4, 0.4), 0.1), {"smoothing_length": 0.04}, r"smoothing length \(0\.04 m\) larger"),
        (BOX | BOX.where(np.arange(8) == 3), {}, "particles (3 and 8|8 and 3) of 'plate' are at the same place"),
    ],
    ids=["a line", "a sheet", "too short a smoothing length", "coincident"],
)
def test_neighborhoods_that_do_not_work_are_refused(particles, changes, said):
    with pytest.raises(ValueError, match=said):
        topology(sph.Structure("plate", particles, **{**ABOUT, **changes}))


def deflection(body, limit):
    """Tip of a beam of 1 m x .1 m under gravity, Poisson ratio 0, over Timoshenko's; clamped where x < limit."""
    beam = sph.Structure("beam", body, 1000.0, 1e7, 0.0, clamped=lambda x: x[:, 0] < limit)
    ready = prepared(beam, topology(beam), penalty=True)
    n = ready.positions.shape[1]
    force = lambda u: acceleration(beam, ready, u.reshape(2, n), sph.PenaltyForce(0.05)).ravel()  # noqa: E731
    free = np.tile(np.asarray(ready.moving) > 0, 2)
    stiffness = np.asarray(jax.jit(jax.jacfwd(force))(jnp.zeros(2 * n)))[np.ix_(free, free)]
    u = np.zeros(2 * n)
    u[free] = np.linalg.solve(stiffness, np.repeat([0.0, 9.81], n)[free])
    x, y = np.asarray(ready.positions)
    tip = u[n:][(x > 1 - 1e-6) & (np.abs(y) < 1e-6)]
    # bending p L^4 / (8 E I) and shear p L^2 / (2 k G t), with k = 5/6 and G = E / 2
    return float(tip[0]) / (-9810 * 0.1 * (1 / (8 * 1e7 * 0.1**3 / 12) + 1 / (2 * 5 / 6 * 5e6 * 0.1)))


def test_a_clamped_strip_bends_as_far_as_it_should_and_with_its_column_in_the_face_too_far():
    strip = sph.clamped_strip(1.0, 0.1, 9)
    dx = strip.spacing
    in_face = sph.box((-3 * dx, -0.05), (1 + 3 * dx, 0.1), dx, on_surface=True)
    right, wrong = deflection(strip, dx), deflection(in_face, 0.01 * dx)
    print(right, wrong)
    # Timoshenko's clamp lets the section warp, which is of order (t / L)^2 = 1 % of the deflection
    assert abs(right - 1) < 0.006
    # half a spacing more of the length, (1 + dx / 2 L)^4 - 1 of the bending; shear, 1.5 % of all, goes with its square
    assert wrong - right == pytest.approx(2 * dx, rel=0.05)
