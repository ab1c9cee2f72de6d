"""Flows that fill their domain: Taylor-Green, Poiseuille, cavity."""

from __future__ import annotations

import calibrate_viscosity as channel  # pyright: ignore[reportMissingImports]
import jax
import numpy as np
from cases import Case, Peer, studied
from reference import table  # pyright: ignore

import jaxsph
from jaxsph.accuracy import Results, Study, grid
from jaxsph.pytree import replace

REYNOLDS = 100.0


def vortex_error(position, velocity, time: float) -> dict[str, float]:
    """Relative L2 error of the velocities (N, 2) at the places (N, 2) where particles are."""
    exact = np.exp(-8 * np.pi**2 / REYNOLDS * time) * channel.pattern(position)
    return {"velocity": float(np.linalg.norm(velocity - exact) / np.linalg.norm(exact))}


def vortex_scene(particles=25, scheme="shifting"):
    """Schemes: particles shifted; as they are; EDAC with the transport velocity."""
    if scheme == "EDAC":
        scene = jaxsph.scenes.taylor_green(particles, reynolds=REYNOLDS, effects=[jaxsph.TransportVelocity()])
        return replace(scene, density=jaxsph.EDAC())
    effects = {"shifting": None, "plain": [jaxsph.DensityDiffusion(0.1)]}[scheme]
    return jaxsph.scenes.taylor_green(particles, reynolds=REYNOLDS, effects=effects)


def vortices(quick: bool) -> Results:
    def error_of(run):
        fields = run["water"]
        position, velocity = (np.asarray(fields[name][-1], float) for name in ("position", "velocity"))
        return vortex_error(position, velocity, float(run.times[-1]))

    study = Study(vortex_scene, 1.0, 0.1, error_of=error_of, title="Taylor-Green vortex, Re 100, to t = 1")
    two = {"particles": (25, 50), "precision": ("float32",)}
    settings = [
        *grid(precision=["float32"], particles=(16, 25, 35, 50, 71, 100)),
        *grid(precision=["float64"], particles=(25, 50)),
        *grid(**two, step_fraction=(0.45,)),
        *grid(**two, kernel=("WendlandC2",), neighbors=(28, 50)),
        *grid(**two, scheme=("EDAC", "plain")),
        *grid(precision=["float64"], particles=(16, 25), integrator=("Tsit5",), tolerance=(1e-3, 1e-5)),
        *grid(precision=["float64"], particles=(16, 25), integrator=("Bosh3",), tolerance=(1e-3,)),
    ]
    return studied(study, settings, quick, grid(precision=["float32"], particles=(16, 25)))


def vortices_of_peer(arrays) -> dict[str, float]:
    place, speed = (np.stack([arrays[a][-1], arrays[b][-1]], axis=1) for a, b in ("xy", "uv"))
    return vortex_error(place, speed, float(arrays["times"][-1]))


def start_up_error(y, u, times) -> dict[str, float]:
    """Root mean square over particles and saves of u (T, N) from the exact start-up at y (T, N), in units of the top.

    All in units of height, viscous time and top speed.
    """
    exact = np.stack([channel.start_up(1.0, 8.0, 1.0, here, t) for here, t in zip(y, times, strict=True)])
    return {"velocity": float(np.sqrt(np.mean((u - exact) ** 2)))}


def poiseuille(quick: bool) -> Results:
    height, top, nu = 1e-3, 1.25e-5, 1e-6

    def error_of(run):
        fields = run["water"]
        y, u = np.asarray(fields["position"][1:, :, 1], float), np.asarray(fields["velocity"][1:, :, 0], float)
        return start_up_error(y / height, u / top, np.asarray(run.times[1:], float) * nu / height**2)

    def scene_of(particles=20, viscosity="Morris"):
        scene = jaxsph.scenes.poiseuille(particles, height=height, top_speed=top)
        law = {"Morris": jaxsph.MorrisViscosity(), "Monaghan": jaxsph.MonaghanViscosity()}[viscosity]
        systems = tuple(replace(s, viscosity_law=law) if s.name == "water" else s for s in scene.systems)
        return replace(scene, systems=systems)

    title = "Poiseuille flow from rest, Re .0125, to t = .225 H²/ν"
    study = Study(scene_of, 0.225, 0.0225, error_of=error_of, title=title)
    two = {"particles": (10, 20), "precision": ("float32",)}
    settings = [
        *grid(precision=["float32"], particles=(10, 14, 20, 28, 40)),
        *grid(precision=["float64"], particles=(10, 20)),
        *grid(**two, step_fraction=(0.45,)),
        *grid(**two, kernel=("WendlandC2",), neighbors=(28, 50)),
        *grid(**two, viscosity=("Monaghan",)),
    ]
    return studied(study, settings, quick, grid(precision=["float32"], particles=(10, 14)))


def poiseuille_of_peer(arrays) -> dict[str, float]:
    return start_up_error(arrays["y"], arrays["u"] / arrays["top"], arrays["times"] * arrays["nu"])


def center_lines():
    """Points (P, 2) inside the cavity on both center lines, and the velocity of finite elements there: u, then v."""
    lines = [line for line in table("fluid/cavity_fem_centrelines.csv") if line["Re"] == "100"]
    place = np.array([float(line["coord"]) for line in lines])
    inside = (place > 0) & (place < 1)
    u, v = (np.array([float(line[name]) for line in lines])[inside] for name in ("u_at_x0.5", "v_at_y0.5"))
    half, place = np.full(inside.sum(), 0.5), place[inside]
    return np.concatenate([np.stack([half, place], 1), np.stack([place, half], 1)]), np.concatenate([u, v])


LAST = 20
"""States of a cavity that are averaged, .25 apart. In the mean of four the disorder of the particles shows: runs whose
Reynolds numbers differ by 1e-5 then have errors of .005 to .014 at 25 x 25, with these .005 to .006."""


def cavity(quick: bool) -> Results:
    points, expected = center_lines()
    n = len(points) // 2
    look = lambda scene, s: jaxsph.observe.interpolate(scene, s, "water", "velocity", points, order=1)  # noqa: E731
    seen = jax.jit(jax.vmap(look, (None, 0)))

    def error_of(run):
        last = jax.tree.map(lambda leaf: leaf[-LAST:], run.states)
        mean = np.mean(np.asarray(seen(run.scene, last), float), axis=0)
        found = np.concatenate([mean[:n, 0], mean[n:, 1]])
        return {"velocity": float(np.sqrt(np.mean((found - expected) ** 2)))}

    def scene_of(particles=25):
        return jaxsph.scenes.lid_driven_cavity(particles, reynolds=REYNOLDS)

    title = "Lid-driven cavity, Re 100, mean over t = 10.25 to 15"
    study = Study(scene_of, 15.0, 0.25, error_of=error_of, title=title)
    settings = [
        *grid(precision=["float32"], particles=(16, 25, 35, 50)),
        *grid(precision=["float64"], particles=(25,)),
        *grid(precision=["float32"], particles=(16, 25), kernel=("WendlandC2",), neighbors=(28, 50)),
    ]
    return studied(study, settings, quick, grid(precision=["float32"], particles=(12,)))


def cavity_of_peer(arrays) -> dict[str, float]:
    """Velocities by Shepard's sum with the kernel of the run (quintic spline, h = dx), the mean over the last saves."""
    points, expected = center_lines()
    h, kernel, sums = float(arrays["h"]), jaxsph.QuinticSpline(), []
    for x, y, u, v in zip(*(arrays[name][-LAST:] for name in "xyuv"), strict=True):
        offset = np.stack([points[:, :1] - x, points[:, 1:] - y])
        weight = np.asarray(kernel.w(offset, h))
        sums.append(np.stack([weight @ u, weight @ v], 1) / weight.sum(axis=1, keepdims=True))
    mean, n = np.mean(sums, axis=0), len(points) // 2
    found = np.concatenate([mean[:n, 0], mean[n:, 1]])
    return {"velocity": float(np.sqrt(np.mean((found - expected) ** 2)))}


CASES = [
    Case(
        "taylor_green",
        "Taylor-Green vortex",
        {"velocity": "relative L2 error of the velocity at t = 1"},
        vortices,
        (0.05, 0.02, 0.01),
        peers=(Peer("taylor_green", (25, 50), vortices_of_peer),),
    ),
    Case(
        "poiseuille",
        "Poiseuille flow",
        {"velocity": "rms error of the velocity / top speed"},
        poiseuille,
        (0.02, 0.01, 0.005),
        peers=(Peer("poiseuille", (10, 20, 40), poiseuille_of_peer),),
    ),
    Case(
        "cavity",
        "Lid-driven cavity",
        {"velocity": "rms error on the center lines / lid speed"},
        cavity,
        (0.02, 0.01, 0.005),
        peers=(Peer("cavity", (16, 25, 35), cavity_of_peer),),
    ),
]
