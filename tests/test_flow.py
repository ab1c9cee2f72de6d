"""The sums of a fluid against plain sums over all pairs, what they conserve, and what they leave alone."""

import jax.numpy as jnp
import numpy as np
import pytest
from fluids import SMOOTHING, AllPairs, assert_equal, periodic, stirred, sums, together

import jaxsph as sph


def evaluated(scene, state=None, **options):
    """All particles together with what the package finds for them, and the geometry of all pairs."""
    state = stirred(scene) if state is None else state
    out = sums(scene, sph.topologies(scene), state.systems, **options)
    all_of = together(scene, state.systems, out)
    period = None if scene.domain is None else 1.0
    return all_of, AllPairs(all_of["position"], all_of["position"], float(scene.smoothing_length), period)


def between(values):
    """a - b of all pairs."""
    return values[:, None] - values[None]


def pressure_force(f, pairs, form):
    """Equation (11), or with volumes."""
    if form == "mass":
        each = f["p"] / f["rho"] ** 2
        weight = f["m"][:, None] * f["m"] * (each[:, None] + each)
    else:
        volume = f["m"] / f["rho"]
        weight = volume[:, None] * volume * (f["p"][:, None] + f["p"])
    return -np.sum(weight[..., None] * pairs.gradient, axis=1)


def morris(f, pairs):
    volume = f["m"] / f["rho"]
    weight = volume[:, None] * volume * (f["mu"][:, None] + f["mu"]) * pairs.f
    return np.sum(weight[..., None] * between(f["velocity"]), axis=1)


def adami(f, pairs):
    squares, mu = (f["m"] / f["rho"]) ** 2, f["mu"]
    weight = (squares[:, None] + squares) * 2 * mu[:, None] * mu / (mu[:, None] + mu) * pairs.f
    return np.sum(weight[..., None] * between(f["velocity"]), axis=1)


def monaghan(f, pairs):
    """(d + 2) V_a V_b (mu_a + mu_b) (v_ab . x_ab) / x_ab^2 grad W."""
    volume, d = f["m"] / f["rho"], f["velocity"].shape[1]
    along = np.sum(between(f["velocity"]) * pairs.offset, axis=-1) / np.where(pairs.squared > 0, pairs.squared, 1)
    weight = (d + 2) * volume[:, None] * volume * (f["mu"][:, None] + f["mu"]) * along
    return np.sum(weight[..., None] * pairs.gradient, axis=1)


def force_of(f):
    return f["m"][:, None] * f["got_acceleration"]


def assert_no_net_force(f):
    """Momentum is conserved: a rounding of 1e-16 for each of a hundred particles' sums."""
    force = force_of(f)
    assert np.abs(force).min() > 0
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * np.abs(force).sum()


LAWS = {morris: sph.MorrisViscosity(), adami: sph.AdamiViscosity(), monaghan: sph.MonaghanViscosity()}


@pytest.mark.parametrize(
    ("form", "d", "two", "viscous"),
    [
        ("volume", 2, True, morris),
        ("mass", 2, True, adami),
        ("volume", 3, False, morris),
        ("volume", 2, True, monaghan),
        ("mass", 3, False, monaghan),
    ],
)
def test_density_rate_and_forces(form, d, two, viscous):
    """Also between two fluids of different density, sound speed and viscosity."""
    law = LAWS[viscous]
    f, pairs = evaluated(periodic(d, two=two, density=sph.ContinuityDensity(form), law=law))
    assert np.sum(pairs.w > 0, axis=1).min() > 10
    moving = np.sum(between(f["velocity"]) * pairs.gradient, axis=-1)
    volume = f["m"] / f["rho"]
    rate = f["rho"] * (moving @ volume) if form == "volume" else moving @ f["m"]
    assert_equal(f["got_rate"], rate)
    assert_equal(force_of(f), pressure_force(f, pairs, form) + viscous(f, pairs))
    assert_no_net_force(f)


def test_summed_density():
    scene = periodic(two=True, density=sph.SummationDensity())
    f, pairs = evaluated(scene)
    rest = np.concatenate([np.full(fluid.n_particles, fluid.density) for fluid in scene.fluids])
    assert_equal(rest + f["got_summed"], pairs.w @ f["m"] + pairs.w_at_zero * f["m"])
    # forces see the sum, not what the state brought
    c = np.concatenate([np.full(fluid.n_particles, fluid.sound_speed) for fluid in scene.fluids])
    f |= {"rho": rest + f["got_summed"], "p": c**2 * f["got_summed"]}
    assert_equal(force_of(f), pressure_force(f, pairs, "mass") + morris(f, pairs))
    assert_no_net_force(f)


def test_artificial_viscosity():
    """Of approaching pairs only, with the means of density and sound speed; the fluids are inviscid otherwise."""
    h, alpha, beta = SMOOTHING[2], 0.3, 2.0
    scene = periodic(two=True, law=sph.AdamiViscosity(), effects=[sph.ArtificialViscosity(alpha, beta)])
    scene = scene.replace({"water.viscosity": 0.0, "oil.viscosity": 0.0})
    f, pairs = evaluated(scene)
    c = np.concatenate([np.full(fluid.n_particles, fluid.sound_speed) for fluid in scene.fluids])
    c = 0.5 * (c[:, None] + c)
    approach = np.minimum(np.sum(between(f["velocity"]) * pairs.offset, axis=-1), 0)
    mu = h * approach / (pairs.squared + 0.01 * h**2)
    friction = (-alpha * c * mu + beta * mu**2) / (0.5 * (f["rho"][:, None] + f["rho"]))
    expected = -np.sum((f["m"][:, None] * f["m"] * friction)[..., None] * pairs.gradient, axis=1)
    assert_equal(force_of(f), expected + pressure_force(f, pairs, "volume"))
    assert np.sum(f["velocity"] * expected) < 0, "it takes energy"
    assert_no_net_force(f)


@pytest.mark.parametrize("kind", [sph.DensityDiffusion, sph.DeltaDiffusion])
def test_diffusion_of_density(kind):
    scene = periodic(effects=[kind(0.2)])
    f, pairs = evaluated(scene)
    difference = -2 * between(f["rho"])
    if kind is sph.DeltaDiffusion:
        gradients = f["density_gradient"]
        difference = difference + np.sum((gradients[:, None] + gradients) * pairs.offset, axis=-1)
    volume = f["m"] / f["rho"]
    diffused = -0.2 * SMOOTHING[2] * 9.0 * (difference * pairs.f) @ volume
    moving = np.sum(between(f["velocity"]) * pairs.gradient, axis=-1)
    assert_equal(f["got_rate"], f["rho"] * (moving @ volume) + diffused)
    # What flows out of one flows into another: volumes times rates add up to nothing.
    assert abs(np.sum(volume * diffused)) < 1e-12 * np.sum(np.abs(volume * diffused))


def test_delta_diffusion_leaves_a_linear_profile_alone():
    """Also at free surfaces: the corrected gradient is exact for linear fields wherever there are enough neighbors."""
    scene = periodic(effects=[sph.DeltaDiffusion(0.2)], periodic=False)
    state, slope = sph.initial_state(scene), np.array([0.02, -0.05])
    deviation = scene["water"].particles.positions @ slope
    fields = {**state.systems["water"], "density_deviation": jnp.asarray(deviation)}
    found = sph.topologies(scene)
    gradient = sums(scene, found, {"water": fields})["water"]["density_gradient"]
    # the matrix of a corner is inverted with a condition of some tens
    np.testing.assert_allclose(gradient, np.broadcast_to(slope, gradient.shape), atol=1e-12)
    rate = sums(scene, found, {"water": {**fields, "density_gradient": gradient}})["water"]["rate"]
    x = np.asarray(fields["position"])
    pairs, volume = AllPairs(x, x, SMOOTHING[2]), scene["water"].mass() / (1.3 + deviation)
    uncorrected = 0.2 * SMOOTHING[2] * 9.0 * (2 * between(deviation) * pairs.f) @ volume
    assert np.abs(rate).max() < 1e-12 * np.abs(uncorrected).max()


@pytest.mark.parametrize("two", [False, True])
@pytest.mark.parametrize("form", ["volume", "mass"])
def test_delta_diffusion_leaves_the_forces_alone(form, two):
    """It acts on the density only, though forces read the volumes that it gathers."""
    density = sph.ContinuityDensity(form)
    effects: list = [sph.ArtificialViscosity(0.3)]
    without, listed = (
        periodic(effects=effects + more, density=density, two=two) for more in ([], [sph.DeltaDiffusion()])
    )
    systems = stirred(listed).systems
    bare = {name: {k: v for k, v in fields.items() if k != "density_gradient"} for name, fields in systems.items()}
    found, expected = (sums(scene, sph.topologies(scene), of) for scene, of in ((listed, systems), (without, bare)))
    for name in systems:
        acceleration = found[name]["acceleration"]
        # some tens of terms, each with a few roundings of 1e-16
        limit = 1e-14 * np.abs(acceleration).max()
        np.testing.assert_allclose(acceleration, expected[name]["acceleration"], rtol=0, atol=limit)


def test_tensile_control():
    """Where p_a < 0 the force on a has p_b - p_a for p_a + p_b, as far as a is inside."""
    scene = periodic(effects=[sph.TensileControl()])
    state = stirred(scene)
    cover = jnp.asarray(np.random.default_rng(8).uniform(0.7, 1.0, 100))
    state.systems["water"]["cover"] = cover
    f, pairs = evaluated(scene, state)
    x = np.clip((np.asarray(cover) - 0.75) / 0.2, 0, 1)
    inside, volume = x * x * (3 - 2 * x), f["m"] / f["rho"]
    assert 20 < np.sum((f["p"] < 0) & (inside > 0)) < 80
    taken = np.where(f["p"] < 0, inside * 2 * f["p"], 0.0)
    both = f["p"][:, None] + f["p"] - taken[:, None]
    pressure = -np.sum((volume[:, None] * volume * both)[..., None] * pairs.gradient, axis=1)
    assert_equal(force_of(f), pressure + morris(f, pairs))


def test_shifting():
    """The shift from the crowding and its limit; density and momentum carried with the shift of the step before."""
    h, speed = SMOOTHING[2], 2.0
    for strength in (0.1, 8.0):
        scene = periodic(effects=[sph.ParticleShifting(speed, strength)])
        f, pairs = evaluated(scene)
        volume = f["m"] / f["rho"]
        clumped = 1 + 0.2 * (pairs.w / pairs.w_at(0.1)) ** 4
        shift = -strength * speed * 2 * h * np.sum((clumped * volume)[..., None] * pairs.gradient, axis=1)
        size = np.linalg.norm(shift, axis=1, keepdims=True)
        assert_equal(f["got_shift"], shift * np.minimum(1, 0.5 * speed / size))
        assert np.mean(size > 0.5 * speed) == pytest.approx(float(strength > 1), abs=0.2), "one of the two is limited"
        along = 0.5 * np.sum((f["shift"][:, None] + f["shift"]) * pairs.gradient, axis=-1)
        moving = np.sum(between(f["velocity"]) * pairs.gradient, axis=-1)
        carried = -(along * between(f["rho"])) @ volume
        assert_equal(f["got_rate"], f["rho"] * (moving @ volume) + carried)
        carried = -np.sum((along * volume)[..., None] * between(f["velocity"]), axis=1)
        force = pressure_force(f, pairs, "volume") + morris(f, pairs)
        assert_equal(f["got_acceleration"], force / f["m"][:, None] + carried)
