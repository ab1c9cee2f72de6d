"""F01 to F07: flows that fill their domain, against exact solutions and finite elements."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import numpy as np
from reference import table
from rows import Case, Row, precision

import jaxsph


def fields_at(run, name: str, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (N, d) of a fluid at a saved state."""
    fields = run[name]
    return np.asarray(fields["position"][index], float), np.asarray(fields["velocity"][index], float)


def taylor_green(quick: bool) -> Iterator[list[Row]]:
    """Decay at Re 100 to t = 1: L1 error of the speed, viscosity from the kinetic energy between t = .2 and 1."""
    reynolds, errors = 100.0, {}
    runs = [(25, np.float32), (50, np.float32), (100, np.float32), (50, np.float64)]
    for particles, dtype in runs[:1] if quick else runs:
        scene = jaxsph.scenes.taylor_green(particles, reynolds=reynolds, dtype=dtype)
        run = jaxsph.simulate(scene, 1.0, 0.05)
        position, velocity = fields_at(run, "water", -1)
        k = 2 * np.pi
        u = -np.cos(k * position[:, 0]) * np.sin(k * position[:, 1])
        v = np.sin(k * position[:, 0]) * np.cos(k * position[:, 1])
        exact = np.hypot(u, v) * np.exp(-8 * np.pi**2 / reynolds)
        error = float(np.sum(np.abs(np.linalg.norm(velocity, axis=1) - exact)) / np.sum(exact))
        times = np.asarray(run.times, float)
        energy = np.sum(np.asarray(run["water"]["velocity"], float) ** 2, axis=(1, 2))
        late = times > 0.19
        slope = np.polyfit(times[late], np.log(energy[late]), 1)[0]
        effective = -slope / (16 * np.pi**2) * reynolds - 1
        where = (f"{particles} x {particles}", precision(dtype))
        limits = (0.03, 0.02) if particles == 50 else (None, None)
        yield [
            Row("relative L1 error of the speed, t = 1", error, limits[0], *where),
            Row("|effective / physical viscosity - 1|", abs(effective), limits[1], *where),
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
    """Root mean square of the difference from the finite-element velocities on both center lines, the time's mean."""
    lines = [line for line in table("fluid/cavity_fem_centrelines.csv") if line["Re"] == str(reynolds)]
    place = np.array([float(line["coord"]) for line in lines])
    inside = (place > 0) & (place < 1)
    u, v = (np.array([float(line[name]) for line in lines])[inside] for name in ("u_at_x0.5", "v_at_y0.5"))
    half = np.full(inside.sum(), 0.5)
    points = np.concatenate([np.stack([half, place[inside]], 1), np.stack([place[inside], half], 1)])
    limits = {(100, 50): 0.01, (100, 100): 0.006, (1000, 100): 0.03}
    t_end = {100: 15.0, 1000: 40.0}[reynolds]
    seen = jax.jit(jax.vmap(lambda scene, s: jaxsph.observe.interpolate(scene, s, "water", "velocity", points, order=1),
                            (None, 0)))  # fmt: skip
    for particles in (25,) if quick else ((50, 100) if reynolds == 100 else (100,)):
        scene = jaxsph.scenes.lid_driven_cavity(particles, reynolds=reynolds, dtype=np.float32)
        state, left = None, t_end
        while left > 1.5:
            state = jaxsph.simulate(scene, 1.0, 1.0, state=state).final
            left -= 1.0
        run = jaxsph.simulate(scene, 1.0, 0.1, state=state)
        mean = np.mean(np.asarray(seen(scene, run.states), float), axis=0)
        n = len(u)
        errors = [float(np.sqrt(np.mean((mean[:n, 0] - u) ** 2))), float(np.sqrt(np.mean((mean[n:, 1] - v) ** 2)))]
        figure = f"rms of u and v from finite elements / U, Re {reynolds}"
        limit = limits.get((reynolds, particles))
        yield [Row(figure, max(errors), limit, f"{particles} x {particles}", "float32")]


CASES = [
    Case("F01", "Taylor-Green vortex, Re 100", taylor_green),
    Case("F03", "Poiseuille flow from rest", lambda quick: start_up("poiseuille", quick)),
    Case("F04", "Couette flow from rest", lambda quick: start_up("couette", quick)),
    Case("F06", "Lid-driven cavity, Re 100", lambda quick: cavity(100, quick)),
    Case("F07", "Lid-driven cavity, Re 1000", lambda quick: cavity(1000, quick)),
]
