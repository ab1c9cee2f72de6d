"""A drop in a force field towards its center is stretched along x and along y in turn, and stays an ellipse.

Its semi-axes, from second moments, are compared with the solution of Monaghan and Rafiee (2013).

    python examples/fluids/oscillating_drop.py --particles 40
"""

import argparse
from pathlib import Path

import matplotlib.figure
import numpy as np
from scipy.integrate import solve_ivp

import jaxsph as sph
from jaxsph import plot

RATE, FREQUENCY = 0.5, 1.0  # 1/s, rad/s


def exact(times):
    """Semi-axes (2, T) over the radius; the velocity is (s x, -s y)."""
    bend = lambda s, a, b: (s**2 + FREQUENCY**2) * (b**2 - a**2) / (a**2 + b**2)  # noqa: E731
    slopes = lambda t, state: (bend(*state), state[0] * state[1], -state[0] * state[2])  # noqa: E731
    return solve_ivp(slopes, (0, times[-1]), [RATE, 1, 1], t_eval=times, rtol=1e-9, atol=1e-9).y[1:]


def main(particles=20, t_end=4.6, out=None, picture="out/oscillating_drop.png"):
    """Run the drop with `particles` along its radius to t_end [s], a period by default; return the run."""
    scene = sph.scenes.oscillating_drop(particles, rate=RATE, frequency=FREQUENCY)
    run = sph.simulate(scene, t_end, t_end / 80, progress=True, out=out)
    times, moment = np.linspace(0, t_end, 81), np.var(np.asarray(run["water"]["position"], float), axis=1)
    found, known = np.sqrt(moment / moment[0]).T, exact(times)
    print(f"largest error of a semi-axis: {np.abs(found - known).max():.4f} radii")
    draw(run, times, found, known, picture)
    return run


def draw(run, times, found, known, picture):
    figure = matplotlib.figure.Figure(figsize=(13, 3.3), layout="constrained", dpi=130)
    *panels, graph = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.2))
    plot.moments(run, times[-1] * np.array([0, 0.25, 0.75]), axes=panels)
    for k, name in enumerate("ab"):
        graph.plot(times, known[k], "k-", lw=1, label="exact" if k == 0 else None)
        graph.plot(times[::4], found[k, ::4], "o", ms=4, label=f"SPH, {name}")
    graph.set(xlabel="time [s]", ylabel="semi-axis [m]")
    graph.set_ylim(0.65, 1.7)
    graph.legend(frameon=False, ncols=3)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=20, help="along the radius (20)")
    parser.add_argument("--t-end", type=float, default=4.6, help="[s] (4.6)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--picture", default="out/oscillating_drop.png")
    main(**vars(parser.parse_args()))
