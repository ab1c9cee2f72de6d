"""H15: lists that are too small, particles alone, at one place, or leaving: the right answer or a clear error."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from rows import Case, Row, precision

import jaxsph
from jaxsph import surroundings
from jaxsph.geometry import Particles, box

HALF, DOUBLE = np.float32, np.float64
SPACING = 0.05
GRAVITY = 9.81
ERRORS = (RuntimeError, ValueError)  # as one or the other jax hands on what a callback raised


def block(dtype, *, positions=None, velocity=(0.0, 0.0), gravity=0.0, reach=1.0) -> jaxsph.Scene:
    """Water without walls: a block of 6 x 6 particles, or particles at given places."""
    particles = box((0, 0), (0.3, 0.3), SPACING, dtype=dtype)
    if positions is not None:
        places = np.asarray(positions, dtype)
        particles = Particles(places, np.full(len(places), SPACING**2, dtype), SPACING)
    water = jaxsph.Fluid("water", particles, density=1000.0, sound_speed=20.0, velocity=velocity)
    return jaxsph.Scene(
        water,
        gravity=(0.0, -gravity),
        effects=[jaxsph.DeltaDiffusion(0.1), jaxsph.ArtificialViscosity(0.02)],
        smoothing_length=2 * SPACING,
        domain=jaxsph.Domain((-reach, -reach), (reach, reach)),
    )


def plate_of(particles: Particles) -> jaxsph.Scene:
    """A structure of given particles."""
    return jaxsph.Scene(jaxsph.Structure("plate", particles, density=1000.0, youngs_modulus=1e6, poisson_ratio=0.3))


def refused(call: Callable, numbers: tuple, words: str) -> float:
    """0 if a call with these numbers raises an error with these words, else 1; what came instead is printed."""
    try:
        jax.block_until_ready(call(*numbers))
    except ERRORS as error:
        if words in str(error):
            return 0.0
        print(f"  another message: {error}", flush=True)
    else:
        print(f"  nothing was raised instead of {words!r}", flush=True)
    return 1.0


def overflow(dtype) -> list[Row]:
    """Lists of six tenths of the room that is needed: enlarged in a plain run, an error under jit and under grad."""
    scene = block(dtype, velocity=lambda x: -0.5 * (x - 0.15))
    found = jaxsph.topologies(scene)
    tight = dict(found)
    for a, b in surroundings.pairs_of(scene):
        tight[f"{a}-{b}"] = surroundings.enlarged(tight[f"{a}-{b}"], 0.6)
    whole, run = (jaxsph.simulate(scene, 0.02, topologies_of_scene=lists) for lists in (found, tight))
    apart = np.max(np.abs(np.asarray(whole["water"]["position"] - run["water"]["position"], float)))

    def last(c):
        changed = scene.replace({"water.sound_speed": c})
        run = jaxsph.simulate(changed, 0.01, time_step=1e-3, max_speed=2.0, topologies_of_scene=tight)
        return jnp.sum(run["water"]["position"][-1] ** 2)

    words = "more neighbors than the neighbor list has slots"
    where = ("36 in 2D", precision(dtype))
    return [
        Row("list too small, plain run: difference / spacing", float(apart) / SPACING, 1e-5, *where),
        Row("list too small, under jit: not refused", refused(jax.jit(last), (20.0,), words), 0.0, *where),
        Row("list too small, under grad: not refused", refused(jax.grad(last), (20.0,), words), 0.0, *where),
    ]


def alone(dtype) -> list[Row]:
    """A particle without neighbors falls as any body does; in a structure it is refused."""
    height, time = 0.8, 0.3
    scene = block(dtype, positions=[(0.0, height), (0.5, height)], gravity=GRAVITY)
    run = jaxsph.simulate(scene, time, time_step=1e-3)
    place = np.asarray(run["water"]["position"][-1], float)
    error = np.max(np.abs(place - np.array([(0.0, height), (0.5, height)]) + np.array([0.0, GRAVITY * time**2 / 2])))
    body = box((0, 0), (0.2, 0.2), SPACING, dtype=dtype)
    lonely = body | Particles(np.array([(0.8, 0.8)], dtype), np.array([SPACING**2], dtype), SPACING)
    structure = lambda: jaxsph.simulate(plate_of(lonely), 0.01)  # noqa: E731
    where = ("2 in 2D", precision(dtype))
    # a few hundred additions of steps, each rounded
    limit = 1e-5 if dtype is HALF else 1e-12
    return [
        Row("particles alone, free fall: error / way", float(error / (GRAVITY * time**2 / 2)), limit, *where),
        Row("particle alone in a structure: not refused", refused(structure, (), "do not span"), 0.0, *where),
    ]


def coincident(dtype) -> list[Row]:
    """Two particles of a fluid at one place: everything stays finite, momentum zero; a structure refuses them."""
    places = np.asarray(box((0, 0), (0.3, 0.3), SPACING).positions)
    places = np.concatenate([places, places[14:15]])
    scene = block(dtype, positions=places, velocity=lambda x: -0.5 * (x - 0.15))

    def last(c):
        changed = scene.replace({"water.sound_speed": c})
        run = jaxsph.simulate(changed, 0.05, time_step=1e-3, max_speed=5.0, topologies_of_scene=found)
        return jnp.sum(run["water"]["position"][-1] ** 2)

    found = jaxsph.topologies(scene)
    run = jaxsph.simulate(scene, 0.05)
    velocity = np.asarray(run["water"]["velocity"][-1], float)
    slope = float(jax.grad(last)(20.0))
    body = box((0, 0), (0.2, 0.2), SPACING, dtype=dtype)
    twice = body | Particles(body.positions[5:6], body.volumes[5:6], SPACING)
    structure = lambda: jaxsph.simulate(plate_of(twice), 0.01)  # noqa: E731
    limit = 1e-4 if dtype is HALF else 1e-12  # fifty steps of opposite forces, each rounded
    wrong = float(not np.isfinite(slope + velocity.sum()))
    start = np.asarray(run["water"]["velocity"][0], float).mean(axis=0)  # the masses are equal
    drift = np.linalg.norm(velocity.mean(axis=0) - start) / np.abs(velocity).max()
    where = ("37 in 2D", precision(dtype))
    return [
        Row("coincident in a fluid: fields or gradient not finite", wrong, 0.0, *where),
        Row("coincident in a fluid: change of momentum / (mass v_max)", float(drift), limit, *where),
        Row("coincident in a structure: not refused", refused(structure, (), "at the same place"), 0.0, *where),
    ]


def leaving(dtype) -> list[Row]:
    """A block that flies out of its domain: an error that keeps what came before it, and one under jit."""
    scene = block(dtype, velocity=(10.0, 0.0))
    kept = []

    def plain():
        try:
            return jaxsph.simulate(scene, 0.2, 0.01).states.time
        except jaxsph.ParticleOutside as error:
            kept.append(error.trajectory)
            raise

    # so few particles come to lie in other cells as they go: room for that
    found = jaxsph.topologies(scene, capacity_multiplier=3.0)

    def last(c):
        changed = scene.replace({"water.sound_speed": c})
        run = jaxsph.simulate(changed, 0.1, time_step=2.5e-4, max_speed=11.0, topologies_of_scene=found)
        return jnp.sum(run["water"]["position"][-1])

    words = "left the domain"
    refusal = refused(plain, (), words)
    furthest = float(np.max(np.asarray(kept[-1]["water"]["position"][..., 0]))) if kept else np.inf
    where = ("36 in 2D", precision(dtype))
    return [
        Row("leaves the domain, plain run: not refused", refusal, 0.0, *where),
        Row("leaves the domain: furthest saved x / bound", furthest, 1.0, *where),
        Row("leaves the domain, under jit: not refused", refused(jax.jit(last), (20.0,), words), 0.0, *where),
    ]


def mistakes(quick: bool) -> Iterator[list[Row]]:
    """1 stands for an answer that is wrong without a word, 0 for the right one or the error that says so."""
    for dtype in (HALF,) if quick else (HALF, DOUBLE):
        for what in (overflow, alone, coincident, leaving):
            yield what(dtype)


CASES = [Case("H15", "Mistakes, and particles where none should be", mistakes)]
