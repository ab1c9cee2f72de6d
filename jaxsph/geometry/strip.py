"""Where the particles of a clamped body lie."""

from __future__ import annotations

import math

from jaxsph.checks import check_positive
from jaxsph.geometry.shapes import Particles, box

BEHIND = 3  # clamped columns behind the outermost: as many as a support radius reaches, and one


def spacing_across(thickness: float, across: int) -> float:
    """Spacing [m] of so many particles over a thickness, of which each surface has one. Raises ValueError below two."""
    if across < 2:
        raise ValueError(f"across = {across} particles over the thickness; both surfaces have one, so at least 2")
    return thickness / (across - 1)


def clamped_strip(length: float, thickness: float, across: int, behind: int = BEHIND, dtype=None) -> Particles:
    """A strip along x with its free end at x = length, to be clamped at the face x = 0, and its middle at y = 0.

    The outermost clamped column, at half a spacing, has clamped ones behind it. Of the strain at the face it feels one
    half, since its neighbors behind do not follow, and so it yields: the strip bends as if it were half a spacing
    longer than its free part and that column. With the column in the face the errors of deflections and periods are
    of first order in the spacing, and nearly all of them is this; here they are of second order.

    Clamped are the particles with x < spacing.

    Args:
        length, thickness: [m]. The lattice is stretched along x by up to half a spacing in all.
        across: particles over the thickness, the outermost on the surfaces; the spacing is thickness / (across - 1).
        behind: number of columns behind the outermost clamped one.
        dtype: float32 or float64; None takes jax's default.

    Raises ValueError for sizes that are not positive, fewer than 2 particles across, or a length below the spacing.
    """
    check_positive("length", length, "m")
    check_positive("thickness", thickness, "m")
    spacing = spacing_across(thickness, across)
    columns = math.floor(length / spacing * (1 + 1e-9))
    if columns < 1:
        raise ValueError(f"length = {length} m is shorter than the spacing {spacing:.6g} m; take more particles across")
    step = length / (columns + 0.5)
    lattice = box((0, -thickness / 2), ((columns + behind) * spacing, thickness), spacing, on_surface=True, dtype=dtype)
    positions, volumes = lattice.positions.copy(), lattice.volumes * (step / spacing)
    positions[:, 0] = (positions[:, 0] / spacing + 0.5 - behind) * step
    return Particles(positions.astype(lattice.positions.dtype), volumes.astype(lattice.volumes.dtype), spacing, True)
