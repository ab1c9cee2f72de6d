"""Gradients through a hundred steps with the schemes of tests/test_schemes.py: both modes, finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_flow_gradients import Case, check, column, vortex

import jaxsph as sph

VORTICES = {
    "edac": (sph.EDAC(), [sph.TransportVelocity()]),
    "damped": (sph.ContinuityDensity(), [sph.AcousticDamper(0.5), sph.DeltaDiffusion(0.1)]),
    "corrected": (sph.ContinuityDensity(), [sph.KernelGradientCorrection(), sph.ParticleShifting(1.0, 0.2)]),
    "edac averaged": (sph.EDAC(averaged_pressure=True), [sph.ParticleShifting(1.0, 0.2)]),
}

SLOW = {"edac averaged", "corrected"}


@pytest.mark.parametrize("which", [pytest.param(w, marks=pytest.mark.slow) if w in SLOW else w for w in VORTICES])
def test_vortex(which):
    check(Case(vortex(*VORTICES[which])))


@pytest.mark.slow
def test_edac_column_in_a_tank():
    check(Case(column(sph.EDAC(free_surface=True), [])))


@pytest.mark.slow
def test_column_that_walls_repel():
    """Of particles with a jitter of a tenth of a spacing some are closer to the wall's than a spacing."""
    check(Case(column(sph.ContinuityDensity(), [sph.DeltaDiffusion(0.1), sph.WallRepulsion(0.5)])))


@pytest.mark.slow
def test_filtered_column_in_a_tank():
    check(Case(column(sph.ContinuityDensity(), [sph.ShepardFilter(16)])))


def test_shifting_at_a_surface_has_finite_derivatives_on_a_lattice():
    """Inside the normal is what rounding left of zero, in float32 with a square that is hardly a number."""
    scene = sph.scenes.rotating_square(14, dtype=np.float32)
    step, found = 0.5 * sph.stable_time_step(scene), sph.topologies(scene)
    fastest = 2 * float(np.abs(scene["water"].velocity).max())

    def loss(speed):
        changed = scene.replace({"water.sound_speed": speed})
        run = sph.simulate(changed, 4 * step, 4 * step, time_step=step, topologies_of_scene=found, max_speed=fastest)
        return jnp.sum(run.final.systems["water"]["position"][:, 0] ** 2)

    at = jnp.asarray(scene.get("water.sound_speed"))
    value, slope = jax.jit(jax.value_and_grad(loss))(at)
    tangent = jax.jit(lambda c: jax.jvp(loss, (c,), (jnp.ones_like(c),))[1])(at)
    assert np.isfinite(value) and np.isfinite(slope) and np.isfinite(tangent)
