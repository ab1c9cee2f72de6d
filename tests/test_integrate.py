"""Time stepping: order, conservation, reversibility, the stability limit, prescribed motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import beam, block, peak

import jaxsph as sph
from jaxsph import pytree
from jaxsph.dynamics import accelerations, prepare
from jaxsph.stable_step import largest_stable
from jaxsph.state import initial_state, to_columns

C = 36.7  # p-wave speed of the bodies [m/s]
GRAVITY = np.array([1.0, -4.0])


def swinging(penalty=None, gravity=(0.0, 0.0), speed=0.5):
    """A free block that flies, turns and vibrates in its lowest modes."""
    body = block(2, disorder=0.0, smoothing_length=None)
    x = body.particles.positions
    velocity = speed * np.stack([np.sin(4 * x[:, 1]) + 1, np.sin(5 * x[:, 0]) + 6 * x[:, 1] ** 2], axis=1)
    body = pytree.replace(body, velocity=velocity)
    return sph.Scene(body, gravity=gravity, effects=[] if penalty is None else [sph.PenaltyForce(penalty)])


def momenta(run):
    mass = 1000.0 * run.scene["block"].particles.volumes
    x, v = np.asarray(run.positions("block")), np.asarray(run["block"]["velocity"])
    angular = np.einsum("n,tn->t", mass, x[..., 0] * v[..., 1] - x[..., 1] * v[..., 0])
    return np.einsum("n,tnd->td", mass, v), angular


@pytest.mark.parametrize("penalty", [None, 0.1])
def test_free_body_keeps_linear_and_angular_momentum(penalty):
    """Both to round-off: forces are antisymmetric, the energy does not see rotations and the penalty acts along the
    line of a pair, so forces have no torque at the positions of the step; and kick-drift-kick changes the angular
    momentum by x cross v dt = 0 in a drift and by the torque in a kick."""
    scene = swinging(penalty)
    dt = sph.stable_time_step(scene)
    run = sph.simulate(scene, 100 * dt, 10 * dt, time_step=dt)
    linear, angular = momenta(run)
    # a hundred steps, each with a rounding of each of 36 particles' momenta
    assert np.abs(linear - linear[0]).max() < 1e-13 * np.abs(linear[0]).max()
    assert np.abs(angular - angular[0]).max() < 1e-12 * np.abs(angular[0])
    assert np.abs(angular[0]) > 1


@jax.jit
def total_energy(scene, states, found):
    return jax.lax.map(lambda state: sph.observe.energies(scene, state, found)["total"], states)


def test_energy_of_a_free_vibration():
    """It swings about its start within (w dt)^2 of the modes that move, four times less with half the step, and has
    no trend: second order and symplectic."""
    scene = swinging(gravity=GRAVITY)
    found = sph.topologies(scene)
    limit = largest_stable(scene, found)
    duration = 40 * limit  # two periods of the slowest mode
    largest = []
    for divisor in (8, 16):
        run = sph.simulate(scene, duration, duration / 40, time_step=limit / divisor)
        total = np.asarray(total_energy(scene, run.states, found))
        errors = np.abs(total / total[0] - 1)
        assert errors[20:].max() < 1.5 * errors[:20].max(), "a trend would double it from one half to the next"
        largest.append(errors.max())
    assert largest[0] <= 1e-3
    # the next term of the error is (w dt)^2 smaller, .06 for the fastest mode and less for those that move
    assert largest[0] / largest[1] == pytest.approx(4, rel=0.06)


def test_step_converges_with_second_order_to_diffrax():
    scene = swinging(penalty=0.05, gravity=GRAVITY)
    limit = largest_stable(scene, sph.topologies(scene))
    duration = 20 * limit
    tight = sph.Diffrax(relative_tolerance=1e-10, absolute_tolerance=1e-13)
    exact = sph.simulate(scene, duration, duration / 2, integrator=tight).final.systems["block"]
    errors = []
    for divisor in (4, 8):
        found = sph.simulate(scene, duration, duration / 2, time_step=limit / divisor).final.systems["block"]
        errors.append([float(np.abs(found[k] - exact[k]).max()) for k in ("displacement", "velocity", "acceleration")])
    for coarse, fine, name in zip(*errors, ("displacement", "velocity", "acceleration"), strict=True):
        # the next order is (w dt / 4)^2, a few per cent for the modes that move
        assert coarse / fine == pytest.approx(4, rel=0.1), name
    assert errors[1][0] < 1e-3 * float(np.abs(exact["displacement"]).max())


def test_step_is_reversible():
    """Turned around, the body goes back to where it came from."""
    scene = swinging(penalty=0.05, gravity=GRAVITY)
    dt = sph.stable_time_step(scene)
    there = sph.simulate(scene, 50 * dt, time_step=dt)
    fields = there.final.systems["block"]
    back = pytree.replace(there.final, systems={"block": {**fields, "velocity": -fields["velocity"]}})
    home = sph.simulate(scene, 50 * dt, state=back, time_step=dt).final.systems["block"]
    largest = np.abs(there["block"]["displacement"]).max()
    # a hundred steps, each with a few roundings, which the motion does not amplify
    assert np.abs(home["displacement"]).max() < 1e-12 * largest
    start = scene["block"].velocity
    assert np.abs(home["velocity"] + start).max() < 1e-12 * np.abs(start).max()


def test_free_fall_is_exact():
    scene = swinging(gravity=GRAVITY, speed=0.0)
    dt = sph.stable_time_step(scene)
    run = sph.simulate(scene, 50 * dt, 10 * dt, time_step=dt)
    t = np.asarray(run.times)[:, None, None]
    # parabolas are exact for the step; a few roundings a step of positions that the stresses see over a spacing
    np.testing.assert_allclose(
        run["block"]["displacement"], np.broadcast_to(0.5 * GRAVITY * t**2, (6, 36, 2)), atol=1e-15
    )
    np.testing.assert_allclose(run["block"]["velocity"], np.broadcast_to(GRAVITY * t, (6, 36, 2)), atol=1e-12)


def test_damping_slows_a_body_down():
    """Drag with the velocity of the half step: (1 - rate dt / 2)^2 (1 - rate dt)^(n - 1) after n steps."""
    rate = 20.0
    body = pytree.replace(block(2, disorder=0.0), velocity=np.array([1.0, 2.0]))
    scene = sph.Scene(body, effects=[sph.Damping(rate)])
    dt = sph.stable_time_step(scene)
    run = sph.simulate(scene, 60 * dt, 20 * dt, time_step=dt)
    taken = float(run.time_step)
    steps = np.array([20, 40, 60])
    left = (1 - 0.5 * rate * taken) ** 2 * (1 - rate * taken) ** (steps - 1)
    for particle in (0, 20):
        v = np.asarray(run["block"]["velocity"])[1:, particle] / [1.0, 2.0]
        # all particles alike: no stress but by rounding
        np.testing.assert_allclose(v, np.stack([left, left], axis=1), rtol=1e-11)
    assert left[-1] < 0.7


@pytest.mark.parametrize("friction", [0.0, 1e-5])
def test_damping_shortens_the_step_and_the_limit_is_real(friction):
    """(w dt)^2 + 2 (tau w^2 + rate) dt = 4: for a rate of thrice the frequency a body diverges just beyond it."""
    body = block(2)
    free = largest_stable(sph.Scene(body), sph.topologies(sph.Scene(body)))
    noise = 1e-6 * np.random.default_rng(0).uniform(-1, 1, body.particles.positions.shape)
    effects = [sph.Damping(6 / free)] + ([sph.KelvinVoigt(friction)] if friction else [])
    scene = sph.Scene(pytree.replace(body, velocity=noise), effects=effects)
    found = sph.topologies(scene)
    limit = largest_stable(scene, found)
    square = 4 / free**2
    assert square * limit**2 + 2 * (friction * square + 6 / free) * limit == pytest.approx(4.0, rel=1e-6)
    assert peak(scene, found, 0.95 * limit, 150, "displacement") < 1e-6 * 150 * limit
    assert not peak(scene, found, 1.1 * limit, 300, "displacement") < 1e-3  # it may be infinite


def test_damping_alone_limits_the_step_of_a_rigid_body():
    ball = sph.RigidBody("ball", sph.ball((0, 0), 0.1, 0.05), 1000.0, velocity=(1.0, 0.0))
    scene = sph.Scene(ball, effects=[sph.Damping(1e3)])
    assert sph.stable_time_step(scene) == pytest.approx(0.9 * 2e-3)
    run = sph.simulate(scene, 0.1)
    assert np.abs(np.asarray(run["ball"]["velocity"][-1])).max() < 1e-3


@pytest.mark.parametrize("penalty", [0.05, 1.0])
def test_limit_of_the_step_is_real(penalty):
    """Below it a disordered body stays bounded; beyond it the same body diverges; `simulate` refuses to try."""
    body = block(2)
    noise = 1e-6 * np.random.default_rng(0).uniform(-1, 1, body.particles.positions.shape)
    scene = sph.Scene(pytree.replace(body, velocity=noise), effects=[sph.PenaltyForce(penalty)])
    found = sph.topologies(scene)
    limit = largest_stable(scene, found)
    bound = 1e-6 * 150 * limit  # as far as the fastest particle would fly without forces
    assert peak(scene, found, 0.95 * limit, 150, "displacement") < bound
    # the fastest mode grows by 2.4 a step at w dt = 2.2; a hundred steps take it to infinity or out of the linear range
    assert not peak(scene, found, 1.1 * limit, 150, "displacement") < 1e3 * bound
    with pytest.raises(
        sph.UnstableTimeStep, match=r"time_step = .* s is larger than the largest stable one, .* s; pass"
    ):
        sph.simulate(scene, 10 * limit, time_step=1.1 * limit)
    assert sph.stable_time_step(scene) == pytest.approx(0.9 * limit)


def test_limit_of_a_stretched_body_is_that_of_its_fastest_mode():
    """Of the dense matrix of stiffness over mass, about a state: a neo-Hookean body is stiffer across when thin."""
    scene = sph.Scene(pytree.replace(block(2), law=sph.NeoHookean()), effects=[sph.PenaltyForce(0.05)])
    found = sph.topologies(scene)
    x = np.asarray(scene["block"].particles.positions)
    rest = initial_state(scene)

    def at(displacement):
        return pytree.replace(rest, systems={"block": {**rest.systems["block"], "displacement": displacement}})

    stretched = at(x @ np.diag([1.5, -0.4]))
    assert sph.stable_time_step(scene, found, rest) == pytest.approx(sph.stable_time_step(scene, found), rel=1e-6)

    references, columns = prepare(scene, found), to_columns(stretched.systems, found)

    def force(moved):
        here = {"block": {**columns["block"], "displacement": moved}}
        return accelerations(scene, references, here, 0.0, forward_mode=True)["block"]["acceleration"]

    size = x.size
    stiffness = -np.asarray(jax.jacfwd(force)(columns["block"]["displacement"])).reshape(size, size)
    fastest = np.sqrt(np.abs(np.linalg.eigvals(stiffness)).max())
    # the power iteration comes from below; the margin of .9 is for that
    found_step = sph.stable_time_step(scene, found, stretched) / 0.9
    assert 2 / fastest <= found_step * (1 + 1e-9) <= 1.05 * 2 / fastest
    assert found_step < 0.85 * sph.stable_time_step(scene, found) / 0.9, "a fifth shorter"


def test_limit_is_that_of_a_lattice():
    """Of the order of the spacing over the p-wave speed, inverse to it, and independent of the law at rest."""
    limits = {}
    for e in (1e6, 4e6):
        for law in (sph.StVenantKirchhoff(), sph.NeoHookean()):
            scene = sph.Scene(block(2, disorder=0.0, youngs_modulus=e, law=law))
            limits[e, type(law).__name__] = largest_stable(scene, sph.topologies(scene))
    first = limits[1e6, "StVenantKirchhoff"]
    assert 0.5 < first * C / 0.1 < 4
    assert limits[1e6, "NeoHookean"] == pytest.approx(first, rel=1e-9), "both are Hooke's law at rest"
    assert limits[4e6, "StVenantKirchhoff"] == pytest.approx(first / 2, rel=1e-9)


def lifted(t, x):
    """A support that goes up and down, and tilts."""
    return jnp.stack([jnp.zeros_like(x[:, 0]), 1e-3 * (1 - jnp.cos(300.0 * t)) * (1 + 10 * x[:, 0])], axis=1)


def test_prescribed_motion_is_followed_exactly():
    still = beam()
    scene = pytree.replace(still, systems=(pytree.replace(still["beam"], motion=lifted),))
    run = sph.simulate(scene, 0.006, 0.001)
    clamped = scene["beam"].clamped
    x = jnp.asarray(scene["beam"].particles.positions)
    for i, t in enumerate(np.asarray(run.times)):
        place, speed = jax.jvp(lambda t: lifted(t, x), (t,), (1.0,))
        # the time of a step is a sum of a few roundings: 1e-18 s times the speed
        np.testing.assert_allclose(run["beam"]["displacement"][i][clamped], place[clamped], rtol=0, atol=1e-15)
        np.testing.assert_allclose(run["beam"]["velocity"][i][clamped], speed[clamped], rtol=0, atol=1e-12)
    assert np.abs(run["beam"]["displacement"][-1][~clamped]).max() > 1e-3, "the rest comes along"


def test_clamped_particles_stay():
    run = sph.simulate(beam(), 0.01, 0.005)
    clamped = run.scene["beam"].clamped
    assert clamped.sum() == 12
    for field in ("displacement", "velocity", "acceleration"):
        np.testing.assert_array_equal(run["beam"][field][:, clamped], 0)
        assert np.abs(run["beam"][field][-1][~clamped]).max() > 0


def test_motion_of_another_shape_is_refused():
    still = beam()
    scene = pytree.replace(still, systems=(pytree.replace(still["beam"], motion=lambda t, x: t * jnp.ones(2)),))
    with pytest.raises(ValueError, match=r"motion of 'beam' returned the shape \(2,\); it must be \(42, 2\)"):
        sph.simulate(scene, 0.001)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"relative_tolerance": 0.0}, r"relative_tolerance = 0\.0 must be positive"),
        ({"absolute_tolerance": -1.0}, r"absolute_tolerance = -1\.0 must be positive"),
        ({"max_steps": 0}, "max_steps = 0 must be at least 1"),
    ],
)
def test_diffrax_options_that_do_not_fit_are_refused(options, said):
    with pytest.raises(ValueError, match=said):
        sph.Diffrax(**options)


def test_a_solver_that_gives_up_says_so_and_keeps_what_it_reached():
    scene = beam()
    whole = sph.simulate(scene, 0.01, 0.001, integrator=sph.Diffrax())
    with pytest.raises(sph.SimulationError, match=r"did not reach the end; allow more max_steps") as caught:
        sph.simulate(scene, 0.01, 0.001, integrator=sph.Diffrax(max_steps=int(whole.final.step) // 2))
    kept = caught.value.trajectory
    assert 2 < len(kept.times) < 10
    np.testing.assert_allclose(
        kept["beam"]["displacement"], whole["beam"]["displacement"][: len(kept.times)], atol=1e-14
    )
