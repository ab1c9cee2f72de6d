"""A column of water falls on a cantilever beam, bends it down and runs off.

python examples/fsi/falling_column_on_beam.py --particles 16
"""

import argparse
from pathlib import Path

import numpy as np

import jaxsph as sph
from jaxsph import plot


def main(particles=10, across=5, t_end=0.3, out=None, animation=None, picture="out/falling_column_on_beam.png"):
    """Run with this many particles over the width of the column to t_end [s]; return the run."""
    scene = sph.scenes.falling_column_on_beam(particles, across, dtype=np.float32)
    print(scene)
    run = sph.simulate(scene, t_end, t_end / 60, progress=True, out=out)
    tip = np.asarray(run.probe("beam", (0.35, 0.0)).displacement, float)
    lowest = int(np.argmin(tip[:, 1]))
    print(f"the tip is lowest at {float(run.times[lowest]):.3f} s, {-1e3 * tip[lowest, 1]:.0f} mm below its place")
    figure = plot.moments(run, t_end * np.array([0.0, 0.25, 0.5, 1]), color="pk1", columns=4)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)
    if animation:
        run.animate(animation, color="pk1")
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=10, help="over the width of the column (10)")
    parser.add_argument("--across", type=int, default=5, help="over the thickness of the beam (5)")
    parser.add_argument("--t-end", type=float, default=0.3, help="[s] (0.3)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--animation", help="GIF to write")
    parser.add_argument("--picture", default="out/falling_column_on_beam.png")
    main(**vars(parser.parse_args()))
