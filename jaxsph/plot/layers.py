"""Sets of particles in one picture, each with its own size and colors, and films of them."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, SupportsFloat, cast

import numpy as np
from numpy.typing import ArrayLike

from jaxsph.plot.figure import BLUE, LARGE, MEDIUM, POWERS, SMALL, matplotlib, new_figure, style, with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 7.0


@dataclasses.dataclass(frozen=True)
class Layer:
    """A set of particles over time, ready to be drawn.

    Attributes:
        frames: for each frame positions (N, 2) and the numbers (N,) that color them, or None, in drawing order.
        spacing: particle spacing [m].
        label, unit: of the numbers. Layers of one label share a color bar.
        limits: ends of the color scale.
        color_map: matplotlib name.
        face: color without numbers.
    """

    frames: list[tuple[np.ndarray, np.ndarray | None]]
    spacing: float
    label: str
    unit: str
    limits: tuple[float, float]
    color_map: str
    face: str = BLUE

    @classmethod
    def of(
        cls,
        positions: ArrayLike,
        values: ArrayLike | None,
        spacing: SupportsFloat,
        label: str = "",
        unit: str = "",
        limits: tuple[SupportsFloat, SupportsFloat] | None = None,
        color_map: str | None = None,
        face: str = BLUE,
    ) -> Layer:
        """From positions (T, N, d) and values None, (T, N) or (T, N, d), whose magnitude is shown.

        Raises ValueError for shapes that do not fit, no particle, a spacing or limits that are not in order.
        """
        spacing, positions = float(spacing), np.asarray(positions)
        colored = None if values is None else np.asarray(values)
        frames = [_checked(x, None if colored is None else colored[k], spacing) for k, x in enumerate(positions)]
        shown = [value for _, value in frames if value is not None]
        everything = np.concatenate(shown) if shown else None
        chosen = color_map or ("coolwarm" if both_signs(everything) else "viridis")
        return cls(frames, spacing, label, unit, _limits(everything, limits), chosen, face)

    @property
    def extent(self) -> np.ndarray:
        """Lowest and highest coordinates over all frames (2, 2) [m]."""
        everywhere = np.concatenate([where for where, _ in self.frames])
        return np.stack([np.nanmin(everywhere, axis=0), np.nanmax(everywhere, axis=0)])

    @property
    def beyond(self) -> str:
        """Which ends of the color scale the numbers pass, as matplotlib's `extend`."""
        shown = [value[np.isfinite(value)] for _, value in self.frames if value is not None]
        everything = np.concatenate([np.array(self.limits), *shown])
        slack = 1e-9 * (self.limits[1] - self.limits[0])
        below, above = everything.min() < self.limits[0] - slack, everything.max() > self.limits[1] + slack
        return {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[int(below), int(above)]


def draw(layers: Sequence[Layer], *, title: str = "", frame: int = 0, axes: Axes | None = None) -> Figure:
    """A picture of a frame of layers, the first at the bottom, at equal aspect, in a new figure or in given axes."""
    bars = [layer for k, layer in enumerate(layers) if has_bar(layers, k)]
    low, high = bounds(layers)
    if axes is None:
        figure = new_figure(_WIDTH, _height(high - low, len(bars)), "compressed")
        panel = figure.subplots()
    else:
        figure, panel = cast("Figure", axes.get_figure(root=True)), axes
    drawn = [add_disks(panel, layer, frame) for layer in layers]
    set_view(panel, low, high, max(layer.spacing for layer in layers))
    for layer, disks in zip(layers, drawn, strict=True):
        if any(layer is bar for bar in bars):
            color_bar(figure, disks, layer, panel)
    panel.set_title(title, fontsize=LARGE, loc="left")
    return figure


def film(
    path: str | os.PathLike[str],
    layers: Sequence[Layer],
    times: np.ndarray | None = None,
    *,
    title: str = "",
    frames_per_second: SupportsFloat = 20.0,
    resolution: int = 100,
) -> Figure:
    """Write all frames to a GIF; returns the figure of the last.

    Raises ValueError for a path that is not a GIF, a speed or resolution that is not positive.
    """
    if not str(path).lower().endswith(".gif"):
        raise ValueError(f"{path}: expected a name that ends in .gif, the format that is written")
    frames_per_second = float(frames_per_second)
    if not (frames_per_second > 0 and resolution > 0):
        raise ValueError(f"frames_per_second is {frames_per_second}, resolution {resolution}: expected > 0")
    titled = lambda k: title if times is None else f"{title}   {time_text(times, k)}".strip()  # noqa: E731
    writer = matplotlib("animation").PillowWriter(fps=frames_per_second)
    figure = draw(layers, title=titled(0))
    axes = figure.axes[0]
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # laid out once: nothing moves from frame to frame but the particles
    with writer.saving(figure, str(path), resolution):
        for k in range(len(layers[0].frames)):
            for layer, drawn in zip(layers, axes.collections, strict=True):
                disks: Any = drawn
                where, shown = layer.frames[k]
                disks.set_offsets(where)
                if shown is not None:
                    disks.set_array(shown)
            axes.set_title(titled(k), fontsize=LARGE, loc="left")
            writer.grab_frame()
    return figure


def time_text(times, k: int) -> str:
    """t = 0.400 s, with as many decimals as the run's length asks for."""
    span = float(np.max(np.abs(times)))
    decimals = max(3, 1 - math.floor(math.log10(span))) if 0 < span < np.inf else 3
    return f"t = {float(times[k]):.{min(decimals, 9)}f} s"


def both_signs(values: np.ndarray | None, trace: float = 0.05) -> bool:
    """True when neither sign is a mere trace of the other, so that zero deserves the middle of the scale."""
    if values is None or not np.any(np.isfinite(values)):
        return False
    low, high = np.nanmin(values), np.nanmax(values)
    return bool(low < 0 < high and min(-low, high) > trace * max(-low, high))


def _checked(positions: ArrayLike, values: ArrayLike | None, spacing: float) -> tuple[np.ndarray, np.ndarray | None]:
    """Positions (N, 2) in drawing order, and the number that colors each."""
    where = np.asarray(positions, float)
    if where.ndim != 2 or where.shape[1] not in (2, 3) or len(where) == 0:
        raise ValueError(f"positions have shape {where.shape}, expected (N, 2) or (N, 3) with N >= 1")
    if not spacing > 0:
        raise ValueError(f"spacing is {spacing} m, expected the particle spacing, larger than 0")
    shown = None if values is None else np.asarray(values, float)
    if shown is not None:
        if shown.shape[:1] != where.shape[:1] or shown.ndim > 2:
            raise ValueError(f"values have shape {shown.shape}, expected ({len(where)},) or ({len(where)}, d)")
        if shown.ndim == 2:
            shown = np.linalg.norm(shown, axis=1)
    if where.shape[1] == 3:
        order = np.argsort(where[:, 2], kind="stable")
        where, shown = where[order], None if shown is None else shown[order]
    return where[:, :2], shown


def _limits(values: np.ndarray | None, limits: tuple[SupportsFloat, SupportsFloat] | None) -> tuple[float, float]:
    if limits is not None:
        low, high = float(limits[0]), float(limits[1])
        if not low < high:
            raise ValueError(f"limits are {(low, high)}, expected (low, high) with low < high")
        return low, high
    if values is None or not np.any(np.isfinite(values)):
        return 0.0, 1.0
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if both_signs(values):
        high = max(-low, high)
        return -high, high
    return (low, high) if low < high else (low - 0.5, high + 0.5)


def has_bar(layers: Sequence[Layer], k: int) -> bool:
    """Whether a layer is colored and the first of its label."""
    colored = [layer.frames[0][1] is not None for layer in layers]
    return colored[k] and not any(colored[i] and layers[i].label == layers[k].label for i in range(k))


def add_disks(axes: Axes, layer: Layer, frame: int):
    """Disks of the area that a particle stands for, spacing^2.

    They are in data units and keep the size of a particle at every zoom, which scatter's points do not.
    """
    where, values = layer.frames[frame]
    diameter = 2.0 * layer.spacing / math.sqrt(math.pi)
    disks = matplotlib("collections").EllipseCollection(
        widths=diameter, heights=diameter, angles=0.0, units="xy", offsets=where,
        offset_transform=axes.transData, linewidths=0.0, facecolors=layer.face,
    )  # fmt: skip
    if values is not None:
        disks.set_array(values)
        disks.set_cmap(layer.color_map)
        disks.set_clim(*layer.limits)
    axes.add_collection(disks)
    return disks


def color_bar(figure: Figure, disks, layer: Layer, axes) -> None:
    """The scale of a layer, beside one or several axes."""
    numbers = matplotlib("ticker").ScalarFormatter(useMathText=True)
    numbers.set_powerlimits(POWERS)
    bar = figure.colorbar(disks, ax=axes, format=numbers, aspect=24, pad=0.02, extend=layer.beyond)
    bar.set_label(with_unit(layer.label, layer.unit), fontsize=MEDIUM)
    bar.ax.tick_params(labelsize=SMALL)
    bar.ax.yaxis.get_offset_text().set_fontsize(SMALL)
    bar.outline.set_visible(False)


def bounds(layers: Sequence[Layer]) -> tuple[np.ndarray, np.ndarray]:
    extents = np.stack([layer.extent for layer in layers])
    return np.min(extents[:, 0], axis=0), np.max(extents[:, 1], axis=0)


def set_view(axes: Axes, low: np.ndarray, high: np.ndarray, spacing: float) -> None:
    margin = spacing + 0.03 * float(np.max(high - low))
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]", fontsize=MEDIUM)
    axes.set_ylabel("y [m]", fontsize=MEDIUM)
    style(axes)


def _height(extent: np.ndarray, bars: int) -> float:
    """Height [in] that leaves no empty bands around particles seen at equal aspect."""
    width = _WIDTH - 1.0 - bars
    return float(np.clip(width * extent[1] / max(extent[0], 1e-300) + 1.0, 2.2, 6.5))
