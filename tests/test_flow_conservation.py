"""What the sums of a fluid conserve and leave alone, and whether the symmetries that they state are true."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fluids import periodic, stirred, sums

import jaxsph as sph


def test_angular_momentum_is_conserved_without_viscosity():
    """Pressure and artificial viscosity act along the line of a pair; in a free domain that leaves no torque."""
    scene = periodic(effects=[sph.ArtificialViscosity(0.3)], periodic=False).replace({"water.viscosity": 0.0})
    state = stirred(scene)
    acceleration = sums(scene, sph.topologies(scene), state.systems)["water"]["acceleration"]
    force, x = np.asarray(scene["water"].mass() * acceleration), np.asarray(state.systems["water"]["position"])
    torque = x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0]
    assert abs(torque.sum()) < 1e-13 * np.abs(torque).sum()


def test_a_uniform_velocity_changes_no_density_and_brings_no_friction():
    scene = periodic(two=True, effects=[sph.ArtificialViscosity(0.3)])
    state, found = stirred(scene), sph.topologies(scene)

    def moving(velocity):
        return {name: {**f, "velocity": jnp.zeros_like(f["velocity"]) + velocity} for name, f in state.systems.items()}

    there, still = (sums(scene, found, moving(jnp.array(v))) for v in ((3.0, -2.0), (0.0, 0.0)))
    for name in ("water", "oil"):
        np.testing.assert_array_equal(there[name]["rate"], 0)
        np.testing.assert_array_equal(there[name]["acceleration"], still[name]["acceleration"])


@pytest.mark.parametrize("diffusion", [sph.DensityDiffusion(0.1), sph.DeltaDiffusion(0.1)])
def test_two_fluids_without_pressure_stay_as_they_are(diffusion):
    """The jump of the rest density is no noise: nothing may diffuse or be carried across."""
    scene = periodic(two=True, effects=[diffusion, sph.ParticleShifting()])
    state = stirred(scene, speed=0.0, spread=0.0)
    out = sums(scene, sph.topologies(scene), state.systems)
    for name in ("water", "oil"):
        np.testing.assert_array_equal(out[name]["rate"], 0)
        np.testing.assert_array_equal(out[name]["acceleration"], 0)
        np.testing.assert_array_equal(out[name].get("density_gradient", 0.0), 0)


def test_forces_from_outside():
    scene = periodic(effects=[sph.BodyForce(lambda x, t: t * x), sph.BodyForce(lambda x, t: jnp.array([[1.0], [2.0]]))])
    scene = scene.replace({"gravity": (0.5, -3.0)})
    state = stirred(scene, speed=0.0, spread=0.0)
    out = sums(scene, sph.topologies(scene), state.systems, 2.0)["water"]
    expected = 2 * scene["water"].particles.positions + [1.5, -1.0]
    np.testing.assert_allclose(out["acceleration"], expected, atol=1e-14)  # a few roundings


@pytest.mark.parametrize("diffusion", [sph.DensityDiffusion(0.1), sph.DeltaDiffusion(0.1)])
def test_stated_symmetries_are_true(diffusion):
    """Reverse mode uses them, the tangent of the loop itself does not: <c, J t> = <J^T c, t> for every sum."""
    effects = [
        sph.ArtificialViscosity(0.2, 0.5),
        diffusion,
        sph.ParticleShifting(2.0, 0.3, free_surface=True),
    ]
    scene = periodic(effects=effects, periodic=False)
    found, systems = sph.topologies(scene), stirred(scene).systems
    rng = np.random.default_rng(1)
    tangent = jax.tree.map(lambda leaf: jnp.asarray(rng.standard_normal(leaf.shape)), systems)
    _, forward = jax.jvp(lambda s: sums(scene, found, s, forward_mode=True), (systems,), (tangent,))
    _, pull = jax.vjp(lambda s: sums(scene, found, s), systems)
    pull = jax.jit(pull)
    fields = forward["water"]
    gradient = {"density_gradient"} if isinstance(diffusion, sph.DeltaDiffusion) else set()
    assert set(fields) == {"rate", "acceleration", "shift"} | gradient
    for field, slope in fields.items():
        probe = jnp.asarray(rng.standard_normal(slope.shape))
        (back,) = pull({"water": {**jax.tree.map(jnp.zeros_like, fields), field: probe}})
        got = sum(float(jnp.sum(b * t)) for b, t in zip(jax.tree.leaves(back), jax.tree.leaves(tangent), strict=True))
        # both are sums of thousands of terms of either sign, rounded to 2e-16 of the largest
        scale = float(jnp.sqrt(jnp.sum(probe**2) * jnp.sum(slope**2)))
        assert abs(got - jnp.sum(probe * slope)) < 1e-12 * scale, field
