"""Pictures of particles and of time series; every function returns a `matplotlib.figure.Figure`.

Nothing here touches pyplot: no global figure, no backend, no window, so that it works on a machine without a
screen and inside other programs. matplotlib is imported by the first call (extra `jaxsph[plot]`).
"""

from jaxsph.plot.disks import animate, particles
from jaxsph.plot.moments import moments
from jaxsph.plot.run import FLUID_COLORS, STRUCTURE_COLORS, animate_trajectory, snapshot
from jaxsph.plot.series import time_series

__all__ = [
    "FLUID_COLORS",
    "STRUCTURE_COLORS",
    "animate",
    "animate_trajectory",
    "moments",
    "particles",
    "snapshot",
    "time_series",
]
