"""Particles as disks of their size, still and moving."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, SupportsFloat

import numpy as np
from numpy.typing import ArrayLike

from jaxsph.plot.layers import Layer, draw, film

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    layer = Layer.of(np.asarray(positions)[None], _framed(values), spacing, label, unit, limits, color_map)
    return draw([layer], title=title, axes=axes)


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
    frames = np.asarray(positions)
    if frames.ndim != 3 or len(frames) == 0:
        raise ValueError(f"positions have shape {frames.shape}, expected (T, N, 2) or (T, N, 3) with T >= 1")
    when = None if times is None else np.asarray(times, float)
    for name, given in (("values", values), ("times", when)):
        if given is not None and len(np.asarray(given)) != len(frames):
            raise ValueError(f"{name} are for {len(np.asarray(given))} frames, positions for {len(frames)}")
    layer = Layer.of(frames, values, spacing, label, unit, limits, color_map)
    return film(path, [layer], when, title=title, frames_per_second=frames_per_second, resolution=resolution)


def _framed(values):
    return None if values is None else np.asarray(values)[None]
