"""What the positions of the start tell: where a surface is free, how far fluid can fall, how thick things are."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

SAMPLE = 2000
"""Of more particles than these so many are looked at, at random but always the same."""

LATTICE_GAP = 1.5
"""Spacings between two particles of a column beyond which there is a gap."""


class Places:
    """Particles of some systems: positions (N, d) [m], volumes (N,), and a tree that knows the periodic directions."""

    def __init__(self, systems, domain):
        self.positions = np.concatenate([np.asarray(s.particles.positions, float) for s in systems])
        self.volumes = np.concatenate([np.asarray(s.particles.volumes, float) for s in systems])
        d = self.positions.shape[1]
        self.periodic = np.zeros(d, bool) if domain is None else np.broadcast_to(domain.periodic, d)
        self.domain, self.size = domain, np.zeros(d) if domain is None else np.asarray(domain.lengths)
        period = None if domain is None else domain.for_tree(self.positions)[1]
        self.tree = KDTree(self.wrapped(self.positions), boxsize=period)

    def wrapped(self, points):
        """Points (N, d) as the tree has them, inside the periods."""
        return points if self.domain is None else self.domain.for_tree(points)[0]

    def offsets(self, points, indices):
        """From points (M, d) to particles with indices (M, K), the nearest images, (M, K, d)."""
        away = self.positions[indices] - points[:, None]
        size = np.where(self.periodic, self.size, 1.0)
        return np.where(self.periodic, away - size * np.round(away / size), away)


def some(positions, most: int = SAMPLE):
    """At most so many of the positions (N, d)."""
    positions = np.asarray(positions, float)
    if len(positions) <= most:
        return positions
    return positions[np.random.default_rng(0).choice(len(positions), most, replace=False)]


def neighbors(scene, reach: float | int = 1) -> tuple[float, int]:
    """Mean and largest number of particles within so many support radii of a fluid particle, itself left out."""
    places, radius = Places([*scene.fluids, *boundaries(scene)], scene.domain), reach * support(scene)
    points = some(np.concatenate([np.asarray(f.particles.positions, float) for f in scene.fluids]))
    counts = places.tree.query_ball_point(places.wrapped(points), radius * (1 - 1e-6), return_length=True) - 1
    return float(np.mean(counts)), int(np.max(counts))


def boundaries(scene) -> list:
    """What fluids meet beside each other."""
    return [*scene.walls, *scene.solids]


def support(scene) -> float:
    """Support radius of the fluids [m]."""
    return float(scene.kernel.support_radius(np.asarray(scene.smoothing_length, float)))


def open_share(scene) -> float:
    """Share of the fluids' particles around which one side is empty: 0 in a domain that is full.

    The volume within 2.2 spacings of a particle has its center at the particle inside, and .4 of the radius away from a
    flat surface; half of that counts.
    """
    places, radius = Places([*scene.fluids, *boundaries(scene)], scene.domain), 2.2 * scene.spacing
    points = some(np.concatenate([np.asarray(f.particles.positions, float) for f in scene.fluids]))
    near = places.tree.query_ball_point(places.wrapped(points), radius)
    off = np.empty(len(points))
    for i, found in enumerate(near):
        weights = places.volumes[found]
        offset = places.offsets(points[i : i + 1], np.asarray(found)[None])[0]
        off[i] = np.linalg.norm(weights @ offset) / np.sum(weights) / radius
    return float(np.mean(off > 0.2))


def contact(scene, wall):
    """Places (M, d) of wall particles next to fluid at the start, and directions away from it; None if nowhere."""
    own = Places([wall], scene.domain)
    fluid = np.concatenate([np.asarray(f.particles.positions, float) for f in scene.fluids])
    distance, nearest = map(np.asarray, own.tree.query(own.wrapped(fluid)))
    touching = (distance < 1.2 * max(scene.spacing, wall.particles.spacing)) & (distance > 0)
    if not touching.any():
        return None
    chosen = np.flatnonzero(touching)
    chosen = chosen[:: -(-len(chosen) // SAMPLE)]
    away = own.offsets(fluid[chosen], nearest[chosen][:, None])[:, 0]
    return own.positions[nearest[chosen]], away / np.linalg.norm(away, axis=1, keepdims=True)


def layers(scene, wall) -> float | None:
    """Layers of particles behind the surface of a wall, where fluid touches it at the start; None if nowhere."""
    places, spacing, met = Places(boundaries(scene), scene.domain), wall.particles.spacing, contact(scene, wall)
    if met is None:
        return None
    start, inward = met
    found, going = np.ones(len(start)), np.ones(len(start), bool)
    for k in range(1, 12):
        going &= places.tree.query(places.wrapped(start + k * spacing * inward))[0] < 0.75 * spacing
        found += going
    return float(np.median(found))


def layers_needed(scene, wall) -> int:
    """Layers that a fluid particle half a spacing from a wall can see."""
    return max(1, int(np.ceil(support(scene) / wall.particles.spacing - 1e-6)) - 1)


def extent(positions, spacing: float | int):
    """Sizes (d,) [m] of the box around particles in the middle of their cells."""
    return np.ptp(np.asarray(positions, float), axis=0) + spacing


def across(structure) -> int:
    """Particles across the smallest extent of what is not clamped, along the axes and its principal directions."""
    free = np.asarray(structure.particles.positions, float)[~np.asarray(structure.clamped)]
    if not len(free):
        return 0
    centered = free - free.mean(axis=0)
    principal = centered @ np.linalg.svd(centered, full_matrices=False)[2].T if len(free) > 2 else centered
    smallest = min(np.min(np.ptp(centered, axis=0)), np.min(np.ptp(principal, axis=0)))
    return round(float(smallest) / structure.particles.spacing) + 1


def fall_and_depth(scene, up) -> tuple[float, float]:
    """How far the highest fluid, or the underside of a structure that is free, can fall, and the depth of fluid [m].

    In columns two spacings wide: the floor is what wall there is from below until the first gap, the surface what fluid
    is on it until the first gap. A column without wall has the lowest fluid for its floor.

    Args:
        up: (d,) direction against gravity.
    """
    width, gap = 2 * scene.spacing, LATTICE_GAP * scene.spacing
    fluid = np.concatenate([np.asarray(f.particles.positions, float) for f in scene.fluids])
    solid = [np.asarray(w.particles.positions, float) for w in scene.walls]
    wall = np.concatenate(solid) if solid else np.empty((0, len(up)))
    level = fluid @ up
    loose = [np.asarray(s.particles.positions, float)[~np.asarray(s.clamped)] @ up for s in scene.structures]
    undersides = [np.min(heights) - 0.5 * scene.spacing for heights in loose if len(heights)]
    top = max(np.max(level) + 0.5 * scene.spacing, *undersides, -np.inf)
    lowest = np.min(level) - 0.5 * scene.spacing
    axes = np.argsort(np.abs(up))[:-1]  # the horizontal ones, as near as axes are
    everything = np.concatenate([fluid, wall])
    column = np.floor((everything[:, axes] - everything[:, axes].min(axis=0)) / width).astype(int)
    number = np.unique(column, axis=0, return_inverse=True)[1].reshape(-1)
    heights, is_wall = everything @ up, np.arange(len(everything)) >= len(fluid)
    order = np.lexsort((heights, number))
    fall = depth = 0.0
    for part in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        walls, fluids = heights[part[is_wall[part]]], heights[part[~is_wall[part]]]
        floor = _until_gap(walls, gap) + 0.5 * scene.spacing if len(walls) else lowest
        above = fluids[fluids > floor]
        surface = floor
        if len(above) and above[0] < floor + gap:
            surface = _until_gap(above, gap) + 0.5 * scene.spacing
        if floor < top:
            fall, depth = max(fall, top - surface), max(depth, surface - floor)
    return fall, depth


def _until_gap(heights, gap):
    """The last of sorted heights before the first gap."""
    gaps = np.flatnonzero(np.diff(heights) > gap)
    return heights[gaps[0]] if len(gaps) else heights[-1]
