"""Error against cost, with the Pareto front."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxsph.accuracy.results import Results
from jaxsph.plot.figure import GRAY, LARGE, MEDIUM, SMALL, matplotlib, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe & Ito (2008)."""
MARKERS = "osD^vP*X<>h"
LABELS = {"seconds": "time of the run [s]", "steps": "steps", "particle_steps": "particle-steps",
          "memory": "memory [bytes]"}  # fmt: skip


def work_precision(
    results: Results,
    path: str | Path | None = None,
    *,
    error: str | None = None,
    cost: str = "seconds",
    label: str | None = None,
    title: str | None = None,
) -> Figure:
    """Draw runs as points, those that differ in nothing but resolution joined by a line, and the Pareto front.

    Args:
        results: of a study.
        path: of the picture to write.
        error: which one; None is the first.
        cost: "seconds", "steps", "particle_steps" or "memory".
        label: of the error's axis.
        title: None takes that of the results.

    Raises ValueError if no run has both an error and a cost.
    """
    name = results.error_name(error)
    errors, costs = results[name], np.array(results[cost], float)
    good = np.isfinite(errors) & np.isfinite(costs) & (errors > 0) & (costs > 0)
    if not np.any(good):
        raise ValueError(f"no run has a positive {name!r} and {cost}")
    figure = new_figure(8.0, 5.2)
    axes = figure.subplots()
    axes.set(xscale="log", yscale="log")
    varied = results.varied
    for number, (settings, members) in enumerate(results.families().items()):
        shown = [index for index in members if good[index]]
        if not shown:
            continue
        about = results.label(results.rows[shown[0]], [key for key, _ in settings if key in varied])
        axes.plot(
            costs[shown],
            errors[shown],
            marker=MARKERS[number % len(MARKERS)],
            color=COLORS[number % len(COLORS)],
            linestyle=("-", "--", ":")[number // len(COLORS) % 3],
            linewidth=1.0,
            markersize=5,
            label=about or "runs",
        )
    front = results.pareto(name, cost)
    x, y = np.array(front[cost], float), front[name]
    # with disks, since a front may be one run
    wide = {"linewidth": 5, "marker": "o", "markersize": 11, "markeredgewidth": 0}
    axes.plot(x, y, color=GRAY, alpha=0.25, solid_capstyle="round", zorder=0, label="Pareto front", **wide)
    _write_labels(axes, front, x, y)
    axes.set_xlabel(LABELS[cost], fontsize=MEDIUM)
    axes.set_ylabel(name.replace("_", " ") if label is None else label, fontsize=MEDIUM)
    axes.set_title(results.title if title is None else title, fontsize=LARGE)
    axes.tick_params(which="both", labelsize=SMALL)
    # .1, 10, 20 s rather than powers of ten that run into each other
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(matplotlib("ticker").LogFormatter())
    axes.grid(True, which="major", alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.2, y=0.12)
    axes.legend(fontsize=7.5, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    if path is not None:
        matplotlib("backends.backend_agg").FigureCanvasAgg(figure)
        figure.savefig(path)
    return figure


def _write_labels(axes, front: Results, x, y) -> None:
    """The resolution of each run on the front, and what else varies along the front, below its point."""
    names, resolution = front.varied[:1], front.resolution
    if resolution is not None and (resolution in front.varied or not names):
        names = [resolution]
    for row, place in zip(front, zip(x, y, strict=True), strict=True):
        text = front.label(row, names)
        axes.annotate(
            text, place, xytext=(-4, -5), textcoords="offset points", ha="right", va="top", fontsize=7, color=GRAY
        )
