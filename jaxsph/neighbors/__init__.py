"""Neighbor lists of fixed capacity: allocated outside jit, updated inside.

    search = neighbor_list(Domain((0, 0), (1, 2)), cutoff=0.03, skin=0.003)
    neighbors = search.allocate(positions)             # picks the sizes of the arrays; positions (d, N)
    neighbors = search.update(positions, neighbors)    # inside jit
    raise_if_wrong(neighbors)                          # overflow, particle outside

The conventions are those of jax-md, whose builder can be chosen too (`builder="jax-md"`).
"""

from jaxsph.neighbors.build import NeighborSearch, neighbor_list, search_of
from jaxsph.neighbors.cells import CellGrid
from jaxsph.neighbors.domain import Domain
from jaxsph.neighbors.jax_md import from_jax_md, to_jax_md
from jaxsph.neighbors.lists import NeighborList, is_valid, moved, raise_if_wrong, safe_steps, skin_message
from jaxsph.neighbors.regions import Closing, closing, far_enough
from jaxsph.neighbors.search import Capacity

__all__ = [
    "Capacity",
    "CellGrid",
    "Closing",
    "Domain",
    "NeighborList",
    "NeighborSearch",
    "closing",
    "far_enough",
    "from_jax_md",
    "is_valid",
    "moved",
    "neighbor_list",
    "raise_if_wrong",
    "safe_steps",
    "search_of",
    "skin_message",
    "to_jax_md",
]
