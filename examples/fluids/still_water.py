"""Water at rest in a tank, and a narrow column of it that starts without pressure and finds it by itself.

Both are compared with the hydrostatic pressure. The column sags and rings, the lowest sound of a pipe that is open at
the top, until artificial viscosity has taken it away.

    python examples/fluids/still_water.py --particles 40
"""

import argparse
from pathlib import Path

import matplotlib.figure
import numpy as np

import jaxsph as sph
from jaxsph import observe, plot

HEIGHT, SCALE = 0.9, 1000 * 9.81 * 0.9  # m; Pa on the floor


def main(particles=20, t_end=2.0, out=None, picture="out/still_water.png"):
    """Run tank and column with `particles` over the height to t_end [s]; return the runs by name."""
    dx, width = HEIGHT / particles, round(particles / 4) * HEIGHT / particles
    narrow = sph.scenes.column_in_tank((width, HEIGHT), (width, round(1.2 * particles) * dx), dx, hydrostatic=False)
    scenes = {"tank": sph.scenes.still_water(particles, height=HEIGHT), "column": narrow}
    runs = {}
    for name, scene in scenes.items():
        run = runs[name] = sph.simulate(scene, t_end, t_end / 200, progress=True, out=out and out.format(name))
        water, pressure = run.final.systems["water"], observe.pressure(scene, run.final, "water")
        exact = SCALE * (1 - water["position"][:, 1] / HEIGHT)
        error, speed = np.linalg.norm(pressure - exact) / np.linalg.norm(exact), np.abs(water["velocity"]).max()
        print(f"{name}: error of the pressure {100 * error:.2f} %, speed left {1e3 * speed:.3g} mm/s")
    draw(runs, picture)
    return runs


def draw(runs, picture):
    figure = matplotlib.figure.Figure(figsize=(13, 3.8), layout="constrained", dpi=130)
    tank, profile, floor = figure.subplots(1, 3)
    plot.moments(runs["tank"], runs["tank"].times[-1:], axes=[tank])
    sensor = lambda scene, state: observe.wall_pressure(scene, state, "tank", [[0.1, 0.0]])[0]  # noqa: E731
    for run in runs.values():
        pressure = observe.pressure(run.scene, run.final, "water")
        profile.plot(1e-3 * pressure, run.final.systems["water"]["position"][:, 1], "o", ms=3)
        floor.plot(run.times, 1e-3 * run.observe(sensor))
    profile.plot([0, 1e-3 * SCALE], [HEIGHT, 0], "k-", lw=1)
    profile.legend([*runs, "hydrostatic"], frameon=False)
    profile.set(xlabel="pressure [kPa]", ylabel="y [m]")
    floor.set(xlabel="time [s]", ylabel="pressure on the floor [kPa]")
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=20, help="over the height (20)")
    parser.add_argument("--t-end", type=float, default=2.0, help="[s] (2)")
    parser.add_argument("--out", help="VTKHDF file to write, with {} for the name")
    parser.add_argument("--picture", default="out/still_water.png")
    main(**vars(parser.parse_args()))
