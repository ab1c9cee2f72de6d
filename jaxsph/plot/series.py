"""Computed against measured: time series with residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from jaxsph.plot.figure import (
    BLUE,
    GRAY,
    LARGE,
    LIGHT_GRAY,
    MEDIUM,
    SMALL,
    VERMILION,
    new_figure,
    style,
    with_unit,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def time_series(
    times: ArrayLike,
    model: ArrayLike,
    *,
    data_times: ArrayLike | None = None,
    data: ArrayLike | None = None,
    standard_deviation: float | ArrayLike | None = None,
    label: str = "displacement",
    unit: str = "m",
    components: Sequence[str] = ("x", "y", "z"),
    title: str = "",
) -> Figure:
    """Draw a computed time series, one panel per component, with measurements and what is left between them.

    Args:
        times: (T,) [s], increasing.
        model: (T,) or (T, d), computed values.
        data_times: (M,) [s] within `times`.
        data: (M,) or (M, d), measured values; with them a panel of residuals (data - model) below each
            component. The model is interpolated linearly to the times of the data.
        standard_deviation: of the data, one number or an array that broadcasts to `data`; drawn as a band of
            two standard deviations around zero residual.
        label: what is shown.
        unit: its unit.
        components: names of the d components.
        title: text above.

    Raises:
        ValueError: shapes that do not fit, times that do not increase, data beyond the model's times.
        ImportError: matplotlib is not installed.

    """
    t, y = np.asarray(times, float), np.asarray(model, float)
    if t.ndim != 1 or t.size < 2 or y.shape[:1] != t.shape or y.ndim > 2:
        raise ValueError(f"times {t.shape} and model {y.shape}: expected (T,) and (T,) or (T, d) with T >= 2")
    if not np.all(np.diff(t) > 0):
        raise ValueError("times do not increase; sort them, and the model with them")
    y = y.reshape(t.size, -1)
    if y.shape[1] > len(components):
        raise ValueError(f"model has {y.shape[1]} components, only {len(components)} are named: {components}")
    measured = _checked_data(t, y, data_times, data)
    names = [""] if y.shape[1] == 1 else [f"{name}-" for name in components[: y.shape[1]]]

    figure = new_figure(width=6.4 if y.shape[1] == 1 else 5.2 * y.shape[1], height=4.2 if measured else 3.2)
    ratios = (3, 1.2) if measured else (1,)
    panels = figure.subplots(len(ratios), y.shape[1], sharex=True, squeeze=False, height_ratios=ratios)
    for i, name in enumerate(names):
        top = panels[0, i]
        top.plot(t, y[:, i], color=BLUE, linewidth=1.6, label="model", zorder=2)
        top.set_ylabel(with_unit(f"{name}{label}", unit), fontsize=MEDIUM)
        if measured:
            when, value = measured
            top.plot(when, value[:, i], "o", color=VERMILION, markersize=3.2, label="data", zorder=3, alpha=0.85)
            below = panels[1, i]
            below.axhline(0.0, color=GRAY, linewidth=0.8)
            if standard_deviation is not None:
                spread = np.broadcast_to(np.reshape(standard_deviation, _column(standard_deviation)), value.shape)
                band = 2.0 * spread[:, i]
                below.fill_between(
                    when, -band, band, color=BLUE, alpha=0.15, linewidth=0, label="2 standard deviations"
                )
            left = value[:, i] - np.interp(when, t, y[:, i])
            below.plot(when, left, "o", color=VERMILION, markersize=2.6, alpha=0.85)
            below.set_ylabel(with_unit("residual", unit), fontsize=MEDIUM)
        panels[-1, i].set_xlabel("time [s]", fontsize=MEDIUM)
        for panel in panels[:, i]:
            style(panel)
            panel.grid(True, color=LIGHT_GRAY, linewidth=0.6)
    figure.align_ylabels()
    if measured:
        # outside the panels: no corner of an oscillation is free
        entries = [entry for panel in panels[:, 0] for entry in zip(*panel.get_legend_handles_labels(), strict=True)]
        figure.legend(*zip(*entries, strict=True), loc="outside upper right", ncols=3, fontsize=SMALL, frameon=False)
    if title:
        panels[0, 0].set_title(title, fontsize=LARGE, loc="left")
    return figure


def _checked_data(
    times: np.ndarray, model: np.ndarray, data_times: ArrayLike | None, data: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray] | None:
    if data is None and data_times is None:
        return None
    if data is None or data_times is None:
        raise ValueError("data and data_times belong together: give both or none")
    when, value = np.asarray(data_times, float), np.asarray(data, float)
    if when.ndim != 1 or when.size == 0 or value.size != when.size * model.shape[1]:
        raise ValueError(
            f"data_times {when.shape} and data {value.shape}: expected (M,) and (M, {model.shape[1]}) with M >= 1"
        )
    if when.min() < times[0] or when.max() > times[-1]:
        raise ValueError(
            f"data from {when.min()} to {when.max()} s, model from {times[0]} to {times[-1]} s: run the "
            "model longer or leave out the data beyond it"
        )
    return when, value.reshape(when.size, -1)


def _column(value: float | ArrayLike) -> tuple[int, ...]:
    """Shape that puts a (M,) beside (M, d)."""
    return (-1, 1) if np.ndim(value) == 1 else np.shape(value)
