"""Particles fill shapes with the right volume and places; what does not fit is refused with numbers."""

import numpy as np
import pytest

from jaxsph import Particles, ball, box, clamped_strip, jitter

SIZES = {2: (0.3, 0.2), 3: (0.3, 0.2, 0.1)}
CORNERS = {2: (-0.1, 0.4), 3: (-0.1, 0.4, 2.0)}

in_2d_and_3d = pytest.mark.parametrize("d", [2, 3])


@in_2d_and_3d
@pytest.mark.parametrize("on_surface", [False, True])
def test_cells_are_whole_ones_on_a_surface_too(d, on_surface):
    filled = box(CORNERS[d], SIZES[d], 0.05, on_surface=on_surface)
    np.testing.assert_allclose(filled.cells, 0.05**d, rtol=1e-12)  # products of d numbers, rounded
    moved = jitter(filled.where(filled.positions[:, 0] > 0) | filled, 0.1, 0)
    np.testing.assert_allclose(moved.cells, 0.05**d, rtol=1e-12)


def test_volumes_of_particles_that_are_not_said_to_lie_on_a_surface_stay_what_they_are():
    graded = Particles(np.zeros((3, 2)) + np.arange(3)[:, None], np.array([0.25, 0.5, 1.0]), 1.0)
    np.testing.assert_array_equal(graded.cells, graded.volumes)


@pytest.mark.parametrize("across", [2, 3])
def test_cells_of_a_strip_are_whole_ones_of_its_stretched_lattice(across):
    strip = clamped_strip(0.47, 0.1, across)
    column = np.unique(strip.positions[:, 0])
    np.testing.assert_allclose(strip.cells, strip.spacing * (column[1] - column[0]), rtol=1e-6)  # float32


@in_2d_and_3d
@pytest.mark.parametrize("on_surface", [False, True])
def test_box_has_its_volume_and_center(d, on_surface):
    filled = box(CORNERS[d], SIZES[d], 0.05, on_surface=on_surface)
    assert filled.volumes.sum() == pytest.approx(np.prod(SIZES[d]), rel=1e-13)  # a sum of some hundred numbers
    center = filled.volumes @ filled.positions / filled.volumes.sum()
    np.testing.assert_allclose(center, np.add(CORNERS[d], np.divide(SIZES[d], 2)), rtol=1e-13, atol=1e-14)


@in_2d_and_3d
def test_box_in_cells_or_on_its_surface(d):
    low, high = np.array(CORNERS[d]), np.add(CORNERS[d], SIZES[d])
    cells = box(CORNERS[d], SIZES[d], 0.05)
    np.testing.assert_allclose(cells.positions.min(axis=0), low + 0.025)
    np.testing.assert_allclose(cells.positions.max(axis=0), high - 0.025)
    np.testing.assert_allclose(cells.volumes, 0.05**d)
    surface = box(CORNERS[d], SIZES[d], 0.05, on_surface=True)
    np.testing.assert_allclose(surface.positions.min(axis=0), low)
    np.testing.assert_allclose(surface.positions.max(axis=0), high)
    faces = np.sum(np.isclose(surface.positions, low) | np.isclose(surface.positions, high), axis=1)
    np.testing.assert_allclose(
        surface.volumes, 0.05**d / 2.0**faces, err_msg="half a cell on a face, a quarter, an eighth"
    )


def test_second_moment_of_a_section_is_that_of_the_trapezoidal_rule():
    """Bending stiffness: sum y^2 V of n intervals is b h^3/12 (1 + 2/n^2)."""
    for n in (4, 8):
        section = box((0.0, -0.5), (1.0, 1.0), 1.0 / n, on_surface=True)
        moment = np.sum(section.positions[:, 1] ** 2 * section.volumes)
        assert moment == pytest.approx((1 + 2 / n**2) / 12, rel=1e-12)


def test_box_is_stretched_to_fill_exactly():
    filled = box((0, 0), (1.004, 1.0), 0.1, on_surface=True)
    assert filled.positions[:, 0].max() == pytest.approx(1.004)
    assert len(filled) == 11 * 11


@pytest.mark.parametrize("length", [1.0, 0.98])
def test_a_clamped_strip_has_its_column_half_a_spacing_in_front_of_the_face(length):
    """And its end, surfaces and volume, whether or not the length is a multiple of the spacing of .05 m."""
    strip = clamped_strip(length, 0.2, 5, behind=2)
    x, y = strip.positions.T
    columns = np.unique(np.round(x, 9))
    step = columns[1] - columns[0]
    assert abs(step / strip.spacing - 1) < 0.5 / 19, "half a spacing over all of them"
    np.testing.assert_allclose(columns[:3] / step, [-1.5, -0.5, 0.5], atol=1e-6)  # columns are rounded to 1e-9
    assert np.sum(columns < strip.spacing) == 3, "those that are to be clamped"
    assert (x.max(), y.min(), y.max()) == pytest.approx((length, -0.1, 0.1), rel=1e-13)
    assert strip.volumes.sum() == pytest.approx((x.max() - x.min()) * 0.2, rel=1e-13)  # a sum of a hundred numbers


def test_last_axis_runs_fastest():
    filled = box((0, 0), (0.2, 0.2), 0.1)
    np.testing.assert_allclose(filled.positions[:2], [[0.05, 0.05], [0.05, 0.15]])


@in_2d_and_3d
def test_ball(d):
    center = np.arange(1.0, d + 1)
    filled = ball(center, 0.5, 0.1)
    distance = np.linalg.norm(filled.positions - center, axis=1)
    assert distance.max() <= 0.5 * (1 + 1e-9) and distance.min() == 0
    exact = {2: np.pi / 4, 3: np.pi / 6}[d]
    assert filled.volumes.sum() == pytest.approx(exact, rel=1e-12)
    np.testing.assert_allclose(filled.positions.mean(axis=0), center, rtol=1e-13)
    # lattice points in a ball of 5 spacings: within 5 % of its volume in cells
    assert len(filled) * 0.1**d == pytest.approx(exact, rel=0.05)


def test_jitter_moves_all_a_little_and_the_same_way_for_a_seed():
    still = box((0, 0), (1, 1), 0.1)
    moved = jitter(still, 0.2, seed=3)
    shift = np.abs(moved.positions - still.positions)
    assert 0.019 < shift.max() <= 0.02, "200 draws reach .95 of the range"
    np.testing.assert_array_equal(moved.positions, jitter(still, 0.2, seed=3).positions)
    assert np.any(moved.positions != jitter(still, 0.2, seed=4).positions)


def test_sets_are_joined_and_cut():
    one, other = box((0, 0), (0.2, 0.2), 0.1), box((1, 0), (0.2, 0.1), 0.05)
    both = one | other
    assert len(both) == len(one) + len(other) and both.spacing == 0.05
    again = both.where(both.positions[:, 0] > 0.5)
    np.testing.assert_array_equal(again.positions, other.positions)
    np.testing.assert_array_equal(again.volumes, other.volumes)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_precision_is_as_asked(kind):
    for made in (box((0, 0), (1, 1), 0.5, dtype=kind), ball((0, 0), 1.0, 0.5, dtype=kind)):
        assert made.positions.dtype == kind and made.volumes.dtype == kind
        assert jitter(made, 0.1, 0).positions.dtype == kind


POINTS, VOLUMES = np.zeros((3, 2)), np.ones(3)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: box((0, 0), (1, 1), -0.1), r"spacing is -0\.1.*positive"),
        (lambda: box((0, 0), (1, 1), 0.0), r"spacing is 0\.0.*positive"),
        (lambda: box((0, 0), (1, 1), float("nan")), "spacing is nan.*finite"),
        (
            lambda: box((0, 0), (1.0, 0.95), 0.1),
            r"size\[1\] = 0\.95 .* spacing 0\.1; the nearest that fits is (0\.9|1)",
        ),
        (lambda: box((0, 0), (-1.0, 1.0), 0.1), r"size\[0\] = -1\.0 is not a positive multiple"),
        (lambda: box((0, 0), (0.001, 1.0), 0.1), r"size\[0\] = 0\.001 .*nearest that fits is 0\.1"),
        (lambda: box((0, 0), (1, 1, 1), 0.1), "2 or 3 components"),
        (lambda: box((0,), (1,), 0.1), "2 or 3 components"),
        (lambda: clamped_strip(-1.0, 0.1, 5), r"length = -1\.0 must be positive"),
        (lambda: clamped_strip(1.0, 0.1, 1), "across = 1 .* at least 2"),
        (lambda: clamped_strip(0.01, 0.1, 5), r"length = 0\.01 m is shorter than the spacing 0\.025"),
        (lambda: ball((0, 0), 0.05, 0.1), r"radius 0\.05 .* at least the particle spacing 0\.1"),
        (lambda: ball((0, 0), 1.0, -1.0), r"spacing is -1\.0"),
        (lambda: ball((0,), 1.0, 0.1), "center .* 2 or 3 components"),
        (lambda: jitter(box((0, 0), (1, 1), 0.5), -0.1, 0), r"fraction = -0\.1 .* less than 0\.5"),
        (lambda: jitter(box((0, 0), (1, 1), 0.5), 0.5, 0), r"fraction = 0\.5 .* less than 0\.5"),
        (lambda: Particles(np.zeros((0, 2)), np.zeros(0), 0.1), r"shape \(0, 2\).*N >= 1"),
        (lambda: Particles(np.zeros((3, 4)), VOLUMES, 0.1), r"shape \(3, 4\); it must be \(N, 2\) or \(N, 3\)"),
        (lambda: Particles(np.zeros(3), VOLUMES, 0.1), r"shape \(3,\)"),
        (lambda: Particles(POINTS, np.ones(4), 0.1), r"volumes has shape \(4,\); it must be \(3,\)"),
        (lambda: Particles(POINTS, np.array([1.0, 0.0, 1.0]), 0.1), r"volumes\[1\] = 0\.0 must be positive"),
        (lambda: Particles(POINTS, np.array([1.0, np.nan, 1.0]), 0.1), r"volumes\[1\] = nan must be positive"),
        (lambda: Particles(np.full((3, 2), np.inf), VOLUMES, 0.1), r"positions\[0\] = .*inf.* is not finite"),
        (lambda: Particles(POINTS, VOLUMES, 0.0), r"spacing is 0\.0"),
        (lambda: box((0, 0), (1, 1), 0.5).where(np.zeros(4, bool)), "N >= 1"),
        (lambda: box((0, 0), (1, 1), 0.5) | box((0, 0, 0), (1, 1, 1), 0.5), "2D and 3D cannot be joined"),
    ],
)
def test_what_does_not_fit_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()
