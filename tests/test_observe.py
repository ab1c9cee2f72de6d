"""What is observed of a state is what mechanics says of it."""

import jax
import numpy as np
import pytest
from bodies import block

import jaxsph as sph
from jaxsph import pytree
from jaxsph.materials.elastic import cauchy_stress, lame_parameters

in_2d_and_3d = pytest.mark.parametrize("d", [2, 3])
observed = jax.jit(sph.observe.stresses, static_argnames="name")


def with_fields(scene, **fields):
    state = sph.initial_state(scene)
    return pytree.replace(state, systems={"block": {**state.systems["block"], **fields}})


def affine(d):
    return np.eye(d) + 0.2 * np.random.default_rng(d).uniform(-1, 1, (d, d))


@in_2d_and_3d
@pytest.mark.parametrize("law", [sph.StVenantKirchhoff(), sph.NeoHookean()], ids=lambda law: type(law).__name__)
def test_stresses_of_an_affine_deformation(d, law):
    scene = sph.Scene(block(d, law=law))
    matrix = affine(d)
    state = with_fields(scene, displacement=scene["block"].particles.positions @ (matrix - np.eye(d)).T)
    out = observed(scene, state, "block", sph.topologies(scene))
    lam, mu = lame_parameters(1e6, 0.3)
    pk1 = np.asarray(law.stress(matrix - np.eye(d), lam, mu))
    n = scene["block"].n_particles
    for name, expected in {
        "deformation_gradient": matrix,
        "pk1": pk1,
        "cauchy": np.asarray(cauchy_stress(matrix - np.eye(d), pk1)),
    }.items():
        assert out[name].shape == (n, d, d)
        # exact but for the hundred roundings of the patch test, in units of the modulus
        scale = 1 if name == "deformation_gradient" else 1e6
        np.testing.assert_allclose(out[name], np.broadcast_to(expected, (n, d, d)), rtol=0, atol=1e-12 * scale)
    assert out["von_mises"].shape == (n,) and np.ptp(out["von_mises"]) < 1e-12 * 1e6


@in_2d_and_3d
def test_energies(d):
    gravity = np.arange(1.0, d + 1)
    scene = sph.Scene(block(d), gravity=gravity)
    particles, law = scene["block"].particles, scene["block"].law
    volume = particles.volumes.sum()
    matrix, speed = affine(d), np.array([3.0, -2.0, 1.0])[:d]
    displacement = particles.positions @ (matrix - np.eye(d)).T
    state = with_fields(scene, displacement=displacement, velocity=np.broadcast_to(speed, displacement.shape))
    out = {k: float(v) for k, v in jax.jit(sph.observe.energies)(scene, state, sph.topologies(scene)).items()}
    stored = float(law.energy_density(matrix - np.eye(d), *lame_parameters(1e6, 0.3)))
    # sums over some tens of particles
    assert out["kinetic"] == pytest.approx(0.5 * 1000 * volume * speed @ speed, rel=1e-12)
    assert out["elastic"] == pytest.approx(volume * stored, rel=1e-11)
    assert out["gravitational"] == pytest.approx(-1000 * gravity @ (particles.volumes @ displacement), rel=1e-12)
    assert out["total"] == pytest.approx(out["kinetic"] + out["elastic"] + out["gravitational"], rel=1e-14)
    momentum = sph.observe.linear_momentum(scene, state)
    np.testing.assert_allclose(momentum, 1000 * volume * speed, rtol=1e-12)


def test_clamped_particles_have_no_kinetic_energy():
    body = block(2, clamped=lambda x: x[:, 0] < 0)
    scene = sph.Scene(body)
    state = with_fields(scene, velocity=np.ones_like(body.particles.positions))
    moving = 1000 * body.particles.volumes[~body.clamped].sum()
    energies = jax.jit(sph.observe.energies)(scene, state, sph.topologies(scene))
    assert energies["kinetic"] == pytest.approx(moving, rel=1e-12)  # v^2 = 2; a sum of some tens of numbers
