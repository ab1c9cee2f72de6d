"""A column of water twice as high as wide collapses, runs along the floor, and climbs the far wall.

The surge front is compared with what Martin and Moyce (1952) measured, T = t sqrt(2 g / a) and Z = x / a, a the width.
With --depth, tank and column have that depth: the same in 3D.

    python examples/fluids/dam_break.py --depth 0.1 --particles 14 --t-end 0.5
"""

import argparse
from pathlib import Path

import matplotlib.figure
import numpy as np

import jaxsph as sph
from jaxsph import observe, plot

WIDTH, GRAVITY = 0.146, 9.81  # m, m/s^2
MEASURED_T = (0.832, 1.219, 1.997, 2.547, 3.345)
MEASURED_Z = (1.217, 1.474, 2.292, 2.995, 4.134)


def main(particles=28, t_end=0.8, depth=None, out=None, picture=None):
    """Run the collapse with `particles` over the height to t_end [s]; return the run."""
    scene = sph.scenes.dam_break(
        particles, height=2 * WIDTH, width=WIDTH, tank_length=4 * WIDTH, tank_height=7 * WIDTH, depth=depth
    )
    run = sph.simulate(scene, t_end, t_end / 80, progress=True, out=out)
    front = np.asarray(run.observe(lambda scene, state: observe.surge_front(scene, state, "water"))) / WIDTH
    unit = np.sqrt(WIDTH / (2 * GRAVITY))
    for when, where in zip(MEASURED_T, MEASURED_Z, strict=True):
        if when * unit <= t_end and where < 3.8:
            print(f"front at T = {when:.2f}: Z = {np.interp(when * unit, run.times, front):.2f}, measured {where:.2f}")
    draw(run, np.asarray(run.times) / unit, front, picture or f"out/dam_break_{scene.dimension}d.png")
    return run


def draw(run, times, front, picture):
    figure = matplotlib.figure.Figure(figsize=(13, 4.4), layout="constrained", dpi=130)
    *panels, graph = figure.subplots(1, 5, width_ratios=(1, 1, 1, 1, 1.6))
    name, view = (None, None) if run.scene.dimension == 2 else ("water", (-25, 20))
    moments = float(run.times[-1]) * np.array([0.25, 0.35, 0.6, 1])
    plot.moments(run, moments, name, "velocity", view=view, axes=panels)
    graph.plot(times[front < 3.98], front[front < 3.98], label="SPH")
    graph.plot(MEASURED_T, MEASURED_Z, "o", color="k", mfc="none", label="Martin and Moyce")
    graph.set(xlabel=r"$t\ \sqrt{2g/a}$", ylabel="surge front / a")
    graph.legend(frameon=False)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=28, help="over the height, even (28)")
    parser.add_argument("--t-end", type=float, default=0.8, help="[s] (0.8)")
    parser.add_argument("--depth", type=float, help="of column and tank [m], for 3D")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--picture", help="file for the picture")
    main(**vars(parser.parse_args()))
