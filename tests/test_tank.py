"""Tanks and polygons: where wall particles stand, how many, what they stand for, and what is refused."""

import numpy as np
import pytest

from jaxsph import scenes
from jaxsph.explain import arrangement
from jaxsph.geometry import box, polygon, tank

SPACING = 0.1


def cells(particles, corner):
    """Index of the cell in which each particle stands, (N, d); the inside starts at zero."""
    index = (particles.positions - np.asarray(corner)) / SPACING - 0.5
    # positions are a product and a sum away from whole numbers of spacings
    np.testing.assert_allclose(index, np.round(index), atol=1e-12)
    return {tuple(row) for row in np.round(index).astype(int)}


@pytest.mark.parametrize("layers", [1, 3])
def test_open_tank_in_2d(layers):
    """Everything around 4 x 3 cells but what is above: left and right columns, and the bottom with its corners."""
    corner = (0.3, -0.2)
    walls = tank(corner, (0.4, 0.3), SPACING, layers)
    expected = {
        (i, j)
        for i in range(-layers, 4 + layers)
        for j in range(-layers, 3)
        if not (0 <= i < 4 and 0 <= j < 3)
    }  # fmt: skip
    assert cells(walls, corner) == expected
    assert len(walls) == len(expected) == layers * (4 + 2 * layers) + 2 * layers * 3, "no particle stands twice"


@pytest.mark.parametrize("layers", [1, 2])
def test_open_tank_in_3d(layers):
    walls = tank((0.0, 0.0, 0.0), (0.3, 0.2, 0.4), SPACING, layers)
    index = cells(walls, (0.0, 0.0, 0.0))
    around = (3 + 2 * layers) * (2 + 2 * layers) * (4 + layers)
    assert len(walls) == len(index) == around - 3 * 2 * 4
    assert max(k for _, _, k in index) == 3, "the top is open"
    assert min(k for _, _, k in index) == -layers


@pytest.mark.parametrize(
    ("sides", "expected"),
    [
        (["left"], {(-1, 0), (-1, 1)}),
        (["right"], {(2, 0), (2, 1)}),
        (["bottom"], {(0, -1), (1, -1)}),
        (["top"], {(0, 2), (1, 2)}),
        (["bottom", "left"], {(-1, 0), (-1, 1), (-1, -1), (0, -1), (1, -1)}),
        (["bottom", "top"], {(0, -1), (1, -1), (0, 2), (1, 2)}),
    ],
)
def test_sides_of_a_square(sides, expected):
    """A corner is there if both faces that meet in it are."""
    assert cells(tank((0, 0), (0.2, 0.2), SPACING, 1, sides=sides), (0, 0)) == expected


@pytest.mark.parametrize(
    ("side", "axis", "place"),
    [("left", 0, -1), ("right", 0, 2), ("front", 1, -1), ("back", 1, 2), ("bottom", 2, -1), ("top", 2, 2)],
)
def test_sides_of_a_cube(side, axis, place):
    index = cells(tank((0, 0, 0), (0.2, 0.2, 0.2), SPACING, 1, sides=[side]), (0, 0, 0))
    assert len(index) == 4 and {i[axis] for i in index} == {place}


def test_no_sides_leave_no_wall():
    with pytest.raises(ValueError, match=r"N >= 1"):
        tank((0, 0), (0.2, 0.2), SPACING, sides=[])


def test_the_wall_is_half_a_spacing_from_the_particles_on_both_sides():
    """Fluid and wall continue one lattice, also where the size is not quite a multiple of the spacing."""
    size = np.array([0.4, 0.3]) * 1.004
    water, walls = box((0, 0), size, SPACING), tank((0, 0), size, SPACING, 2)
    step = size / [4, 3]
    assert water.positions[:, 0].min() == pytest.approx(0.5 * step[0], rel=1e-12)
    assert walls.positions[walls.positions[:, 0] < 0, 0].max() == pytest.approx(-0.5 * step[0], rel=1e-12)
    assert walls.positions[walls.positions[:, 0] > size[0], 0].min() == pytest.approx(size[0] + 0.5 * step[0])
    assert walls.positions[walls.positions[:, 1] < 0, 1].max() == pytest.approx(-0.5 * step[1], rel=1e-12)
    np.testing.assert_allclose(walls.volumes, step[0] * step[1], rtol=1e-14)
    np.testing.assert_allclose(water.volumes, walls.volumes[0], rtol=1e-14)
    together = np.concatenate([water.positions, walls.positions])
    apart = np.linalg.norm(together[:, None] - together, axis=-1) + np.eye(len(together))
    assert apart.min() == pytest.approx(step.min(), rel=1e-12), "nothing overlaps"


def test_volumes_fill_the_layers():
    walls = tank((0, 0, 0), (0.3, 0.2, 0.4), SPACING, 2, sides=["bottom"])
    assert walls.volumes.sum() == pytest.approx(0.3 * 0.2 * 0.2, rel=1e-12)
    assert walls.spacing == SPACING


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_precision(kind):
    for particles in (
        tank((0, 0), (0.2, 0.2), SPACING, dtype=kind),
        polygon([(0, 0), (1, 0), (0, 1)], 0.1, dtype=kind),
    ):
        assert particles.positions.dtype == kind and particles.volumes.dtype == kind


@pytest.mark.parametrize(
    ("arguments", "options", "said"),
    [
        (((0, 0), (0.25, 0.2), 0.1), {}, r"size\[0\] = 0\.25 is not a positive multiple of the spacing 0\.1"),
        (((0, 0), (0.2, -0.2), 0.1), {}, r"size\[1\] = -0\.2 is not a positive multiple"),
        (((0, 0), (0.2, 0.2), 0.0), {}, "particle spacing is 0.0"),
        (((0, 0), (0.2, 0.2), 0.1, 0), {}, "layers = 0 must be at least 1"),
        (((0, 0), (0.2, 0.2), 0.1), {"sides": ["front"]}, "side 'front' is not known; a tank in 2D has left, right,"),
        (((0, 0, 0), (0.2, 0.2, 0.2), 0.1), {"sides": ["lid"]}, "'lid' is not known; .* in 3D has .* front, back,"),
        (((0, 0), (0.2, 0.2, 0.2), 0.1), {}, "must both have 2 or 3 components"),
    ],
)
def test_a_tank_that_does_not_fit_is_refused(arguments, options, said):
    with pytest.raises(ValueError, match=said):
        tank(*arguments, **options)


SHAPES = {
    "triangle": ([(0, 0), (1, 0), (0, 1)], 0.5),
    "the other way round": ([(0, 1), (1, 0), (0, 0)], 0.5),
    "hexagon": ([(np.cos(t), np.sin(t)) for t in np.arange(6) * np.pi / 3], 1.5 * np.sqrt(3)),
    "L, not convex": ([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], 3.0),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_polygon_has_its_area_and_center(shape):
    corners, area = SHAPES[shape]
    spacing = 0.05
    filled = polygon(corners, spacing)
    assert filled.volumes.sum() == pytest.approx(area, rel=1e-12)
    # Each cell along the edge is in or out: the number is right to a fraction of the edge's cells.
    edge = sum(np.hypot(*np.subtract(a, b)) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True))
    assert abs(len(filled) * spacing**2 - area) < 0.3 * edge * spacing
    x, y = np.asarray(corners, float).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    center = [np.sum((v + np.roll(v, -1)) * cross) / (3 * np.sum(cross)) for v in (x, y)]
    np.testing.assert_allclose(np.average(filled.positions, axis=0), center, atol=0.5 * spacing)


def test_polygon_holds_what_is_inside_and_nothing_else():
    """By half planes for a convex one, and the notch of an L stays empty."""
    corners = np.array([(0, 0), (2, 0.3), (1.4, 1.5), (0.2, 1.1)])
    x = polygon(corners, 0.04).positions
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side = (end[0] - start[0]) * (x[:, 1] - start[1]) - (end[1] - start[1]) * (x[:, 0] - start[0])
        assert np.all(side > -1e-12)
    ell = polygon(SHAPES["L, not convex"][0], 0.1).positions
    assert len(ell) == 300 and not np.any((ell[:, 0] > 1) & (ell[:, 1] > 1))


@pytest.mark.parametrize(
    ("corners", "spacing", "said"),
    [
        ([(0, 0), (1, 1)], 0.1, r"corners has shape \(2, 2\); it must be \(M, 2\) with M >= 3"),
        ([(0, 0, 0), (1, 1, 0), (0, 1, 0)], 0.1, r"corners has shape \(3, 3\)"),
        ([(0, 0), (1, 1), (2, 2)], 0.1, "lie on a line"),
        ([(0, 0), (1, 0), (0, 1)], -0.1, "particle spacing is -0.1"),
        ([(0, 0), (0.1, 0), (0, 0.1)], 1.0, "no particle fits into the polygon at a spacing of 1.0 m"),
    ],
)
def test_a_polygon_that_does_not_fit_is_refused(corners, spacing, said):
    with pytest.raises(ValueError, match=said):
        polygon(corners, spacing)


SCENES = {
    "still_water": lambda smoothing: scenes.still_water(10, smoothing=smoothing),
    "dam_break": lambda smoothing: scenes.dam_break(10, smoothing=smoothing),
    "dam_break_plate": lambda smoothing: scenes.dam_break_plate(10, smoothing=smoothing),
    "elastic_gate": lambda smoothing: scenes.elastic_gate(10, smoothing=smoothing),
    "moving_wall": lambda smoothing: scenes.moving_wall(10, smoothing=smoothing),
    "water_column_on_plate": lambda smoothing: scenes.water_column_on_plate(smoothing=smoothing),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("smoothing", [1.3, 3.0])
def test_walls_of_scenes_are_as_thick_as_water_beside_them_sees(name, smoothing):
    scene = SCENES[name](smoothing)
    for wall in scene.walls:
        found = arrangement.layers(scene, wall)
        assert found is not None and found >= arrangement.layers_needed(scene, wall)
