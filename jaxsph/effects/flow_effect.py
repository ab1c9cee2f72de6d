"""What an effect on fluids looks like."""

from __future__ import annotations

from typing import ClassVar


class FlowEffect:
    """An effect on fluids: what it adds to the sums over pairs. All effects share one pass over the pairs.

    A subclass states what it takes part in by overriding methods; what it does not override is not compiled.
    """

    partners: ClassVar[frozenset[str]] = frozenset({"fluid", "wall", "solid"})
    """With what its force and density flux act: fluids, walls, and solids, which are structures and rigid bodies."""

    symmetric: ClassVar[bool] = True
    """Whether its force is antisymmetric in a and b. If one effect's is not, gradients of a run cost more."""

    density_flux = None
    """density_flux(a, b, pair): what flows into a, times the volume of a, [kg/s]; antisymmetric in a and b.

    Between particles of one fluid, and with walls and solids if they are among its `partners`."""

    force = None
    """force(a, b, pair): force on a from b [N, in 2D per meter], (d,); antisymmetric in a and b."""

    acceleration = None
    """acceleration(positions (d, N), time): force per mass from outside [m/s^2], (d, N)."""
