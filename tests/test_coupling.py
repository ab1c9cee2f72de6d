"""Fluids and structures in one run: what they exchange, and how structures divide a step of the fluids."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fluids import stirred, sums

import jaxsph as sph
from jaxsph import integrate, observe
from jaxsph.dynamics import positions_of, prepare
from jaxsph.files import read_state
from jaxsph.geometry import box
from jaxsph.state import to_columns
from jaxsph.surroundings import rebuild
from jaxsph.thin_wall import thin_wall


def collision(pressure=None, thickness=None, viscosity=1.0, modulus=2e5, dtype: Any = np.float64):
    """A block of water that flies against an elastic bar; nothing else, so that momentum stays."""
    spacing = 0.05
    water = sph.Fluid(
        "water", box((0, 0), (0.2, 0.3), spacing, dtype=dtype), 1000.0, 20.0, viscosity=viscosity, velocity=(1.0, 0.3)
    )
    bar = sph.Structure(
        "bar",
        box((0.22, -0.05), (0.075, 0.4), 0.025, on_surface=True, dtype=dtype),
        density=500.0,
        youngs_modulus=modulus,
        poisson_ratio=0.3,
        pressure=sph.AdamiExtrapolation() if pressure is None else pressure,
        thickness=thickness,
    )
    effects = [sph.DensityDiffusion(0.1), sph.PenaltyForce(0.05)]
    return sph.Scene(water, bar, effects=effects, smoothing_length=0.075, domain=sph.Domain((-2, -2), (3, 3)))


MODELS = [
    sph.AdamiExtrapolation(),
    sph.BernoulliExtrapolation(),
    sph.PressureMirroring(),
    sph.PressureZeroing(),
    sph.WallContinuity(clip=False),
    sph.WallSummation(clip=False),
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_forces_are_exchanged_to_round_off(model):
    """For every model of the pressure: what the water gets from the bar, the bar gets from the water."""
    scene = collision(model, thickness=0.075)
    state = stirred(scene, spread=0.01)
    out = sums(scene, sph.topologies(scene, state), state.systems)
    mass = np.asarray(scene["bar"].density * scene["bar"].particles.volumes)
    on_bar = mass @ np.asarray(out["bar"]["surface_acceleration"])
    on_water = np.asarray(scene["water"].mass()) * np.sum(np.asarray(out["water"]["acceleration"]), axis=0)
    assert np.linalg.norm(on_bar) > 1.0
    # Some 1e3 pair forces of up to 1e3 N and both signs, each rounded to 1e-16 of itself.
    np.testing.assert_allclose(on_water, -on_bar, rtol=0, atol=1e-10)


@pytest.mark.parametrize("across", [5, 2])
def test_water_of_a_plates_spacing_is_held_off_by_one_spacing(across):
    """At one pressure, as deep in still water: a lattice goes on through the surface of the plate, thin or not."""
    spacing, pressure = 0.05, 1e4
    plate = sph.Structure(
        "plate",
        box((-0.4, -(across - 1) * spacing), (1.8, (across - 1) * spacing), spacing, on_surface=True, dtype=np.float64),
        density=1000.0,
        youngs_modulus=1e6,
        poisson_ratio=0.3,
        thickness=(across - 1) * spacing,
    )

    def push(gap):
        """On the lowest particle in the middle, upwards, in 2 p / (rho spacing)."""
        low = gap * spacing - 0.5 * spacing  # the first particles are half a spacing above it
        block = box((0.0, low), (1.0, 0.5), spacing, dtype=np.float64)
        water = sph.Fluid("water", block, 1000.0, 100.0, pressure=lambda x: pressure + 0 * x[:, 0])
        scene = sph.Scene(water, plate, smoothing_length=1.5 * spacing, domain=sph.Domain((-2, -2), (3, 3)))
        out = sums(scene, sph.topologies(scene), sph.initial_state(scene).systems)
        lowest = np.argmin(np.abs(block.positions[:, 0] - 0.525) + block.positions[:, 1])
        return float(out["water"]["acceleration"][lowest, 1]) * 1000 * spacing / (2 * pressure)

    # the pressure compresses the water, of which the plate knows nothing, by 1e-3
    assert abs(push(1.0)) < 2e-3
    if across == 5:
        assert push(0.8) > 0.04 > -0.04 > push(1.2), "back to where it rests"


def test_momentum_is_exchanged_to_round_off_in_every_step():
    scene = collision()
    dt = sph.stable_time_step(scene)
    run = sph.simulate(scene, 20 * dt, dt, integrator=sph.KickDriftKick({"bar": 4}))
    momentum = np.asarray(run.observe(observe.linear_momentum))
    gained = np.asarray(scene["bar"].density * scene["bar"].particles.volumes) @ np.asarray(run["bar"]["velocity"][-1])
    assert np.linalg.norm(gained) > 1e-3 * np.linalg.norm(momentum[0]), "the water has reached the bar"
    # Each step adds some 1e3 pair forces of both signs, each rounded to 1e-16 of itself.
    assert np.max(np.abs(momentum - momentum[0])) < 1e-13 * np.linalg.norm(momentum[0]) * len(momentum)


def test_a_plate_thinner_than_the_support_pushes_like_a_half_space():
    kernel = sph.WendlandC2()
    y, weight = np.polynomial.legendre.leggauss(120)
    for d in (2, 3):
        for thickness in (0.4, 1.0):
            thin = thin_wall(kernel, d, thickness, 1.0)
            assert thin is not None

            def push(z, deep, extra, d=d, thin=thin):
                """Integral of the kernel's gradient over a plate from distance z to z + deep."""
                s = z + 0.5 * min(deep, 2 - z) * (y + 1)
                across = y + 1  # half of a line, or a radius, out to the support
                depth, radius = np.meshgrid(s, across, indexing="ij")
                distance = np.hypot(depth, radius)
                along = np.stack([distance] + [np.zeros_like(distance)] * (d - 1))
                slope = np.asarray(kernel.gradient_factor(along, 1.0))
                if extra:
                    slope = slope + np.asarray(thin.slope(distance**2, 1.0))
                area = 2.0 if d == 2 else 2 * np.pi * radius
                weights = np.outer(0.5 * min(deep, 2 - z) * weight, weight)
                return -np.sum(slope * depth * area * weights)

            for z in (0.3, 0.6, 1.0):
                # The slope is softened within .1 h, which takes up to 4 % at a third of h.
                assert push(z, thickness, True) == pytest.approx(push(z, 9.0, False), rel=0.045)
                if z + thickness < 1.5:
                    assert push(z, thickness, False) < 0.97 * push(z, 9.0, False)
    assert thin_wall(kernel, 2, 2.0, 1.0) is None
    with pytest.raises(ValueError, match="fiftieth"):
        thin_wall(kernel, 2, 0.01, 1.0)


def test_water_meets_a_structure_with_the_velocity_of_its_whole_step(monkeypatch):
    """What it moves in the step over the step, not the velocity of the last of its many small ones."""
    scene, seen = collision(modulus=2e7), []
    kick = np.random.default_rng(0).uniform(-1, 1, scene["bar"].particles.positions.shape)
    scene = scene.replace({"bar.velocity": kick})
    found, dt = sph.topologies(scene), sph.stable_time_step(scene)
    integrator = sph.KickDriftKick(sph.stable_substeps(scene, dt))
    references, columns = prepare(scene, found), to_columns(sph.initial_state(scene).systems, found)
    place = integrate.place_boundaries

    def noticed(scene, references, columns, time):
        seen.append(place(scene, references, columns, time))
        return seen[-1]

    monkeypatch.setattr(integrate, "place_boundaries", noticed)
    lists = rebuild(scene, found, positions_of(scene, columns, place(scene, references, columns, 0.0)))
    after = integrator.step(scene, references, columns, lists, jnp.zeros(()), jnp.asarray(dt), forward_mode=True)
    way = after["bar"]["displacement"] - columns["bar"]["displacement"]
    assert len(seen) >= 2
    for placed in seen:  # half way, for the density, and at the end, for the forces
        # sums of some ten increments, rounded to 1e-16 of the displacement and divided by 1e-3 s
        np.testing.assert_allclose(placed["bar"][1], way / dt, rtol=1e-9, atol=1e-9)
    assert np.abs(after["bar"]["velocity"] - way / dt).max() > 0.1, "a tenth of the kick: it is another"


def test_a_thin_light_plate_shortens_the_step_of_the_water():
    """To 1 over the frequency of its mass on the spring of a layer of water, sqrt(rho_s t dx / rho) / c."""
    thick, thin = (collision(thickness=t) for t in (0.5, 1e-4))
    free = 0.9 * 0.8 * 0.075 / 20.0
    assert sph.stable_time_step(thick) == pytest.approx(free)
    assert sph.stable_time_step(thin) == pytest.approx(0.9 * np.sqrt(0.5 * 1e-4 * 0.05) / 20.0)


def test_substeps_are_those_of_the_stiffness():
    soft, stiff = collision(modulus=2e5), collision(modulus=2e7)
    dt = sph.stable_time_step(soft)
    assert dt == pytest.approx(sph.stable_time_step(stiff)), "a stiff bar does not slow the water down"
    few, many = sph.stable_substeps(soft, dt)["bar"], sph.stable_substeps(stiff, dt)["bar"]
    assert many == pytest.approx(10 * few, abs=10), "the p-wave speed grows with the root of the modulus"
    with pytest.raises(sph.UnstableTimeStep, match=f"'bar': {many}"):
        sph.simulate(stiff, 2 * dt, dt, integrator=sph.KickDriftKick({"bar": few}))
    with pytest.raises(ValueError, match="'plate'"):
        sph.simulate(soft, 2 * dt, dt, integrator=sph.KickDriftKick({"plate": 3}))
    with pytest.raises(ValueError, match="whole numbers"):
        sph.KickDriftKick({"bar": 0})


def test_a_traced_run_says_that_it_needs_substeps_and_notices_too_few():
    scene = collision(modulus=2e5)
    dt, found = sph.stable_time_step(scene), sph.topologies(scene)

    def tip(modulus, integrator):
        changed = scene.replace({"bar.youngs_modulus": modulus})
        run = sph.simulate(
            changed, 2 * dt, time_step=dt, topologies_of_scene=found, integrator=integrator, max_speed=2.0
        )
        return run["bar"]["displacement"][-1, 0, 0]

    with pytest.raises(ValueError, match="stable_substeps"):
        jax.jit(lambda e: tip(e, sph.KickDriftKick()))(2e5)
    few = sph.KickDriftKick(sph.stable_substeps(scene, dt, found))
    traced = jax.jit(lambda e: tip(e, few))
    assert np.isfinite(traced(2e5))
    with pytest.raises(Exception, match="time step is larger"):
        traced(2e7).block_until_ready()


def test_a_continued_run_has_the_same_bits(tmp_path):
    scene = collision(dtype=np.float32)
    dt, found = sph.stable_time_step(scene), sph.topologies(scene)  # the same lists: compiled once
    whole = sph.simulate(scene, 16 * dt, 8 * dt, topologies_of_scene=found)
    first = sph.simulate(scene, 8 * dt, 8 * dt, topologies_of_scene=found, out=tmp_path / "first.vtkhdf")
    state = read_state(tmp_path / "first.vtkhdf", sph.initial_state(scene), scene)
    rest = sph.simulate(scene, 8 * dt, 8 * dt, state=state, topologies_of_scene=found)
    for name, fields in whole.final.systems.items():
        for field, value in fields.items():
            np.testing.assert_array_equal(value, rest.final.systems[name][field], err_msg=f"{name} {field}")
    assert first.time_step == rest.time_step
