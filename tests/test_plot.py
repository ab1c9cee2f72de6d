"""Pictures show the numbers that they were given, at the scale of the particles, without pyplot."""

import itertools
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from PIL import Image
from PIL.GifImagePlugin import GifImageFile

import jaxsph as sph
from jaxsph import plot
from jaxsph.geometry import tank
from jaxsph.plot.figure import LIGHT_GRAY
from jaxsph.plot.layers import time_text
from jaxsph.pytree import replace

SPACING = 0.01


def block(nx=12, ny=5):
    x, y = np.meshgrid(np.arange(nx) * SPACING, np.arange(ny) * SPACING, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)


def pixels(figure):
    """The figure as an image (height, width, 3)."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(int)


def test_particles_are_drawn_where_they_are_with_their_value():
    positions, values = block(), np.linspace(1.0, 5.0, 60)
    figure = plot.particles(positions, values, spacing=SPACING, label="pressure", unit="Pa", title="block")
    axes, bar = figure.axes
    (disks,) = axes.collections
    np.testing.assert_array_equal(disks.get_offsets(), positions)
    np.testing.assert_array_equal(disks.get_array(), values)
    assert disks.get_clim() == (1.0, 5.0)
    assert bar.get_ylabel() == "pressure [Pa]" and axes.get_title(loc="left") == "block"
    assert axes.get_xlabel() == "x [m]" and axes.get_aspect() == 1.0


@pytest.mark.parametrize("zoom", [1.0, 0.3])
def test_a_disk_has_the_area_of_a_particle_at_every_zoom(zoom):
    """One black particle in white: its area in pixels is spacing^2 in the scale of the axes."""
    figure = plot.particles(np.zeros((1, 2)), spacing=SPACING)
    axes = figure.axes[0]
    axes.set_xlim(-2 * zoom * SPACING, 2 * zoom * SPACING)
    axes.set_ylim(-2 * zoom * SPACING, 2 * zoom * SPACING)
    axes.set_axis_off()
    image = pixels(figure)
    blue = np.sum(np.all(np.abs(image - [0x00, 0x72, 0xB2]) < 60, axis=-1))
    (left, _), (right, _) = axes.transData.transform([(0.0, 0.0), (SPACING, 0.0)])
    # pixels on the rim are mixed colors: perimeter / area is 4 % for the smaller disk
    assert blue == pytest.approx((right - left) ** 2, rel=0.05)


def test_scale_is_symmetric_when_both_signs_matter():
    positions = block()
    figure = plot.particles(positions, np.linspace(-1.0, 3.0, 60), spacing=SPACING)
    assert figure.axes[0].collections[0].get_clim() == (-3.0, 3.0)
    figure = plot.particles(positions, np.linspace(-0.01, 3.0, 60), spacing=SPACING)
    assert figure.axes[0].collections[0].get_clim() == (-0.01, 3.0), "a trace of a sign changes nothing"
    figure = plot.particles(positions, np.full(60, 7.0), spacing=SPACING, limits=(0.0, 10.0))
    assert figure.axes[0].collections[0].get_clim() == (0.0, 10.0)


def test_vectors_show_their_magnitude_and_near_particles_cover_far_ones():
    positions = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
    figure = plot.particles(positions, np.array([[3.0, 4.0], [0.0, 1.0], [2.0, 0.0]]), spacing=SPACING)
    np.testing.assert_array_equal(figure.axes[0].collections[0].get_array(), [1.0, 2.0, 5.0])


def test_particles_draw_into_given_axes():
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert plot.particles(block(), spacing=SPACING, axes=right) is figure
    assert len(right.collections) == 1 and not left.collections


def test_not_a_number_is_drawn_over():
    values = np.linspace(0.0, 1.0, 60)
    values[3] = np.nan
    positions = block()
    positions[4] = np.nan
    figure = plot.particles(positions, values, spacing=SPACING)
    assert figure.axes[0].collections[0].get_clim() == (0.0, 1.0)
    pixels(figure)


def test_time_series_shows_model_data_and_residual():
    times = np.linspace(0.0, 2.0, 41)
    model = np.stack([times, -2.0 * times], axis=1)
    data_times = np.array([0.13, 0.7, 1.99])
    error = np.array([[0.1, -0.2], [0.0, 0.3], [-0.1, 0.0]])
    data = np.stack([data_times, -2.0 * data_times], axis=1) + error
    figure = plot.time_series(
        times, model, data_times=data_times, data=data, standard_deviation=0.1, label="tip displacement"
    )
    upper, lower = figure.axes[:2], figure.axes[2:]
    for i in (0, 1):
        line, dots = upper[i].get_lines()
        np.testing.assert_array_equal(line.get_ydata(), model[:, i])
        np.testing.assert_array_equal(dots.get_ydata(), data[:, i])
        # a straight line is interpolated exactly, up to round-off of numbers of size 4
        np.testing.assert_allclose(np.asarray(lower[i].get_lines()[1].get_ydata(), float), error[:, i], atol=1e-14)
        band = lower[i].collections[0].get_datalim(lower[i].transData)
        np.testing.assert_allclose([band.y0, band.y1], [-0.2, 0.2], rtol=1e-12)
        assert lower[i].get_xlabel() == "time [s]" and lower[i].get_ylabel() == "residual [m]"
    assert upper[1].get_ylabel() == "y-tip displacement [m]"
    pixels(figure)


def test_time_series_without_data_has_one_panel():
    figure = plot.time_series(np.arange(3.0), np.arange(3.0), title="free fall")
    (axes,) = figure.axes
    assert axes.get_ylabel() == "displacement [m]" and axes.get_title(loc="left") == "free fall"


@pytest.mark.parametrize("spread", [0.1, np.array([0.1, 0.2]), np.array([[0.1, 0.3], [0.2, 0.4]])])
def test_standard_deviation_for_all_for_each_time_or_for_each_number(spread):
    data = np.zeros((2, 2))
    times = np.array([0.0, 1.0])
    figure = plot.time_series(times, data, data_times=times, data=data, standard_deviation=spread)
    tops = [np.max(axes.collections[0].get_datalim(axes.transData).y1) for axes in figure.axes[2:]]
    expected = 2 * np.broadcast_to(spread if np.ndim(spread) != 1 else np.reshape(spread, (2, 1)), (2, 2)).max(axis=0)
    np.testing.assert_allclose(tops, expected, rtol=1e-12)


def test_animation_has_every_frame_and_one_scale(tmp_path):
    times = np.linspace(0.0, 0.4, 5)
    positions = block() + np.stack([times, 0 * times], axis=1)[:, None]
    values = np.linspace(0.0, 1.0, 60) * times[:, None]
    path = tmp_path / "run.gif"
    figure = plot.animate(path, positions, values, times, spacing=SPACING, frames_per_second=10, resolution=50)
    axes = figure.axes[0]
    (disks,) = axes.collections
    np.testing.assert_array_equal(disks.get_offsets(), positions[-1])
    np.testing.assert_array_equal(disks.get_array(), values[-1])
    assert disks.get_clim() == (0.0, 0.4) and axes.get_title(loc="left") == "t = 0.400 s"
    low, high = axes.get_xlim()
    assert low < positions[..., 0].min() and high > positions[..., 0].max(), "the view holds the whole run"
    with Image.open(path) as image:
        assert isinstance(image, GifImageFile)
        assert image.n_frames == 5 and image.info["duration"] == 100
        frames = []
        for k in range(5):
            image.seek(k)
            frames.append(np.asarray(image.convert("RGB")))
    assert all(np.any(a != b) for a, b in itertools.pairwise(frames))


def test_pyplot_is_never_loaded(tmp_path):
    code = (
        "import sys, numpy as np\n"
        "from jaxsph import plot\n"
        "assert not any(name.startswith('matplotlib') for name in sys.modules), 'loaded before it is used'\n"
        "x = np.random.rand(2, 9, 2)\n"
        f"plot.animate({str(tmp_path / 'a.gif')!r}, x, spacing=0.1).savefig({str(tmp_path / 'a.png')!r})\n"
        "plot.time_series([0, 1], [0, 1]).savefig(sys.argv[1])\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "b.png")], check=True)
    with Image.open(tmp_path / "b.png") as image:
        assert image.size[0] > 600


def test_missing_matplotlib_names_the_extra(monkeypatch):
    def missing(name, *args, **kwargs):
        raise ModuleNotFoundError(f"No module named {name!r}", name="matplotlib")

    monkeypatch.setattr("importlib.import_module", missing)
    with pytest.raises(ImportError, match=r"pictures need matplotlib: pip install 'jaxsph\[plot\]'"):
        plot.particles(block(), spacing=SPACING)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"positions": np.zeros((3, 1))}, r"positions have shape \(3, 1\)"),
        ({"positions": np.zeros((0, 2))}, r"with N >= 1"),
        ({"spacing": -1.0}, r"spacing is -1.0 m, expected the particle spacing, larger than 0"),
        ({"values": np.zeros(4)}, r"values have shape \(4,\), expected \(60,\) or \(60, d\)"),
        ({"limits": (1.0, 1.0)}, r"limits are \(1.0, 1.0\)"),
    ],
)
def test_wrong_particles_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        plot.particles(**{"positions": block(), "spacing": SPACING, **arguments})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"times": [0.0, 1.0, 1.0]}, "times do not increase"),
        ({"model": np.zeros(4)}, r"times \(3,\) and model \(4,\)"),
        ({"model": np.zeros((3, 4))}, "model has 4 components, only 3 are named"),
        ({"data": np.zeros(2)}, "data and data_times belong together"),
        ({"data_times": [0.0, 2.5], "data": np.zeros(2)}, "data from 0.0 to 2.5 s, model from 0.0 to 2.0 s"),
        ({"data_times": [0.0, 1.5], "data": np.zeros(3)}, r"expected \(M,\) and \(M, 1\)"),
    ],
)
def test_wrong_time_series_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        plot.time_series(**{"times": [0.0, 1.0, 2.0], "model": np.zeros(3), **arguments})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": "run.mp4"}, r"run.mp4: expected a name that ends in .gif"),
        ({"positions": np.zeros((5, 2))}, r"expected \(T, N, 2\)"),
        ({"values": np.zeros((2, 60))}, "values are for 2 frames, positions for 3"),
        ({"times": np.zeros(4)}, "times are for 4 frames, positions for 3"),
        ({"frames_per_second": 0.0}, "frames_per_second is 0.0"),
    ],
)
def test_wrong_animations_are_refused(arguments, message):
    given = {"path": "run.gif", "positions": np.zeros((3, 60, 2)), "spacing": SPACING}
    with pytest.raises(ValueError, match=message):
        plot.animate(**{**given, **arguments})


@pytest.fixture(scope="module")
def run():
    """Water that falls in a tank beside a plate that moves."""
    dx = 0.1
    water = sph.Fluid("water", sph.box((0, 0), (0.5, 0.6), dx), 1000.0, 20.0, pressure=lambda x: 1e4 * (0.6 - x[:, 1]))
    basin = sph.Wall("basin", tank((0, 0), (1.5, 0.8), dx, 4))
    plate = sph.Structure("plate", sph.box((1, 0), (0.1, 0.3), 0.05, on_surface=True), 1e3, 1e6, 0.3, velocity=(1, 0))
    shared = {"gravity": (0.0, -10.0), "smoothing_length": 1.75 * dx}
    flow = sph.simulate(sph.Scene(water, basin, **shared), 0.02, 0.01)
    solid = sph.simulate(sph.Scene(plate, **shared), 0.02, 0.01)
    # two runs side by side: in one run fluids and structures would have to be coupled
    both = replace(flow.states, systems={**flow.states.systems, **solid.states.systems})
    return sph.Trajectory(sph.Scene(water, basin, plate, **shared), both, flow.time_step)


def test_a_picture_of_all_systems(run):
    figure = plot.snapshot(run)
    axes, *bars = figure.axes
    assert axes.get_aspect() == 1.0 and axes.get_title(loc="left") == "t = 0.020 s"
    assert {bar.get_ylabel() for bar in bars} == {"pressure [Pa]", "von Mises stress [Pa]"}
    walls, fluid, structure = axes.collections
    for disks, name in ((walls, "basin"), (fluid, "water"), (structure, "plate")):
        np.testing.assert_allclose(np.asarray(disks.get_offsets()), run.positions(name)[-1], rtol=1e-15)
    assert walls.get_array() is None and tuple(np.asarray(walls.get_facecolor())[0]) == to_rgba(LIGHT_GRAY)
    pressure = np.asarray(sph.observe.pressure(run.scene, run.final, "water"))
    np.testing.assert_allclose(np.asarray(fluid.get_array()), pressure, rtol=1e-12)  # the same operations
    assert fluid.get_cmap().name != structure.get_cmap().name, "two quantities look different"
    low, high = fluid.get_clim()
    outside = np.mean((pressure < low) | (pressure > high))
    assert outside <= 2 / len(pressure), "half a per cent at either end, here a particle"
    low, high = axes.get_xlim()
    assert low < -0.4 and high > 1.9, "four layers of wall at both sides are in view"
    pixels(figure)


def test_systems_of_one_quantity_share_scale_and_bar(run):
    figure = plot.snapshot(run, color="velocity", limits=(0.0, 3.0), color_map="magma", title="all")
    axes, bar = figure.axes
    assert bar.get_ylabel() == "speed [m/s]" and axes.get_title(loc="left") == "all"
    for disks in axes.collections[1:]:
        assert disks.get_clim() == (0.0, 3.0) and disks.get_cmap().name == "magma"
    free = plot.snapshot(run, color="velocity").axes[0].collections
    assert free[1].get_clim() == free[2].get_clim()


@pytest.mark.parametrize("color", [None, *plot.FLUID_COLORS])
def test_snapshot_of_a_fluid(run, color):
    figure = plot.snapshot(run, "water", color=color)
    (disks,) = figure.axes[0].collections
    assert figure.axes[0].get_title(loc="left") == "water   t = 0.020 s"
    if color is None:
        assert disks.get_array() is None and len(figure.axes) == 1
        return
    observed = {
        "density": lambda: sph.observe.density(run.scene, run.final, "water"),
        "pressure": lambda: sph.observe.pressure(run.scene, run.final, "water"),
        "vorticity": lambda: sph.observe.vorticity(run.scene, run.final, "water"),
    }
    fields = run.final.systems["water"]
    expected = observed[color]() if color in observed else np.linalg.norm(fields[color], axis=1)
    # sums over neighbors in lists of other sizes
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(np.asarray(disks.get_array()), expected, rtol=0, atol=1e-12 * scale)


def test_snapshot_of_a_wall_is_gray(run):
    figure = plot.snapshot(run, "basin")
    (disks,) = figure.axes[0].collections
    assert disks.get_array() is None and tuple(np.asarray(disks.get_facecolor())[0]) == to_rgba(LIGHT_GRAY)
    with pytest.raises(ValueError, match=r"color 'pressure' is not known; choose one of \[\], or None"):
        plot.snapshot(run, "basin", color="pressure")
    with pytest.raises(ValueError, match="color 'salinity' is not known"):
        plot.snapshot(run, color="salinity")


def test_a_film_of_all_systems(run, tmp_path):
    run.animate(tmp_path / "all.gif", color="pressure", resolution=40)
    with Image.open(tmp_path / "all.gif") as image:
        assert isinstance(image, GifImageFile) and image.n_frames == 3


@pytest.mark.parametrize(("times", "text"), [([0.0, 0.4], "t = 0.400 s"), ([0.0, 2.5e-5], "t = 0.000025 s")])
def test_time_has_the_decimals_that_a_run_needs(times, text):
    assert time_text(np.array(times), 1) == text
