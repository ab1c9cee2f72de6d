"""Free vibrations of a clamped plate: what particles on its surface and the smoothing length do to its stiffness.

The stiffness is that of jaxsph itself: the derivative of `elastic_acceleration` at rest, assembled from products
with probing vectors. Its lowest frequency is compared with finite elements for the plate of Gray et al. (2001),
clamped at its face. No time stepping: the error is that of the discretization in space alone.

    python examples/modal_analysis.py --json docs/results/modal.json --picture docs/images/modal_analysis.png
"""

import argparse
import json
import platform
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import eigs

import jaxsph as sph
from jaxsph.elastic_forces import displacement_gradient, elastic_acceleration
from jaxsph.structure import reference, topology

# J. P. Gray, J. J. Monaghan, R. P. Swift (2001), Comput. Methods Appl. Mech. Eng. 190, 6641.
LENGTH, THICKNESS = 0.2, 0.02  # m
DENSITY, YOUNGS_MODULUS, POISSON_RATIO = 1000.0, 2e6, 0.3975  # kg/m^3, Pa, 1
PERIOD = 0.2551460  # s: first mode, plane strain, face clamped, by converged finite elements
ROOT = 4  # clamped columns behind the outermost, which lies half a spacing in front of the face: enough for any h here
PARTICLES = (5, 10, 20)  # across the thickness
PENALTY = 0.05  # as in jaxsph.scenes.cantilever
SLOW = 50.0  # Hz: two modes of the plate are slower (3.9 and 23.3 Hz), the third has 60 Hz

CASES = (  # where the particles are, and h in spacings
    ("cell centers", (1.2,)),
    ("on the surface, full volumes", (1.4142,)),
    ("on the surface, half volumes", (1.4142, 1.2, 1.0, 0.9, 0.87, 0.85, 0.8)),
    ("the same, clamped in the face", (0.87,)),
)


def plate(arrangement, across, smoothing_length):
    """The plate with `across` particles over its thickness; the smoothing length is in spacings."""
    in_face = arrangement == "the same, clamped in the face"
    if arrangement == "cell centers" or in_face:
        dx = THICKNESS / (across - in_face)
        low, size = (-ROOT * dx, -THICKNESS / 2), (LENGTH + ROOT * dx, THICKNESS)
        body = sph.box(low, size, dx, on_surface=in_face, dtype=np.float64)
    else:
        body = sph.clamped_strip(LENGTH, THICKNESS, across, ROOT, dtype=np.float64)
        dx = body.spacing
    if arrangement == "on the surface, full volumes":
        body = sph.Particles(body.positions, np.full(len(body), np.max(body.volumes)), dx)
    return sph.Structure(
        "plate",
        body,
        DENSITY,
        YOUNGS_MODULUS,
        POISSON_RATIO,
        clamped=lambda x: x[:, 0] < (0.01 if in_face else 1) * dx,
        smoothing_length=smoothing_length * dx,
    )


def stiffness(structure, penalty=None):
    """Stiffness matrix K [N/m] and mass matrix M [kg] of the free particles, all x first, then all y.

    A particle feels others up to two support radii away, by the penalty force up to three. Particles further apart than
    that on the lattice share a probing vector, so that some hundred products give the whole matrix.
    """
    found = topology(structure)
    ready = reference(structure, found, penalty=penalty is not None)
    positions, dx = np.asarray(ready.positions), structure.particles.spacing
    n = positions.shape[1]
    # the lattice is stretched a little along the plate
    place = np.stack([np.unique(np.round(along / dx, 3), return_inverse=True)[1] for along in positions])
    support = int(np.ceil(structure.kernel.support_radius(float(structure.smoothing_length)) / dx - 1e-6) - 1)
    reach = (2 if penalty is None else 3) * support
    period = 2 * reach + 1
    grid = np.full(place.max(axis=1) + 1 + 2 * reach, -1)
    grid[tuple(place + reach)] = np.arange(n)

    @jax.jit
    def acceleration(direction):
        forces = lambda u: elastic_acceleration(structure, ready, u, penalty, forward_mode=True)  # noqa: E731
        return jax.jvp(forces, (jnp.zeros_like(direction),), (direction,))[1]

    rows, columns, values = [], [], []
    mass = np.asarray(structure.density * ready.volume)
    for color in np.ndindex(period, period):
        probed = np.all(place % period == np.array(color)[:, None], axis=0)
        # The one probed particle that each particle can feel, -1 for none.
        offset = (np.array(color)[:, None] - place + reach) % period - reach
        source = grid[tuple(place + offset + reach)]
        felt = source >= 0
        for k in range(2):
            image = np.asarray(acceleration(jnp.zeros((2, n)).at[k].set(probed)))
            for i in range(2):
                rows.append(i * n + np.flatnonzero(felt))
                columns.append(k * n + source[felt])
                values.append(-(mass * image[i])[felt])
    matrix = sparse.csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (2 * n, 2 * n)
    )
    free = np.tile(np.asarray(ready.moving) > 0, 2)
    return matrix[free][:, free], sparse.diags(np.tile(mass, 2)[free])


def frequencies(matrix, mass, modes):
    """The lowest frequencies of free vibration [Hz], rising."""
    squared = np.asarray(eigs(matrix, k=modes, M=mass, sigma=0, return_eigenvectors=False))
    return np.sort(np.sqrt(squared.real)) / (2 * np.pi)


def bending_error(structure):
    """Error of the frequency by the bending stiffness and the mass of a cross-section alone.

    The stiffness goes with the sum of V H_xx^2, where H_xx = y for the displacement u_x = x y. A particle without
    neighbors on one side gets the H_xx of a place further in.
    """
    ready = reference(structure, topology(structure), penalty=False)
    x, y = ready.positions
    h_xx = np.asarray(displacement_gradient(ready, jnp.stack([x * y, 0 * x]))[0, 0])
    columns = np.unique(np.round(x / structure.particles.spacing, 3))
    step = (np.max(x) - np.min(x)) / (len(columns) - 1)
    middle = np.abs(x - x[np.argmin(np.abs(x - LENGTH / 2))]) < 0.01 * step
    height = np.asarray(ready.volume)[middle] / step  # of the layer that each particle stands for
    return float(np.sqrt((height @ h_xx[middle] ** 2 / (THICKNESS**3 / 12)) / (height.sum() / THICKNESS)) - 1)


def row(arrangement, h):
    """One line of the table: errors in percent of the first frequency, by particles across."""
    out = {"id": f"modal {arrangement} {h:g}", "machine": platform.machine(), "case": arrangement, "h": h}
    for across in PARTICLES:
        structure = plate(arrangement, across, h)
        matrix, mass = stiffness(structure, sph.PenaltyForce(PENALTY))
        out[f"error_{across}"] = 100 * (frequencies(matrix, mass, 1)[0] * PERIOD - 1)
        out[f"bending_{across}"] = 100 * bending_error(structure)
        if across == 10:
            out["asymmetry_penalty"] = abs(matrix - matrix.T).max() / abs(matrix).max()
            matrix, mass = stiffness(structure)
            out["asymmetry"] = abs(matrix - matrix.T).max() / abs(matrix).max()
            out["modes"] = int(np.sum(frequencies(matrix, mass, 30) < SLOW))
    return out


def draw(rows, path):
    """Errors over the smoothing length."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for color, across in enumerate(PARTICLES):
        for (case, _), style in zip(CASES, ("s", "^", "o-", "x"), strict=True):
            points = sorted((r["h"], r[f"error_{across}"]) for r in rows if r["case"] == case)
            axes.plot(*np.transpose(points), style, color=f"C{color}", label=f"{case}, {across} across", markersize=5)
    axes.axhline(0, color="0.6", linewidth=0.8)
    axes.set(xlabel="smoothing length / particle spacing", ylabel="error of the first frequency [%]")
    axes.legend(fontsize=7)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main(json_path=None, picture=None):
    """Print the table; write it as JSON and draw it where asked."""
    jax.config.update("jax_enable_x64", True)
    rows = []
    for case, lengths in CASES:
        for h in lengths:
            rows.append(row(case, h))
            print(
                ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else str(v) for k, v in rows[-1].items()), flush=True
            )
    if json_path:
        Path(json_path).write_text(json.dumps(rows, indent=1) + "\n")
    if picture:
        draw(rows, picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", dest="json_path", help="file for the table")
    parser.add_argument("--picture", help="file for the picture")
    main(**vars(parser.parse_args()))
