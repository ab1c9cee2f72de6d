"""What all pictures share: how matplotlib is found, sizes of letters, colors, labels."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe & Ito (2008), colors that the color-blind tell apart
BLUE, VERMILION = "#0072B2", "#D55E00"
GRAY, LIGHT_GRAY = "#5A5A5A", "#D9D9D9"
SMALL, MEDIUM, LARGE = 9.0, 10.5, 12.0
"""Sizes of tick labels, axis labels and titles [pt]."""
POWERS = (-3, 4)
"""Numbers beyond these powers of ten are written with a common factor."""


def matplotlib(module: str) -> Any:
    """A module of matplotlib, or the sentence that says how to get it."""
    try:
        return importlib.import_module(f"matplotlib.{module}")
    except ModuleNotFoundError as error:
        if error.name and error.name.split(".")[0] in ("matplotlib", "PIL"):
            raise ImportError(f"pictures need {error.name}: pip install 'jaxsph[plot]'", name=error.name) from error
        raise


def new_figure(width: float, height: float, layout: str = "constrained") -> Figure:
    """A figure of its own, known to nobody else; sizes in inches."""
    return matplotlib("figure").Figure(figsize=(width, height), layout=layout, dpi=150)


def style(axes: Axes) -> None:
    """Readable ticks, no frame at the top and at the right."""
    axes.tick_params(labelsize=SMALL)
    axes.ticklabel_format(style="sci", scilimits=POWERS, useMathText=True)
    for text in (axes.xaxis.get_offset_text(), axes.yaxis.get_offset_text()):
        text.set_fontsize(SMALL)
    axes.spines[["top", "right"]].set_visible(False)


def with_unit(label: str, unit: str) -> str:
    """`label [unit]`; nothing is added for a dimensionless quantity."""
    return f"{label} [{unit}]".strip() if unit and unit != "1" else label
