"""Internal friction: what it takes from each mode, where it is stable, and that a body that turns is left alone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import block, in_columns, in_rows, peak

import jaxsph as sph
from jaxsph import pytree
from jaxsph.elastic_forces import elastic_acceleration
from jaxsph.structure import reference, topology

SMALL = 1e-9  # [m/s]: so slow that what is not linear in the displacement is lost in rounding


@pytest.fixture(scope="module")
def modes():
    """Angular frequencies and shapes (N, d) of a free block, slowest first, without its rigid motions."""
    body = block(2)
    found = topology(body)
    ready = reference(body, found, penalty=False)
    shape = ready.positions.shape
    force = lambda u: elastic_acceleration(body, ready, u.reshape(shape)).reshape(-1)  # noqa: E731
    matrix = np.asarray(jax.jit(jax.jacfwd(force))(jnp.zeros(ready.positions.size)))
    root = np.sqrt(np.asarray(ready.mass))  # of all directions of a particle
    root = np.broadcast_to(root, shape).reshape(-1)
    squared, vectors = np.linalg.eigh(-root[:, None] * matrix / root)
    # Rigid motions and the modes that particles see no stresses of are not vibrations.
    real = squared > 1e-4 * squared[-1]
    shapes = [in_rows((vector / root).reshape(shape), found) for vector in vectors.T[real]]
    return np.sqrt(squared[real]), shapes


def scene_of(velocity, relaxation_time):
    effects = [sph.KelvinVoigt(relaxation_time)] if relaxation_time else []
    return sph.Scene(pytree.replace(block(2), velocity=velocity), effects=effects)


def test_a_mode_decays_by_half_its_frequency_squared_times_tau(modes):
    frequencies, shapes = modes
    for number in (0, len(shapes) // 2):
        w, shape = frequencies[number], shapes[number]
        tau = 0.02 / w
        scene = scene_of(SMALL * shape / np.abs(shape).max(), tau)
        period = 2 * np.pi / w
        step = period / np.ceil(period / (0.2 * sph.stable_time_step(scene)))
        run = sph.simulate(scene, 5 * period, period, time_step=step)
        u = np.asarray(run["block"]["velocity"])
        along = np.sum(u * shape, axis=(1, 2)) / np.sum(u[0] * shape)
        # After n periods of the undamped mode the phase is off by n pi tau^2 w^2 / 4: nothing.
        rate = -np.log(along[-1]) / (5 * period)
        # the velocity in the force is that of the half step: of second order, (w dt)^2 at most .04
        assert rate == pytest.approx(0.5 * w**2 * tau, rel=0.02)


def test_the_limit_of_the_step_is_real(modes):
    """With friction of some strength: bounded below, divergent above."""
    frequencies, shapes = modes
    tau = 0.3 / frequencies[-1]
    scene = scene_of(SMALL * shapes[-1] / np.abs(shapes[-1]).max(), tau)
    limit = sph.stable_time_step(scene) / 0.9
    exact = np.sqrt((2 / frequencies[-1]) ** 2 + tau**2) - tau
    assert limit == pytest.approx(exact, rel=0.02), "a power iteration of some steps"
    found = sph.topologies(scene)
    assert peak(scene, found, 0.97 * exact, 400, "velocity") < 1.01 * SMALL, "it never gets faster than at the start"
    # of two roots one is below -1 by what the step is beyond the limit, and four hundred steps take it far
    assert not peak(scene, found, 1.05 * exact, 400, "velocity") < 1e3 * SMALL, "infinite or nearly so"


def test_a_body_that_turns_is_left_alone():
    """The stress of a rotation is of second order in tau times its rate."""
    body, rate, tau = block(2), 3.0, 1e-4
    found = topology(body)
    ready = reference(body, found, penalty=False)
    position = jnp.asarray(in_columns(np.asarray(body.particles.positions), found))
    turning = rate * jnp.stack([-position[1], position[0]])
    force = elastic_acceleration(body, ready, sph.KelvinVoigt(tau).ahead(jnp.zeros_like(position), turning))
    stretched = elastic_acceleration(body, ready, tau * rate * position)
    # Strains (tau w)^2 / 2 in all directions, beside tau w + (tau w)^2 / 2 of a body stretched by tau w.
    expected = 0.5 * tau * rate * np.abs(stretched).max()
    assert np.abs(force).max() == pytest.approx(expected, rel=5 * tau * rate)  # what is of the next order


def test_gradients_with_respect_to_tau_and_the_modulus():
    """Both modes against central differences over a hundred steps."""
    positions = np.asarray(block(2).particles.positions)
    scene = scene_of(np.stack([positions[:, 1], -0.3 * positions[:, 0]], axis=1), 2e-5)
    dt, found = 0.8 * sph.stable_time_step(scene), sph.topologies(scene)

    def loss(x, mode="reverse"):
        now = scene.replace({"KelvinVoigt.relaxation_time": 2e-5 * x[0], "block.youngs_modulus": 1e6 * x[1]})
        run = sph.simulate(now, 100 * dt, 100 * dt, time_step=dt, topologies_of_scene=found, mode=mode)
        return 1e6 * jnp.sum(run["block"]["displacement"][-1] ** 2)

    x = jnp.ones(2)
    reverse = jax.jit(jax.grad(loss))(x)
    forward = jax.jit(jax.jacfwd(lambda x: loss(x, "forward")))(x)
    np.testing.assert_allclose(forward, reverse, rtol=1e-10)  # a hundred steps of roundings
    value = jax.jit(loss)
    h = 1e-3
    for k, direction in enumerate(np.eye(2)):
        slope = lambda h, e=direction: (value(x + h * e) - value(x - h * e)) / (2 * h)  # noqa: E731
        # extrapolated: what remains of the truncation is of the order h^4 = 1e-12
        assert (4 * slope(h / 2) - slope(h)) / 3 == pytest.approx(float(reverse[k]), rel=1e-7)


def test_what_it_acts_on():
    with pytest.raises(ValueError, match=r"KelvinVoigt\.relaxation_time = -1\.0 must be >= 0\.0"):
        sph.KelvinVoigt(-1.0)
