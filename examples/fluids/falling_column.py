"""A column of water falls into a pool and throws a crown up on both sides.

Until it lands, after sqrt(2 drop / g), its center must fall as any body does; in the end the energy that is missing
has been taken by the impact. No particle may leave the tank.

    python examples/fluids/falling_column.py --particles 40
"""

import argparse
from pathlib import Path

import numpy as np

import jaxsph as sph
from jaxsph import observe, plot

DROP, POOL, HEIGHT, WIDTH, GRAVITY = 0.2, 0.1, 0.4, 0.2, 9.81


def main(particles=24, t_end=0.7, out=None, picture="out/falling_column.png"):
    """Run the fall with `particles` over the height of the column to t_end [s]; return the run."""
    scene = sph.scenes.falling_column(particles, height=HEIGHT, width=WIDTH, drop=DROP, pool=POOL)
    # The jets of the impact are several times faster than the column: half the largest stable step.
    step = 0.5 * sph.stable_time_step(scene)
    run = sph.simulate(scene, t_end, t_end / 70, time_step=step, progress=True, out=out)
    column = np.asarray(scene["water"].particles.positions)[:, 1] > POOL + 0.5 * DROP
    center = np.mean(np.asarray(run["water"]["position"], float)[:, column, 1], axis=1)
    times, landing = np.asarray(run.times, float), np.sqrt(2 * DROP / GRAVITY)
    before = times < 0.8 * landing
    error = np.abs(center - center[0] + 0.5 * GRAVITY * times**2)[before].max()
    print(f"center of the column: off the free fall by {1e3 * error:.2f} mm until {0.8 * landing:.2f} s")
    total = np.asarray(run.observe(observe.energies)["total"], float)
    print(f"energy lost in the impact: {100 * (1 - total[-1] / total[0]):.0f} % of what is above the floor")
    figure = plot.moments(run, t_end * np.array([0.0, 0.3, 0.4, 0.55, 0.75, 1]), color="velocity", columns=3)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=24, help="over the height of the column (24)")
    parser.add_argument("--t-end", type=float, default=0.7, help="[s] (0.7)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--picture", default="out/falling_column.png")
    main(**vars(parser.parse_args()))
