"""Schemes that a scene may call for: what they leave alone, what they conserve, and what flows they reach."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fluids import SMOOTHING, AllPairs, assert_equal, column, periodic, stirred, sums

import jaxsph as sph
from jaxsph.dynamics import place_boundaries, positions_of, prepare
from jaxsph.flow import filtered, pressure_rates
from jaxsph.geometry import ball, box, jitter, tank
from jaxsph.pytree import replace
from jaxsph.state import to_columns, to_rows
from jaxsph.surroundings import rebuild


def rates_of_pressure(scene, state, found=None):
    found = sph.topologies(scene) if found is None else found
    references, columns = prepare(scene, found), to_columns(state.systems, found)
    placed = place_boundaries(scene, references, columns, 0.0)
    lists = rebuild(scene, found, positions_of(scene, columns, placed))
    rates = pressure_rates(scene, references, columns, placed, lists, time=0.0)
    return {name: rows["rate"] for name, rows in to_rows({k: {"rate": v} for k, v in rates.items()}, found).items()}


def with_fields(state, name, **fields):
    return replace(state, systems={**state.systems, name: {**state.systems[name], **fields}})


def decay(scene, t_end=0.2):
    """Relative error of the kinetic energy of a Taylor-Green vortex at Re 100."""
    run = sph.simulate(scene, t_end)
    energy = np.sum(np.asarray(run["water"]["velocity"]) ** 2, axis=(1, 2))
    return energy[-1] / energy[0] / np.exp(-16 * np.pi**2 * t_end / 100) - 1


def green(effects, density=None, particles=24):
    base = sph.scenes.taylor_green(particles, effects=effects, dtype=np.float64)
    return sph.Scene(
        *base.systems,
        effects=effects,
        density=density,
        kernel=base.kernel,
        smoothing_length=base.smoothing_length,
        domain=base.domain,
    )


def test_edac_pressure_rate_and_force_are_the_sums_of_the_papers():
    """-rho c^2 div v + nu lap p, and Adami's force, against sums over all pairs."""
    scene = periodic(density=sph.EDAC(0.7)).replace({"water.viscosity": 0.0})
    rng, state = np.random.default_rng(0), stirred(scene)
    p = rng.uniform(-1, 1, 100)
    state = with_fields(state, "water", pressure=jnp.asarray(p))
    fields = state.systems["water"]
    x, v = np.asarray(fields["position"]), np.asarray(fields["velocity"])
    pairs, m = AllPairs(x, x, SMOOTHING[2], 1.0), float(scene["water"].mass())
    rho = 1.3 + np.asarray(fields["density_deviation"])
    volume, c, nu = m / rho, 9.0, 0.7 * SMOOTHING[2] * 9.0 / 8
    moving = np.sum((v[:, None] - v) * pairs.gradient, axis=-1)
    rate = rho * c**2 * (moving @ volume) + 2 * nu * ((p[:, None] - p) * pairs.f) @ volume
    assert_equal(rates_of_pressure(scene, state)["water"], rate)

    out = sums(scene, sph.topologies(scene), state.systems)["water"]
    rho = m * (pairs.w.sum(axis=1) + pairs.w_at_zero)
    assert_equal(1.3 + out["summed"], rho)
    squares = (m / rho) ** 2
    mean = (rho * p[:, None] + rho[:, None] * p) / (rho + rho[:, None])
    force = -np.sum(((squares[:, None] + squares) * mean)[..., None] * pairs.gradient, axis=1)
    assert_equal(m * np.asarray(out["acceleration"]), force)


def test_edac_pressure_is_carried_with_the_shift():
    """dv . grad p as differences, half of the shifts of both."""
    scene = periodic(density=sph.EDAC(0.7), effects=[sph.ParticleShifting(2.0)])
    rng, state = np.random.default_rng(0), stirred(scene)
    p, shift = rng.uniform(-1, 1, 100), rng.uniform(-1, 1, (100, 2))
    state = with_fields(state, "water", pressure=jnp.asarray(p), shift=jnp.asarray(shift))
    still = with_fields(state, "water", shift=jnp.zeros((100, 2)))
    carried = rates_of_pressure(scene, state)["water"] - rates_of_pressure(scene, still)["water"]
    fields = state.systems["water"]
    x = np.asarray(fields["position"])
    pairs, m = AllPairs(x, x, SMOOTHING[2], 1.0), float(scene["water"].mass())
    volume = m / (1.3 + np.asarray(fields["density_deviation"]))
    along = 0.5 * np.sum((shift[:, None] + shift) * pairs.gradient, axis=-1)
    # a difference of rates a hundred times as large
    assert_equal(np.asarray(carried), -(along * (p[:, None] - p)) @ volume, 1e-10)


def test_edac_diffusion_conserves_the_pressure_between_particles():
    scene = periodic(density=sph.EDAC())
    state = stirred(scene, speed=0.0)
    state = with_fields(state, "water", pressure=jnp.asarray(np.random.default_rng(0).uniform(-1, 1, 100)))
    rate = np.asarray(rates_of_pressure(scene, state)["water"])
    volume = scene["water"].mass() / (1.3 + np.asarray(state.systems["water"]["density_deviation"]))
    assert abs(np.sum(volume * rate)) < 1e-13 * np.sum(np.abs(volume * rate))  # rounding of a hundred terms
    assert np.sum(volume * rate * np.asarray(state.systems["water"]["pressure"])) < 0, "it smooths"


def test_edac_without_its_mean_feels_no_constant_pressure():
    for averaged in (True, False):
        scene = periodic(density=sph.EDAC(averaged_pressure=averaged))
        state = with_fields(stirred(scene, speed=0.0), "water", pressure=jnp.full(100, 50.0))
        largest = np.abs(sums(scene, sph.topologies(scene), state.systems)["water"]["acceleration"]).max()
        # rounding of 50 Pa, in a force that is 50 / (rho dx) = 400 m/s^2 without the mean's removal for any disorder
        assert (largest < 1e-10) if averaged else (largest > 1)


@pytest.mark.parametrize(
    ("density", "effect", "limit"),
    [
        # coarse: 24 particles along an edge, errors up to .06
        (sph.EDAC(), sph.TransportVelocity(), 0.03),
        (sph.EDAC(averaged_pressure=True), sph.ParticleShifting(1.0), 0.08),
        (None, sph.TransportVelocity(), 0.03),
    ],
)
def test_taylor_green_decays_as_it_should(density, effect, limit):
    effects = [effect] if density is not None else [effect, sph.DensityDiffusion(0.1)]
    assert abs(decay(green(effects, density))) < limit


@pytest.mark.parametrize("free_surface", [False, True])
def test_edac_keeps_water_at_rest_in_a_tank(free_surface):
    """Walls extrapolate the pressure of the state; water stays where it is, with its hydrostatic pressure."""
    spacing, top = 0.05, 0.5
    sides = ["left", "right", "bottom"] if free_surface else ["left", "right", "bottom", "top"]
    hydrostatic = lambda x: 9810 * (top - x[:, 1])  # noqa: E731
    particles = box((0, 0), (0.5, top), spacing)
    water = sph.Fluid("water", particles, 1000.0, 30.0, viscosity=50.0, pressure=hydrostatic)
    walls = sph.Wall("tank", tank((0, 0), (0.5, top), spacing, 3, sides=sides))
    scene = sph.Scene(water, walls, gravity=(0.0, -9.81), density=sph.EDAC(free_surface=free_surface))
    run = sph.simulate(scene, 0.3)
    error = np.asarray(run["water"]["pressure"][-1]) - hydrostatic(np.asarray(run["water"]["position"][-1]))
    # closed, all by itself; open, the surface is known to half a spacing and the diffusion levels there
    assert np.sqrt(np.mean(error**2)) < (0.15 if free_surface else 0.03) * 9810 * top
    moved = np.asarray(run["water"]["position"][-1] - run["water"]["position"][0])
    assert np.abs(moved).max() < 0.5 * spacing


def test_only_edac_has_a_pressure_in_the_state():
    for density, wanted in ((sph.EDAC(), True), (sph.SummationDensity(), False), (None, False)):
        assert ("pressure" in sph.initial_state(periodic(density=density)).systems["water"]) is wanted


def test_transport_velocity_is_the_push_of_a_constant_pressure():
    """And spreads particles: crowding falls, the energy of a fluid at rest stays zero."""
    scene = periodic(effects=[sph.TransportVelocity(3.0)])
    state = stirred(scene)
    out = sums(scene, sph.topologies(scene), state.systems)["water"]
    x, h = np.asarray(state.systems["water"]["position"]), SMOOTHING[2]
    pairs, m = AllPairs(x, x, h, 1.0), float(scene["water"].mass())
    squares = (m / (1.3 + np.asarray(state.systems["water"]["density_deviation"]))) ** 2
    pushed = -3.0 * np.sum((squares[:, None] + squares)[..., None] * pairs.gradient, axis=1)
    per_mass = squares[:, None] ** 0.5 * 1.3  # the mass of the rest density
    assert_equal(out["shift"], h / (4 * 9.0) / 2 * pushed / per_mass)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: periodic(effects=[sph.ParticleShifting(), sph.TransportVelocity()]), "at most one effect that moves"),
        (lambda: periodic(effects=[sph.KernelGradientCorrection()]), "flows that fill their domain"),
        (
            lambda: periodic(effects=[sph.KernelGradientCorrection(), sph.ParticleShifting(), sph.TensileControl()]),
            "both take p_b - p_a",
        ),
        (lambda: sph.EDAC(-1.0), r"EDAC\.alpha = -1\.0 must be >="),
        (lambda: sph.EDAC(averaged_pressure=True, free_surface=True), "leave it out"),
        (lambda: periodic(density=sph.EDAC(), effects=[sph.DensityDiffusion()]), "a density that EDAC does not evolve"),
        (lambda: sph.TransportVelocity(-1.0), r"TransportVelocity\.background_pressure = -1\.0 must be >="),
    ],
)
def test_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


@pytest.mark.parametrize(("d", "exact"), [(2, True), (2, False), (3, True)])
def test_corrected_pressure_force_is_exact_for_linear_pressures(d, exact):
    """At disordered particles, of two fluids in 2D; the gradient that is not corrected is off by a tenth and more."""
    slope = np.array([2.0, -5.0, 3.0])[:d]
    effects = [sph.ParticleShifting(), *([sph.KernelGradientCorrection()] if exact else [])]
    scene = periodic(d, effects=effects, periodic=False, two=d == 2)
    scene = scene.replace({f"{fluid.name}.viscosity": 0.0 for fluid in scene.fluids})
    state = stirred(scene, speed=0.0, spread=0.0)
    for fluid in scene.fluids:
        pressure = 4.0 + np.asarray(fluid.particles.positions) @ slope
        state = with_fields(state, fluid.name, density_deviation=jnp.asarray(pressure / float(fluid.sound_speed) ** 2))
    out, worst, count = sums(scene, sph.topologies(scene), state.systems), 0.0, 0
    for fluid in scene.fluids:
        x, density = np.asarray(fluid.particles.positions), float(fluid.density)
        density = density + np.asarray(state.systems[fluid.name]["density_deviation"])
        inside = np.all((x > 0.25) & (x < 0.75), axis=1)
        error = np.asarray(out[fluid.name]["acceleration"]) * density[:, None] + slope
        worst, count = max(worst, np.abs(error[inside]).max() / 5.0), count + inside.sum()
    assert count > 10
    # rounding of some thirty terms and the condition of M, which is near the unit matrix
    assert worst < 1e-12 if exact else worst > 0.1


def test_corrected_forces_of_water_at_rest_in_a_closed_tank():
    """Walls count in M: a hydrostatic pressure is balanced at the walls too, at disordered particles."""
    spacing = 0.05
    particles = jitter(box((0, 0), (0.5, 0.5), spacing), 0.1, 2)
    water = sph.Fluid("water", particles, 1.0, 10.0, pressure=lambda x: 9.81 * (0.5 - x[:, 1]))
    walls = sph.Wall("tank", tank((0, 0), (0.5, 0.5), spacing, 4, sides=["left", "right", "bottom", "top"]))
    effects = [sph.ParticleShifting(), sph.KernelGradientCorrection()]
    scene = sph.Scene(water, walls, gravity=(0.0, -9.81), effects=effects, smoothing_length=1.3 * spacing)
    out = sums(scene, sph.topologies(scene), sph.initial_state(scene).systems)["water"]
    rest = np.sqrt(np.mean(np.asarray(out["acceleration"]) ** 2)) / 9.81
    print(f"force on water at rest: {rest:.3f} g")
    assert rest < 0.1


def sound_wave(effects):
    """The wave u = sin(2 pi x) / 1000 in a periodic box of 32 x 8 spacings, Mach 1 / 10000."""
    spacing = 1 / 32
    water = sph.Fluid(
        "water",
        box((0, 0), (1, 8 * spacing), spacing),
        1.0,
        10.0,
        velocity=lambda x: np.stack([1e-3 * np.sin(2 * np.pi * x[:, 0]), np.zeros(len(x))], axis=1),
    )
    domain = sph.Domain((0, 0), (1, 8 * spacing), periodic=True)
    return sph.Scene(water, effects=effects, smoothing_length=1.3 * spacing, kernel=sph.CubicSpline(), domain=domain)


def test_a_damper_takes_the_stated_share_of_a_sound_wave_and_no_momentum():
    """exp(-2 pi^2 alpha c h t / L^2) of the amplitude, over one period; little of it without the damper."""
    for alpha in (0.0, 0.5):
        scene = sound_wave([sph.AcousticDamper(alpha)])
        run = sph.simulate(scene, 0.1, 0.1)
        x = np.asarray(run["water"]["position"][-1, :, 0])
        u = np.asarray(run["water"]["velocity"][-1], float)
        amplitude = 2 * np.mean(u[:, 0] * np.sin(2 * np.pi * x)) / 1e-3
        expected = np.exp(-2 * np.pi**2 * alpha * 10.0 * scene.smoothing_length * 0.1)
        print(f"alpha {alpha}: {amplitude:.4f} of the wave is left, expected {expected:.4f}")
        # 1 %: the formula leaves out the square of damping over frequency, .004, and the kernel smooths the wave.
        assert abs(amplitude / expected - 1) < 0.01
        assert np.max(np.abs(np.mean(u, axis=0))) < 1e-15


def test_a_damper_shortens_the_step():
    """By the stability of an oscillator with friction that is a step late: z^2 + 2 alpha z g = 4 with z = g .8."""
    steps = [sph.stable_time_step(sound_wave([sph.AcousticDamper(alpha)])) for alpha in (0.0, 0.5, 1.0, 2.0)]
    # The roots of s^2 + 2 alpha s = .8^2, over .8.
    expected = [
        1.0,
        max(np.roots([1, 1, -0.64])) / 0.8,
        max(np.roots([1, 2, -0.64])) / 0.8,
        max(np.roots([1, 4, -0.64])) / 0.8,
    ]
    assert np.array(steps) / steps[0] == pytest.approx(expected, rel=1e-12)


def test_a_damper_is_stable_at_the_largest_step():
    """A rotating square, whose arms are under tension. With steps of .8 h / (alpha c) it blows up before w t = 2."""
    scene = sph.scenes.rotating_square(20)
    scene = replace(scene, effects=(*scene.effects, sph.AcousticDamper(1.0)))
    run = sph.simulate(scene, 2.0, 0.1, time_step=sph.stable_time_step(scene) / 0.9)
    energy = np.asarray(run.observe(lambda scene, state: sph.observe.energies(scene, state)["total"]), float)
    print("energy over that of the start:", energy / energy[0])
    # Nothing puts any in. A thousandth is what the project allows for round-off and the error of the steps.
    assert np.max(energy / np.minimum.accumulate(energy)) < 1.001


def test_much_artificial_viscosity_shortens_the_step():
    """As a damper of 3 alpha / 8 in 2D would, of sound that rings up at 1.1 h / c; the .02 of the scenes does not."""
    steps = [sph.stable_time_step(sound_wave([sph.ArtificialViscosity(alpha)])) for alpha in (0.0, 0.02, 1.0, 4.0)]
    expected = [1.0, 1.0, max(np.roots([1, 0.75, -1.21])) / 0.8, max(np.roots([1, 3, -1.21])) / 0.8]
    assert np.array(steps) / steps[0] == pytest.approx(expected, rel=1e-12)


def test_much_artificial_viscosity_is_stable_at_the_largest_step():
    """A collapsing column. With steps of .6 h / c it blows up, and .8 was what sound alone allows."""
    scene = sph.scenes.dam_break(10, effects=[sph.DeltaDiffusion(0.1), sph.ArtificialViscosity(4.0)])
    run = sph.simulate(scene, 0.3, 0.03, time_step=sph.stable_time_step(scene) / 0.9)
    energy = np.asarray(run.observe(lambda scene, state: sph.observe.energies(scene, state)["total"]), float)
    print("energy over that of the start:", energy / energy[0])
    # Nothing puts any in. A thousandth is what the project allows for round-off and the error of the steps.
    assert np.max(energy / np.minimum.accumulate(energy)) < 1.001


def test_a_damper_needs_a_density_that_evolves():
    with pytest.raises(ValueError, match="AcousticDamper needs the rate of a density that SummationDensity"):
        periodic(effects=[sph.AcousticDamper()], density=sph.SummationDensity())


@pytest.mark.slow
def test_traced_and_plain_runs_start_with_the_same_forces():
    """A plain run finds them by a step of no duration, a traced one by themselves. Also of densities that are sums."""
    for scene in (
        periodic(density=sph.SummationDensity()),
        column(effects=[sph.AcousticDamper(), sph.DeltaDiffusion()]),
    ):
        state, step = stirred(scene), sph.stable_time_step(scene)
        plain = sph.simulate(scene, step, state=state, time_step=step)
        found = sph.topologies(scene)
        run = jax.jit(lambda s, scene=scene, found=found, step=step: sph.simulate(
            scene, step, state=s, time_step=step, topologies_of_scene=found, max_speed=10.0).states)  # fmt: skip
        traced = run(state)
        for name in ("velocity", "density_deviation", "acceleration"):
            assert_equal(plain["water"][name], traced.systems["water"][name], 1e-12)


def test_shepard_filter_keeps_a_constant_density_and_smooths_another():
    scene = periodic(effects=[sph.ShepardFilter(10)], periodic=False)
    found, state = sph.topologies(scene), stirred(scene)
    rng = np.random.default_rng(0)
    for deviation in (np.full(100, 0.1), rng.uniform(-0.1, 0.1, 100)):
        state = with_fields(state, "water", density_deviation=jnp.asarray(deviation))
        references, columns = prepare(scene, found), to_columns(state.systems, found)
        lists = rebuild(scene, found, {"water": columns["water"]["position"]})
        smooth = np.asarray(to_rows(filtered(scene, references, columns, lists), found)["water"]["density_deviation"])
        if np.ptp(deviation) == 0:
            np.testing.assert_allclose(smooth, 0.1, rtol=1e-14)
        else:
            assert np.std(smooth) < 0.7 * np.std(deviation)


def test_shepard_filter_acts_once_in_so_many_steps():
    steps = np.arange(0, 101, 4)
    due = np.asarray(sph.ShepardFilter(10).due(steps, 4))
    np.testing.assert_array_equal(steps[due], [12, 20, 32, 40, 52, 60, 72, 80, 92, 100])


def test_shepard_filter_acts_in_plain_runs_when_it_does_in_traced_ones():
    """Though a plain run builds its lists when they are due, here in no step, and a traced one every so many steps."""
    ends = {}
    for effects in ((sph.ShepardFilter(6),), ()):
        scene = periodic(effects=list(effects), periodic=False)
        found, state, step = sph.topologies(scene), stirred(scene), 0.5 * sph.stable_time_step(scene)
        options: Any = {"time_step": step, "topologies_of_scene": found, "max_speed": 1.0}
        plain = sph.simulate(scene, 24 * step, state=state, **options).final
        traced = jax.jit(lambda s, scene=scene, end=24 * step, options=options: sph.simulate(
            scene, end, state=s, **options).final)(state)  # fmt: skip
        ends[effects] = np.asarray(plain.systems["water"]["density_deviation"])
        # 24 steps of sums over the same neighbors in another order
        assert_equal(ends[effects], np.asarray(traced.systems["water"]["density_deviation"]), 1e-9)
    smooth, rough = ends.values()
    assert np.max(np.abs(smooth - rough)) > 1e-3 * np.max(np.abs(rough)), "the filter did not act"


@pytest.mark.parametrize("spacings", [1.0, 0.98])
def test_repulsion_of_walls_is_between_fluid_and_walls_only_and_ends_at_its_distance(spacings):
    """-V_a V_w rho_a c^2 max(W / W(s dx) - 1, 0)^2 grad W beside what there is without it.

    At a wall without pressure, whose density is then that of rest.
    """
    repulsion = sph.WallRepulsion(0.5, distance=spacings)
    plain, repelled = (column(effects=e, pressure=sph.PressureZeroing()) for e in ([], [repulsion]))
    state = stirred(plain)
    accelerations = [sums(s, sph.topologies(s), state.systems)["water"]["acceleration"] for s in (plain, repelled)]
    x, walls = np.asarray(state.systems["water"]["position"]), np.asarray(plain["tank"].particles.positions)
    h = float(plain.smoothing_length)
    across = AllPairs(x, walls, h)
    rho = 1000 + np.asarray(state.systems["water"]["density_deviation"])
    mass = float(plain["water"].mass())
    at_its_distance = float(plain.kernel.w(jnp.array([0.05 * spacings, 0.0]), h))
    crowded = np.maximum(across.w / at_its_distance - 1, 0)
    distance = np.linalg.norm(x[:, None] - walls, axis=2)
    assert 1 < np.sum(crowded > 0) == np.sum(distance < 0.05 * spacings), "some are closer"
    with pytest.raises(ValueError, match=r"distance = 1\.2 must be above 0 and at most 1 particle spacing"):
        sph.WallRepulsion(distance=1.2)
    pressure = 0.5 * rho[:, None] * 20.0**2 * crowded**2
    force = -np.sum((mass / rho[:, None] * 0.05**2 * pressure)[..., None] * across.gradient, axis=1)
    # the difference of two accelerations of 1e2 m/s^2
    np.testing.assert_allclose(mass * np.asarray(accelerations[1] - accelerations[0]), force, atol=1e-12 * mass * 1e4)


def beside_a_ball(*effects):
    """Water of which some lies closer to a rigid ball than a spacing."""
    spacing = 0.05
    body = sph.RigidBody("ball", ball((0.41, 0.15), 0.12, spacing), density=500.0)
    water = sph.Fluid("water", jitter(box((0, 0), (0.3, 0.3), spacing), 0.1, 2), 1000.0, 20.0)
    return sph.Scene(water, body, effects=effects, domain=sph.Domain((-1, -1), (2, 2)))


def test_solids_repel_if_they_are_asked_to_and_get_what_they_give():
    """The reaction to round-off, and the derivative by where the water is in both modes."""
    with pytest.raises(ValueError, match="WallRepulsion acts at a Wall, and the scene has none"):
        beside_a_ball(sph.WallRepulsion())
    plain, solids = beside_a_ball(), beside_a_ball(sph.WallRepulsion(0.5, solids=True))
    state, found = stirred(solids), sph.topologies(solids)
    unasked, asked = (sums(scene, found, state.systems) for scene in (plain, solids))
    mass = np.asarray(solids["ball"].density * solids["ball"].particles.volumes)
    on_ball, before = (mass @ np.asarray(out["ball"]["surface_acceleration"]) for out in (asked, unasked))
    on_water = float(solids["water"].mass()) * np.sum(np.asarray(asked["water"]["acceleration"]), axis=0)
    assert on_ball[0] > before[0] + 1.0, "it is pushed away from the water on its left"
    # Some 1e3 pair forces of up to 1e3 N and both signs, each rounded to 1e-16 of itself.
    np.testing.assert_allclose(on_water, -on_ball, rtol=0, atol=1e-10)

    def thrust(shift, forward_mode=False):
        water = {**state.systems["water"], "position": state.systems["water"]["position"] + shift}
        out = sums(solids, found, {**state.systems, "water": water}, forward_mode=forward_mode)
        return jnp.dot(mass, out["ball"]["surface_acceleration"][:, 0])

    direction = np.random.default_rng(1).uniform(-1, 1, state.systems["water"]["position"].shape)
    at_rest = np.zeros_like(direction)
    slope = jnp.vdot(jax.grad(thrust)(at_rest), direction)
    tangent = jax.jvp(lambda x: thrust(x, True), (at_rest,), (direction,))[1]
    step = 1e-7  # m, of a force that varies over 1e-2 m: 1e-10 of truncation, 1e-8 of rounding
    difference = (thrust(step * direction) - thrust(-step * direction)) / (2 * step)
    np.testing.assert_allclose([slope, tangent], difference, rtol=1e-6)


@pytest.mark.slow
def test_a_sheet_that_is_drawn_out_stays_on_the_wall_that_repels_it():
    """One layer on a floor, drawn out to twice its length: its volume would have it at a quarter of a spacing."""
    spacing, lowest = 0.05, {}
    sheet = box((-0.5, 0), (1.0, spacing), spacing)
    floor = box((-1.5, -4 * spacing), (3.0, 4 * spacing), spacing)
    for name, effects in {"plain": [], "repelled": [sph.WallRepulsion()]}.items():
        water = sph.Fluid(
            "water", sheet, 1000.0, 20.0, velocity=lambda x: np.stack([2.0 * x[:, 0], 0 * x[:, 0]], axis=1)
        )
        walls = sph.Wall("floor", floor, sph.AdamiExtrapolation(clip=True))
        scene = sph.Scene(
            water,
            walls,
            gravity=(0.0, -9.81),
            effects=[sph.DeltaDiffusion(0.1), *effects],
            domain=sph.Domain((-3, -1), (3, 1)),
        )
        run = sph.simulate(scene, 0.5, 0.05)
        lowest[name] = float(np.asarray(run["water"]["position"])[..., 1].min()) / spacing
    print(f"lowest middle of a particle in spacings: {lowest}")
    # a quarter of a spacing is the middle of a sheet of half a spacing; without the force it is in the floor's surface
    assert lowest["plain"] < 0.1 < 0.25 < lowest["repelled"]
