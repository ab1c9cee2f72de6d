"""The sums behind a corrected gradient."""

from __future__ import annotations

from typing import Any

from jaxsph.flow.pairs import fluid_fields, over_pairs, partners, wall_at_rest
from jaxsph.fluid import Fluid


def moments(scene, fluid, references, columns, placed, lists, forward_mode=False):
    """M = -sum_b V_b grad W x_ab^T (d, d, N) of a fluid's particles, over fluids, walls and structures."""

    def geometry(system):
        fields = fluid_fields(system, references[system.name], columns[system.name])
        return {name: fields[name] for name in ("position", "mass", "density")}

    own, total = geometry(fluid), 0.0
    for other, neighbors in partners(scene, fluid, lists):
        if other is fluid:
            senders: Any = own
        elif isinstance(other, Fluid):
            senders = geometry(other)
        else:
            senders = wall_at_rest(fluid, other, references, placed)

        def of_pair(a, b, pair) -> Any:
            return -b["volume"] * pair.gradient[:, None] * pair.offset[None, :]

        thin = None if isinstance(other, Fluid) else references[other.name].thin
        total = total + over_pairs(scene, fluid, of_pair, own, senders, neighbors, None, forward_mode, thin)
    return total
