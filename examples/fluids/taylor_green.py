"""Taylor-Green vortices that decay by viscosity, in a periodic square, or in a cube where they also break up.

In 2D the kinetic energy is compared with the exact exp(-16 pi^2 t / Re), the speed of the particles with the exact
field. In 3D only the start is known, 1/8 exp(-24 pi^2 t / Re): from there on stretching makes the decay faster.

    python examples/fluids/taylor_green.py --dimension 3 --particles 20
"""

import argparse
from pathlib import Path

import matplotlib.figure
import numpy as np

import jaxsph as sph
from jaxsph import plot

REYNOLDS = 100.0


def main(particles=40, t_end=1.0, dimension=2, out=None, picture=None):
    """Run the vortices with `particles` along an edge to t_end [s]; return the run."""
    scene = sph.scenes.taylor_green(particles, reynolds=REYNOLDS, dimension=dimension)
    run = sph.simulate(scene, t_end, t_end / 20, progress=True, out=out)
    times = np.asarray(run.times, float)
    energy = np.asarray(run.observe(sph.observe.energies)["kinetic"], float)
    exact = 0.25 / (dimension - 1) * np.exp(-8 * dimension * np.pi**2 * times / REYNOLDS)
    known = "exact" if dimension == 2 else "without stretching"
    print(f"kinetic energy at {t_end:g} s: {energy[-1]:.4f}, {known} {exact[-1]:.4f}")
    if dimension == 2:
        x, y = 2 * np.pi * np.asarray(run.final.systems["water"]["position"], float).T
        speed = np.hypot(np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)) * np.exp(-8 * np.pi**2 * t_end / REYNOLDS)
        found = np.linalg.norm(np.asarray(run.final.systems["water"]["velocity"], float), axis=1)
        print(f"relative L1 error of the speed: {100 * np.sum(np.abs(found - speed)) / np.sum(speed):.2f} %")
    draw(run, times, energy, exact, known, picture or f"out/taylor_green_{dimension}d.png")
    return run


def draw(run, times, energy, exact, known, picture):
    figure = matplotlib.figure.Figure(figsize=(13, 3.6), layout="constrained", dpi=130)
    *panels, graph = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.1))
    view = None if run.scene.dimension == 2 else (-30, 25)
    plot.moments(run, times[-1] * np.array([0, 0.5, 1]), color="velocity", view=view, axes=panels)
    graph.semilogy(times, exact, "k-", lw=1, label=known)
    graph.semilogy(times, energy, "o", ms=4, label="SPH")
    graph.set(xlabel="time [s]", ylabel="kinetic energy / (density U$^2$ volume)")
    graph.legend(frameon=False)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=40, help="along an edge (40)")
    parser.add_argument("--t-end", type=float, default=1.0, help="[s] (1)")
    parser.add_argument("--dimension", type=int, default=2, choices=(2, 3))
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--picture", help="file for the picture")
    main(**vars(parser.parse_args()))
