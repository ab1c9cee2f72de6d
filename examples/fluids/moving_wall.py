"""A wall pushes still water along a tank, and a bore runs ahead of it.

Depth behind it and its speed are compared with the jump of shallow water: U = (h - h0) sqrt(g (h + h0) / (2 h h0)) for
a wall of speed U, and h U / (h - h0) for the bore. A weak bore, as this, carries waves on its back.

    python examples/fluids/moving_wall.py --particles 20 --speed 0.8
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

import jaxsph as sph
from jaxsph import observe, plot

DEPTH, LENGTH, GRAVITY = 0.5, 4.0, 9.81


def main(particles=12, t_end=1.2, speed=0.6, out=None, picture="out/moving_wall.png"):
    """Run the wall at `speed` [m/s], with `particles` over the depth, to t_end [s]; return the run."""
    scene = sph.scenes.moving_wall(particles, depth=DEPTH, length=LENGTH, speed=speed)
    run = sph.simulate(scene, t_end, t_end / 40, progress=True, out=out)
    jump = lambda h: (h - DEPTH) * np.sqrt(GRAVITY * (h + DEPTH) / (2 * h * DEPTH)) - speed  # noqa: E731
    behind = float(brentq(jump, DEPTH, 5 * DEPTH))  # type: ignore[arg-type]
    x = np.linspace(0, LENGTH, 400)
    depth = run.observe(lambda scene, state: observe.free_surface_height(scene, state, "water", x))
    wet = lambda h: x[np.flatnonzero(h > 0.5 * (DEPTH + behind))[-1]]  # noqa: E731
    fronts, late = np.array([wet(h) for h in np.asarray(depth[20:])]), np.asarray(run.times[20:])
    wall = float(run["wall"]["position"][-1, :, 0].max())
    mean = float(np.mean(depth[-1][(x > wall + 0.2) & (x < fronts[-1] - 0.2)]))
    bore, known = np.polyfit(late, fronts, 1)[0], speed * behind / (behind - DEPTH)
    print(f"depth behind the bore {mean:.3f} m, jump {behind:.3f} m; bore {bore:.2f} m/s, jump {known:.2f} m/s")
    figure = plot.moments(run, t_end * np.array([0.0, 0.33, 0.67, 1]), columns=2, color="velocity")
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--particles", type=int, default=12, help="over the depth (12)")
    parser.add_argument("--t-end", type=float, default=1.2, help="[s] (1.2)")
    parser.add_argument("--speed", type=float, default=0.6, help="of the wall [m/s] (0.6)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--picture", default="out/moving_wall.png")
    main(**vars(parser.parse_args()))
