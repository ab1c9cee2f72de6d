"""Several moments of a run side by side, on one scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from jaxsph.plot.figure import LARGE, new_figure
from jaxsph.plot.layers import add_disks, bounds, color_bar, has_bar, set_view, time_text
from jaxsph.plot.run import AUTOMATIC, layers_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WIDTH, _TALLEST = 11.0, 9.0
"""Largest sizes of a new figure [in]."""


def moments(
    trajectory: Any,
    times: ArrayLike,
    name: str | Sequence[str] | None = None,
    color: str | None = AUTOMATIC,
    *,
    columns: int | None = None,
    limits: tuple | None = None,
    color_map: str | None = None,
    view: tuple[float | int, float | int] | None = None,
    axes: Sequence | np.ndarray | None = None,
) -> Figure:
    """Draw a system of a run, or all of them, at several times with one color scale.

    Args:
        trajectory: from `simulate`.
        times: of the panels [s]; each takes the nearest saved state.
        name: of the system, or several of them; None draws all.
        color, limits, color_map: as of `snapshot`; the scale is that of the times shown.
        columns: panels in a row; None takes all for tall panels, two for long ones.
        view: in 3D, azimuth and elevation of the viewer [degrees]: (0, 0) looks along y with z upwards. None looks
            down from +z.
        axes: draw here, one for each time, instead of in a new figure.

    Raises:
        KeyError: no system of this name.
        ValueError: a color that is not known, no times, or not as many axes as times; a view of a run in 2D.
        ImportError: matplotlib is not installed.
    """
    times = np.atleast_1d(np.asarray(times, float))
    if not len(times) or (axes is not None and len(axes) != len(times)):
        raise ValueError(f"{len(times)} times and {axes if axes is None else len(axes)} axes; one of each is needed")
    if view is not None and trajectory.scene.dimension != 3:
        raise ValueError(f"view = {view} is for runs in 3D; leave it out")
    saved = np.asarray(trajectory.times, float)
    indices = [int(np.argmin(np.abs(saved - time))) for time in times]
    layers = layers_of(trajectory, name, color, indices, limits, color_map, None if view is None else _turn(*view))
    low, high = bounds(layers)
    size = np.maximum(high - low, 1e-300)
    if axes is None:
        columns = (len(times) if size[0] < 1.5 * size[1] else 2) if columns is None else columns
        columns = min(columns, len(times))
        rows = math.ceil(len(times) / columns)
        height = rows * ((_WIDTH - 1.5) / columns * size[1] / size[0] + 0.6) + 0.3
        figure = new_figure(_WIDTH, min(height, _TALLEST), "compressed")
        panels = list(figure.subplots(rows, columns, squeeze=False).flat)
        for empty in panels[len(times) :]:
            empty.set_visible(False)
        panels = panels[: len(times)]
    else:
        panels, columns = list(axes), len(axes)
        figure = cast("Figure", panels[0].get_figure(root=True))
    for frame, panel in enumerate(panels):
        drawn = [add_disks(panel, layer, frame) for layer in layers]
        set_view(panel, low, high, max(layer.spacing for layer in layers))
        panel.set_title(time_text(saved, indices[frame]), fontsize=LARGE, loc="left")
        if view is not None:
            panel.set_axis_off()
        if frame % columns:
            panel.set_ylabel("")
        if frame + columns < len(panels):
            panel.set_xlabel("")
        if frame == len(panels) - 1:
            for k, (layer, disks) in enumerate(zip(layers, drawn, strict=True)):
                if has_bar(layers, k):
                    color_bar(figure, disks, layer, panels)
    return figure


def _turn(azimuth: float | int, elevation: float | int):
    """From positions (..., 3) to the viewer's: right, up, and towards the eye."""
    a, e = math.radians(azimuth), math.radians(elevation)
    right = (math.cos(a), math.sin(a), 0.0)
    eye = (math.cos(e) * math.sin(a), -math.cos(e) * math.cos(a), math.sin(e))
    return lambda x: x @ np.stack([right, np.cross(eye, right), eye], axis=1)
