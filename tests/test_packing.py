"""Packing: disordered particles become evenly spread and stay in their shape."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxsph as sph
from jaxsph.geometry import ball, box, jitter, tank


def nearest(x, period=None):
    offset = x[:, None] - x[None]
    if period is not None:
        offset = offset - period * np.round(offset / period)
    return np.sqrt(np.min(np.sum(offset**2, axis=-1) + 1e9 * np.eye(len(x)), axis=1))


def residuals_fall(packed, factor):
    assert packed.residuals[-1] < packed.residuals[0] / factor
    assert np.isfinite(packed.residuals).all()


def test_a_periodic_box():
    start = jitter(box((0, 0), (1, 1), 0.05), 0.3, 0)
    packed = sph.relax(start, domain=sph.Domain((0, 0), (1, 1), True), iterations=200)
    residuals_fall(packed, 20)
    x = packed.particles.positions
    assert nearest(start.positions, 1.0).min() < 0.5 * 0.05 and nearest(x, 1.0).min() > 0.8 * 0.05
    np.testing.assert_array_equal(packed.particles.volumes, start.volumes)


def test_walls_keep_particles_in_a_box():
    start = jitter(box((0, 0), (0.5, 0.5), 0.05), 0.3, 0)
    walls = tank((0, 0), (0.5, 0.5), 0.05, 4, sides=["left", "right", "bottom", "top"])
    packed = sph.relax(start, walls=walls, iterations=200)
    residuals_fall(packed, 20)
    x = packed.particles.positions
    assert np.all((x > 0.01) & (x < 0.49))  # the wall's own particles are .025 outside


def test_a_disk_stays_a_disk():
    """The lattice's steps at the rim go, and nobody leaves."""
    start = ball((0.2, 0.1), 0.5, 0.05)

    def distance(x):
        return jnp.sqrt(jnp.sum((x - jnp.array([0.2, 0.1])) ** 2)) - 0.5

    packed = sph.relax(start, distance=distance, iterations=300)
    residuals_fall(packed, 2)  # mirror images at a curved surface stand a little wider than the particles
    radius = np.linalg.norm(packed.particles.positions - [0.2, 0.1], axis=1)
    assert radius.max() < 0.475 + 1e-9
    rim = lambda r: r[r > 0.5 - 0.05]  # noqa: E731
    before = np.linalg.norm(start.positions - [0.2, 0.1], axis=1)
    assert np.std(rim(radius)) < 0.6 * np.std(rim(before)), "the outermost layer follows the rim"


def test_fixed_particles_stay():
    start = jitter(box((0, 0), (0.5, 0.5), 0.05), 0.2, 0)
    edge = np.any(np.abs(start.positions - 0.25) > 0.1, axis=1)
    packed = sph.relax(start, fixed=edge, iterations=50)
    np.testing.assert_array_equal(packed.particles.positions[edge], start.positions[edge])
    assert packed.residuals[-1] < packed.residuals[0]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "nothing keeps the particles"),
        ({"fixed": np.zeros(3, bool)}, r"fixed has shape \(3,\); it must be \(16,\)"),
        ({"distance": lambda x: x[0]}, "outside of the shape"),
        ({"domain": sph.Domain((0, 0), (1, 1), True), "iterations": 0}, "iterations = 0 must be at least 1"),
        ({"domain": sph.Domain((0, 0), (1, 1), True), "smoothing_length": -1.0}, "smoothing_length"),
    ],
)
def test_refused(options, said):
    with pytest.raises(ValueError, match=said):
        sph.relax(box((0, 0), (1, 1), 0.25), **options)
