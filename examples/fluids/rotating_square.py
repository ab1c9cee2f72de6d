"""A square of fluid that spins freely: its corners become arms, and its middle is under tension.

The pressure in the middle, soon after the start, is compared with the Poisson equation's -.1473 rho w^2 L^2; angular
momentum and area must stay. Shifted particles and the control of tension keep it from tearing.

    python examples/fluids/rotating_square.py --particles 60
"""

import argparse
from pathlib import Path

import numpy as np

import jaxsph as sph
from jaxsph import observe, plot


def main(particles=40, t_end=3.0, out=None, picture="out/rotating_square.png"):
    """Run the square with `particles` along an edge to t_end [s], at 1 rad/s; return the run."""
    scene = sph.scenes.rotating_square(particles)
    run = sph.simulate(scene, t_end, t_end / 30, progress=True, out=out)
    middle = run.observe(lambda scene, state: observe.interpolate(scene, state, "water", "pressure", [[0.0, 0.0]])[0])
    spin = np.asarray(run.observe(observe.angular_momentum), float)
    density = np.asarray(scene["water"].density + run["water"]["density_deviation"], float)
    area = np.sum(np.asarray(scene["water"].mass()) / density, axis=1)
    print(f"pressure in the middle at {run.times[1]:.2f} s: {middle[1]:.1f} Pa, exact -147.3 Pa")
    print(f"angular momentum changes by {100 * (spin[-1] / spin[0] - 1):+.2f} %, area by {100 * (area[-1] - 1):+.2f} %")
    figure = plot.moments(run, t_end * np.array([0.1, 0.4, 0.7, 1]), columns=4)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=40, help="along an edge (40)")
    parser.add_argument("--t-end", type=float, default=3.0, help="[s] (3)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--picture", default="out/rotating_square.png")
    main(**vars(parser.parse_args()))
