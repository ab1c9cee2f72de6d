"""Two soft spheres fall into water: the light one floats, the heavy one sinks to the floor.

They are colored by their first Piola-Kirchhoff stress, the water by its speed. Once at rest the light sphere must float
with half its area below the surface, as its density is half that of water.

    python examples/fsi/falling_spheres.py --spacing 0.02
    python examples/fsi/falling_spheres.py --dimension 3 --spacing 0.05
"""

import argparse
from pathlib import Path

import numpy as np

import jaxsph as sph
from jaxsph import plot

PICTURE = "out/falling_spheres_{}d.png"


def main(spacing=0.025, t_end=1.0, dimension=2, out=None, animation=None, picture=None):
    """Run the fall with particles at this spacing [m] to t_end [s]; return the run."""
    scene = sph.scenes.falling_spheres(spacing, dimension=dimension, dtype=np.float32)
    print(scene)
    run = sph.simulate(scene, t_end, t_end / 100, progress=True, out=out)
    times = np.asarray(run.times)
    for sphere in scene.structures:
        height = np.asarray(run.positions(sphere.name), float)[..., -1].mean(axis=1)
        speed = np.asarray(run[sphere.name]["velocity"], float)[..., -1].mean(axis=1)
        print(f"{sphere.name}: fastest fall {-speed.min():.2f} m/s, lowest center {height.min():.3f} m at "
              f"{times[height.argmin()]:.2f} s, now {height[-1]:.3f} m")  # fmt: skip
    view, shown = None, None
    if dimension == 3:  # the tank would hide the rest
        view, shown = (30, 10), ["water", *(sphere.name for sphere in scene.structures)]
    figure = plot.moments(run, t_end * np.array([0.0, 0.4, 0.6, 1]), shown, color="pk1", columns=4, view=view)
    picture = PICTURE.format(dimension) if picture is None else picture
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)
    if animation:
        run.animate(animation, color="pk1")
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--spacing", type=float, default=0.025, help="[m] (0.025)")
    parser.add_argument("--t-end", type=float, default=1.0, help="[s] (1)")
    parser.add_argument("--dimension", type=int, default=2, choices=(2, 3))
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--animation", help="GIF to write")
    parser.add_argument("--picture", help=f"({PICTURE.format('2')})")
    main(**vars(parser.parse_args()))
