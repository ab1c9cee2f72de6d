"""A lid that slides over a square cavity drives a vortex, whose center settles off the middle at Re = 100.

The velocity along the vertical center line is compared with Ghia, Ghia and Shin (1982), and so is its minimum.

    python examples/fluids/lid_driven_cavity.py --particles 50 --t-end 15
"""

import argparse
from pathlib import Path

import matplotlib.figure
import numpy as np

import jaxsph as sph
from jaxsph import observe, plot

# u(y) at x = .5 for Re = 100, table I
GHIA_Y = (0.0, 0.0547, 0.1016, 0.1719, 0.2813, 0.4531, 0.5, 0.6172, 0.7344, 0.8516, 0.9531, 0.9766, 1.0)
GHIA_U = (0, -0.03717, -0.06434, -0.1015, -0.15662, -0.2109, -0.20581, -0.13641, 0.00332, 0.23151, 0.68717, 0.84123, 1)


def main(particles=32, t_end=10.0, out=None, picture="out/lid_driven_cavity.png"):
    """Run the cavity with `particles` along an edge to t_end [s]; return the run."""
    scene = sph.scenes.lid_driven_cavity(particles, reynolds=100.0)
    run = sph.simulate(scene, t_end, t_end / 50, progress=True, out=out)
    points = observe.line((0.5, 0.02), (0.5, 0.98), 97)
    u = run.observe(lambda scene, state: observe.interpolate(scene, state, "water", "velocity", points, order=1)[:, 0])
    u = np.mean(np.asarray(u, float)[-5:], axis=0)
    lowest = int(np.argmin(u))
    print(f"lowest u on the center line: {u[lowest]:.4f} at y = {points[lowest, 1]:.3f}; Ghia et al. -0.2109 at 0.453")
    draw(run, points[:, 1], u, picture)
    return run


def draw(run, y, u, picture):
    figure = matplotlib.figure.Figure(figsize=(13, 3.6), layout="constrained", dpi=130)
    *panels, graph = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.1))
    plot.moments(run, float(run.times[-1]) * np.array([0.06, 0.3, 1]), color="velocity", axes=panels)
    graph.plot(u, y, label="SPH")
    graph.plot(GHIA_U, GHIA_Y, "o", color="k", mfc="none", ms=5, label="Ghia et al.")
    graph.set(xlabel="u at x = 0.5 m [m/s]", ylabel="y [m]")
    graph.legend(frameon=False, loc="lower right")
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=32, help="along an edge (32)")
    parser.add_argument("--t-end", type=float, default=10.0, help="[s] (10)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--picture", default="out/lid_driven_cavity.png")
    main(**vars(parser.parse_args()))
