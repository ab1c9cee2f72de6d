"""Particles as disks of their size, still and moving."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any, SupportsFloat, cast

import numpy as np
from numpy.typing import ArrayLike

from jaxsph.plot.figure import BLUE, LARGE, MEDIUM, POWERS, SMALL, matplotlib, new_figure, style, with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure

_WIDTH = 7.0


def particles(
    positions: ArrayLike,
    values: ArrayLike | None = None,
    *,
    spacing: SupportsFloat,
    label: str = "",
    unit: str = "",
    title: str = "",
    limits: tuple[SupportsFloat, SupportsFloat] | None = None,
    color_map: str | None = None,
    axes: Axes | None = None,
) -> Figure:
    """Draw particles as disks of their true size, colored by a value.

    Args:
        positions: (N, 2) or (N, 3) [m]; in 3D the first two components are seen from +z, near particles in
            front.
        values: (N,), or (N, d) of which the magnitude is shown; None draws one color.
        spacing: particle spacing [m]; a disk has the area spacing^2.
        label: what `values` is, e.g. "von Mises stress".
        unit: its unit, e.g. "Pa".
        title: text above.
        limits: values at the ends of the color scale; by default the smallest and largest, or both signs
            alike when `values` has both.
        color_map: matplotlib name; by default viridis, or a diverging map when `values` has both signs.
        axes: draw here instead of in a new figure.

    Raises:
        ValueError: shapes that do not fit, no particle, a spacing or limits that are not in order.
        ImportError: matplotlib is not installed.

    """
    spacing = float(spacing)
    where, shown = _checked(positions, values, spacing)
    chosen = _limits(shown, limits)
    if axes is None:
        figure = new_figure(_WIDTH, _height(where, with_bar=shown is not None), "compressed")
        panel = figure.subplots()
    else:
        figure, panel = cast("Figure", axes.get_figure(root=True)), axes
    disks = _disks(panel, where, shown, spacing, chosen, color_map)
    _view(panel, where, spacing)
    if shown is not None:
        numbers = matplotlib("ticker").ScalarFormatter(useMathText=True)
        numbers.set_powerlimits(POWERS)
        bar = figure.colorbar(disks, ax=panel, format=numbers, aspect=24, pad=0.02)
        bar.set_label(with_unit(label, unit), fontsize=MEDIUM)
        bar.ax.tick_params(labelsize=SMALL)
        bar.ax.yaxis.get_offset_text().set_fontsize(SMALL)
    panel.set_title(title, fontsize=LARGE, loc="left")
    return figure


def animate(
    path: str | os.PathLike[str],
    positions: ArrayLike,
    values: ArrayLike | None = None,
    times: ArrayLike | None = None,
    *,
    spacing: SupportsFloat,
    frames_per_second: SupportsFloat = 20.0,
    label: str = "",
    unit: str = "",
    title: str = "",
    limits: tuple[SupportsFloat, SupportsFloat] | None = None,
    color_map: str | None = None,
    resolution: int = 100,
) -> Figure:
    """Write moving particles to a GIF; color scale and view are those of the whole run.

    Args:
        path: file to write, `*.gif`.
        positions: (T, N, 2) or (T, N, 3) [m].
        values: (T, N) or (T, N, d); see `particles`.
        times: (T,) [s], shown above each frame.
        spacing: particle spacing [m].
        frames_per_second: speed of the GIF.
        label: what `values` is.
        unit: its unit.
        title: text above, before the time.
        limits: values at the ends of the color scale; by default those of the whole run.
        color_map: matplotlib name; see `particles`.
        resolution: dots per inch of a figure some 7 inches wide.

    Returns: the figure of the last frame.

    Raises:
        ValueError: as `particles`; a path that is not a GIF; no frame; a speed or resolution that is not
            positive.
        ImportError: matplotlib is not installed.

    """
    if not str(path).lower().endswith(".gif"):
        raise ValueError(f"{path}: expected a name that ends in .gif, the format that is written")
    spacing, frames_per_second = float(spacing), float(frames_per_second)
    if not (frames_per_second > 0 and resolution > 0):
        raise ValueError(f"frames_per_second is {frames_per_second}, resolution {resolution}: expected > 0")
    frames = np.asarray(positions)
    if frames.ndim != 3 or len(frames) == 0:
        raise ValueError(f"positions have shape {frames.shape}, expected (T, N, 2) or (T, N, 3) with T >= 1")
    colored = None if values is None else np.asarray(values)
    when = None if times is None else np.asarray(times, float)
    for name, given in (("values", colored), ("times", when)):
        if given is not None and len(given) != len(frames):
            raise ValueError(f"{name} are for {len(given)} frames, positions for {len(frames)}")
    checked = [_checked(x, None if colored is None else colored[k], spacing) for k, x in enumerate(frames)]
    everything = None if colored is None else np.concatenate([value for _, value in checked if value is not None])
    chosen = _limits(everything, limits)

    writer = matplotlib("animation").PillowWriter(fps=frames_per_second)
    figure = particles(
        frames[0], None if colored is None else colored[0], spacing=spacing, label=label, unit=unit,
        title=_titled(title, when, 0), limits=chosen, color_map=color_map or _color_map(everything),
    )  # fmt: skip
    axes = figure.axes[0]
    disks: Any = axes.collections[0]
    everywhere = np.concatenate([where for where, _ in checked])
    _view(axes, everywhere, spacing)
    figure.set_figheight(_height(everywhere, with_bar=colored is not None))
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # laid out once: nothing moves from frame to frame but the particles
    with writer.saving(figure, str(path), resolution):
        for k, (where, shown) in enumerate(checked):
            disks.set_offsets(where)
            if shown is not None:
                disks.set_array(shown)
            axes.set_title(_titled(title, when, k), fontsize=LARGE, loc="left")
            writer.grab_frame()
    return figure


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


def _both_signs(values: np.ndarray | None) -> bool:
    """True when neither sign is a mere trace, so that zero deserves the middle of the scale."""
    if values is None or not np.any(np.isfinite(values)):
        return False
    low, high = np.nanmin(values), np.nanmax(values)
    return bool(low < 0 < high and min(-low, high) > 0.05 * max(-low, high))


def _color_map(values: np.ndarray | None) -> str:
    return "coolwarm" if _both_signs(values) else "viridis"


def _limits(values: np.ndarray | None, limits: tuple[SupportsFloat, SupportsFloat] | None) -> tuple[float, float]:
    if limits is not None:
        low, high = float(limits[0]), float(limits[1])
        if not low < high:
            raise ValueError(f"limits are {(low, high)}, expected (low, high) with low < high")
        return low, high
    if values is None or not np.any(np.isfinite(values)):
        return 0.0, 1.0
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if _both_signs(values):
        high = max(-low, high)
        return -high, high
    return (low, high) if low < high else (low - 0.5, high + 0.5)


def _disks(
    axes: Axes,
    where: np.ndarray,
    values: np.ndarray | None,
    spacing: float,
    limits: tuple[float, float],
    color_map: str | None,
) -> EllipseCollection:
    """Disks of the area that a particle stands for, spacing^2.

    They are in data units and keep the size of a particle at every zoom, which scatter's points do not.
    """
    diameter = 2.0 * spacing / math.sqrt(math.pi)
    disks = matplotlib("collections").EllipseCollection(
        widths=diameter, heights=diameter, angles=0.0, units="xy", offsets=where,
        offset_transform=axes.transData, linewidths=0.0, facecolors=BLUE,
    )  # fmt: skip
    if values is not None:
        disks.set_array(values)
        disks.set_cmap(color_map or _color_map(values))
        disks.set_clim(*limits)
    axes.add_collection(disks)
    return disks


def _view(axes: Axes, where: np.ndarray, spacing: float) -> None:
    low, high = np.nanmin(where, axis=0), np.nanmax(where, axis=0)
    margin = spacing + 0.03 * float(np.max(high - low))
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]", fontsize=MEDIUM)
    axes.set_ylabel("y [m]", fontsize=MEDIUM)
    style(axes)


def _titled(title: str, times: np.ndarray | None, frame: int) -> str:
    if times is None:
        return title
    return f"{title}   t = {times[frame]:.3f} s".strip()


def _height(where: np.ndarray, with_bar: bool) -> float:
    """Height [in] that leaves no empty bands around particles seen at equal aspect."""
    extent = np.nanmax(where, axis=0) - np.nanmin(where, axis=0)
    width = _WIDTH - (2.0 if with_bar else 1.0)
    return float(np.clip(width * extent[1] / max(extent[0], 1e-300) + 1.0, 2.2, 6.5))
