"""F01 to F07: flows that fill their domain, against exact solutions and finite elements."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import numpy as np
from reference import table
from rows import Case, Row, precision

import jaxsph
from jaxsph.pytree import replace


def fields_at(run, name: str, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (N, d) of a fluid at a saved state."""
    fields = run[name]
    return np.asarray(fields["position"][index], float), np.asarray(fields["velocity"][index], float)


def vortex_errors(run, reynolds: float = 100.0) -> tuple[float, float]:
    """Of a decaying vortex: relative L1 error of the speed at t = 1, and of the viscosity that the decay shows."""
    position, velocity = fields_at(run, "water", -1)
    times = np.asarray(run.times, float)
    k = 2 * np.pi
    u = -np.cos(k * position[:, 0]) * np.sin(k * position[:, 1])
    v = np.sin(k * position[:, 0]) * np.cos(k * position[:, 1])
    exact = np.hypot(u, v) * np.exp(-8 * np.pi**2 * times[-1] / reynolds)
    error = float(np.sum(np.abs(np.linalg.norm(velocity, axis=1) - exact)) / np.sum(exact))
    energy = np.sum(np.asarray(run["water"]["velocity"], float) ** 2, axis=(1, 2))
    late = times > 0.19
    slope = np.polyfit(times[late], np.log(energy[late]), 1)[0]
    return error, abs(-slope / (16 * np.pi**2) * reynolds - 1)


def taylor_green(quick: bool) -> Iterator[list[Row]]:
    """Decay at Re 100 to t = 1: L1 error of the speed, viscosity from the kinetic energy between t = .2 and 1."""
    reynolds, errors = 100.0, {}
    runs = [(25, np.float32), (50, np.float32), (100, np.float32), (50, np.float64)]
    for particles, dtype in runs[:1] if quick else runs:
        scene = jaxsph.scenes.taylor_green(particles, reynolds=reynolds, dtype=dtype)
        run = jaxsph.simulate(scene, 1.0, 0.05)
        error, effective = vortex_errors(run)
        where = (f"{particles} x {particles}", precision(dtype))
        limits = (0.03, 0.02) if particles == 50 else (None, None)
        yield [
            Row("relative L1 error of the speed, t = 1", error, limits[0], *where),
            Row("|effective / physical viscosity - 1|", effective, limits[1], *where),
        ]
        if dtype is np.float32:
            errors[particles] = error
            if len(errors) == 3:
                ratio = max(errors[50] / errors[25], errors[100] / errors[50])
                yield [Row("L1 error / that of the next coarser", ratio, 1.0, "25, 50, 100", "float32")]


def start_up(flow: str, quick: bool) -> Iterator[list[Row]]:
    """Largest error over the channel at every time of the table, over the top speed."""
    lines = table("fluid/startup_morris_SI.csv")
    times = sorted({float(line["t_s"]) for line in lines})
    every, top = 0.0225, 1.25e-5
    runs = [(20, np.float32), (20, np.float64), (40, np.float32)]
    for particles, dtype in runs[:1] if quick else runs:
        scene = getattr(jaxsph.scenes, flow)(particles, dtype=dtype)
        worst = 0.0
        for t_end, save in ((0.225, every), (1.0, 0.25)):
            run = jaxsph.simulate(scene, t_end, save)
            saved = np.asarray(run.times, float)
            for time in times:
                index = int(np.argmin(np.abs(saved - time)))
                if abs(saved[index] - time) > 1e-4:
                    continue
                position, velocity = fields_at(run, "water", index)
                here = [line for line in lines if float(line["t_s"]) == time]
                y = [float(line["y_m"]) for line in here]
                expected = np.interp(position[:, 1], y, [float(line[f"u_{flow}_mps"]) for line in here])
                worst = max(worst, float(np.max(np.abs(velocity[:, 0] - expected))) / top)
        limit = 0.01 if particles == 20 else None
        yield [Row("largest |u - exact| / u_max, all times", worst, limit, f"{particles} across", precision(dtype))]


def cavity(reynolds: int, quick: bool) -> Iterator[list[Row]]:
    """Root mean square of the difference from the finite-element velocities on both center lines, the time's mean.

    The steady flow does not depend on where it came from: the coarsest starts at rest, every other from the velocities
    of the one before, and the last row says how far it still was from steady.
    """
    lines = [line for line in table("fluid/cavity_fem_centrelines.csv") if line["Re"] == str(reynolds)]
    place = np.array([float(line["coord"]) for line in lines])
    inside = (place > 0) & (place < 1)
    u, v = (np.array([float(line[name]) for line in lines])[inside] for name in ("u_at_x0.5", "v_at_y0.5"))
    n, half = len(u), np.full(inside.sum(), 0.5)
    points = np.concatenate([np.stack([half, place[inside]], 1), np.stack([place[inside], half], 1)])
    limits = {(100, 50): 0.01, (100, 100): 0.006, (1000, 100): 0.03}
    ladder = {100: ((50, 15), (100, 5)), 1000: ((25, 40), (50, 15), (100, 8))}[reynolds]  # particles, L / U

    def means(particles, dtype, duration, start=None):
        """Mean velocities on the center lines over every unit of time, and the last scene and state."""
        scene = jaxsph.scenes.lid_driven_cavity(particles, reynolds=reynolds, dtype=dtype)
        if start is not None:
            before, state = start
            at = np.asarray(scene["water"].particles.positions)
            velocity = jaxsph.observe.interpolate(before, state, "water", "velocity", at.astype(before.dtype), order=1)
            moving = replace(scene["water"], velocity=np.asarray(velocity, dtype))
            scene = replace(scene, systems=(moving, *scene.systems[1:]))
        seen = jax.jit(jax.vmap(lambda s: jaxsph.observe.interpolate(scene, s, "water", "velocity", points, order=1)))
        found, state, out = jaxsph.topologies(scene), None, []  # the same lists, so that it is compiled once
        for _ in range(duration):
            run = jaxsph.simulate(scene, 1.0, 0.1, state=state, topologies_of_scene=found, max_speed=1.2)
            state = run.final
            out.append(np.mean(np.asarray(seen(run.states), float)[1:], axis=0))
        return out, (scene, state)

    def rows(out, particles, dtype):
        errors = [np.sqrt(np.mean((out[-1][:n, 0] - u) ** 2)), np.sqrt(np.mean((out[-1][n:, 1] - v) ** 2))]
        where = (f"{particles} x {particles}", precision(dtype))
        limit, change = limits.get((reynolds, particles)), np.sqrt(np.mean((out[-1] - out[-2]) ** 2))
        return [
            Row(f"rms of u and v from finite elements / U, Re {reynolds}", float(max(errors)), limit, *where),
            Row(f"rms change of the mean in the last L / U, Re {reynolds}", float(change), None, *where),
        ]

    if quick:
        yield rows(means(25, np.float32, ladder[0][1])[0], 25, np.float32)
        return
    start = None
    for particles, duration in ladder:
        out, start = means(particles, np.float32, duration, start)
        yield rows(out, particles, np.float32)
        if particles == 50:
            yield rows(means(50, np.float64, 5, start)[0], 50, np.float64)


CASES = [
    Case("F01", "Taylor-Green vortex, Re 100", taylor_green),
    Case("F03", "Poiseuille flow from rest", lambda quick: start_up("poiseuille", quick)),
    Case("F04", "Couette flow from rest", lambda quick: start_up("couette", quick)),
    Case("F06", "Lid-driven cavity, Re 100", lambda quick: cavity(100, quick)),
    Case("F07", "Lid-driven cavity, Re 1000", lambda quick: cavity(1000, quick)),
]
