"""The falling spheres as rigid bodies: the light one floats, the heavy one sinks.

python examples/fsi/falling_rigid_spheres.py --spacing 0.02
"""

import argparse
from pathlib import Path

import numpy as np

import jaxsph as sph
from jaxsph import plot


def main(spacing=0.025, t_end=1.0, out=None, animation=None, picture="out/falling_rigid_spheres.png"):
    """Run the fall with particles at this spacing [m] to t_end [s]; return the run."""
    scene = sph.scenes.falling_rigid_spheres(spacing, dtype=np.float32)
    print(scene)
    run = sph.simulate(scene, t_end, t_end / 100, progress=True, out=out)
    for sphere in scene.rigid_bodies:
        places = np.asarray(run.positions(sphere.name), float)
        height = places[..., -1].mean(axis=1)
        apart = np.linalg.norm(places[:, :1] - places, axis=-1)
        print(f"{sphere.name}: center from {height[0]:.3f} to {height[-1]:.3f} m, lowest {height.min():.3f} m; "
              f"its shape off by {np.abs(apart - apart[0]).max():.1e} m")  # fmt: skip
    figure = plot.moments(run, t_end * np.array([0.0, 0.4, 0.6, 1]), color="velocity", columns=4)
    Path(picture).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture)
    if animation:
        run.animate(animation, color="velocity")
    return run


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--spacing", type=float, default=0.025, help="[m] (0.025)")
    parser.add_argument("--t-end", type=float, default=1.0, help="[s] (1)")
    parser.add_argument("--out", help="VTKHDF file to write")
    parser.add_argument("--animation", help="GIF to write")
    parser.add_argument("--picture", default="out/falling_rigid_spheres.png")
    main(**vars(parser.parse_args()))
