"""What users' programs compute is what these tests look at, though they are compiled in another way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiling import USUAL
from struck_plate import struck_plate

import jaxsph as sph

STEPS = 30


def end_of_a_struck_plate():
    """Thirty steps of water that strikes a plate, a function of the plate's modulus."""
    scene = struck_plate()
    found, dt = sph.topologies(scene), 0.6 * sph.stable_time_step(scene)
    substeps = sph.KickDriftKick(sph.stable_substeps(scene, 1.2 * dt))

    def end(modulus):
        changed = scene.replace({"plate.youngs_modulus": modulus})
        options = {"time_step": dt, "integrator": substeps, "topologies_of_scene": found, "max_speed": 4.0}
        run = sph.simulate(changed, STEPS * dt, mode="forward", **options)
        return run.final.systems["plate"]["displacement"], run.final.systems["water"]["velocity"]

    return end, scene["plate"].youngs_modulus


def gradient_of_a_beam():
    """Value and gradient of what thirty steps do to a beam, a function of its modulus."""
    scene = sph.scenes.turek_hron_beam(5)
    dt = 0.9 * sph.stable_time_step(scene)

    def loss(modulus):
        run = sph.simulate(scene.replace({"beam.youngs_modulus": modulus}), STEPS * dt, time_step=dt)
        return 1e6 * jnp.sum(run.final.systems["beam"]["displacement"] ** 2)

    return jax.value_and_grad(loss), scene["beam"].youngs_modulus


@pytest.mark.parametrize("made", [end_of_a_struck_plate, gradient_of_a_beam])
def test_usual_compiler_agrees(made):
    function, modulus = made()
    modulus = jnp.asarray(modulus)
    found, usual = jax.jit(function)(modulus), jax.jit(function, compiler_options=USUAL)(modulus)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(usual), strict=True):
        # Sums in another order, through thirty steps: a thousand roundings of the largest number, at most.
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1000 * np.finfo(float).eps * np.max(np.abs(theirs)))
