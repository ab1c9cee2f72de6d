"""Elastic structures by total-Lagrangian SPH: equations (14) to (20) of the poster.

All sums run over the neighbors in the reference configuration, which never change. The unknown is the
displacement u = x - X, and H = F - I is its gradient, so that nothing is lost to rounding in float32.

Sources: J. O'Connor, B. D. Rogers (2021), J. Fluids Struct. 104, 103312 (momentum equation, correction
matrix); G. C. Ganzenmueller (2015), Comput. Methods Appl. Mech. Eng. 286, 87 (penalty force).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxsph import checks
from jaxsph.geometry.shapes import Particles
from jaxsph.kernels import Kernel, WendlandC2
from jaxsph.materials.elastic import ElasticLaw, StVenantKirchhoff, lame_parameters
from jaxsph.pair_sum import Edges, PairList, dot, pair_edges, pair_sum
from jaxsph.pytree import as_real, is_concrete, pytree_dataclass, static
from jaxsph.system import System
from jaxsph.tensors import inverse
from jaxsph.walls import AdamiExtrapolation, WallPressure, check_model

SMOOTHING_LENGTH = 0.87
"""Smoothing length of a structure in particle spacings, for the Wendland C2 kernel: a compact neighborhood
(8 neighbors in 2D, 26 in 3D) whose gradient is moved inward least at a surface. See docs/formulation.md."""


@pytree_dataclass
class Structure(System):
    """An elastic body.

    Attributes:
        name: how the scene and its results call it.
        particles: positions X (N, d) [m] and volumes (N,) [m^d] in the reference configuration.
        density: rho_0 [kg/m^3], one number or (N,).
        youngs_modulus: E [Pa], one number or (N,).
        poisson_ratio: one number or (N,), between -1 and 0.5.
        clamped: which particles do not follow from forces: (N,) booleans, or a function of positions (N, d) that
            gives them. They stay where they are, or follow `motion`.
        motion: prescribed displacement of the clamped particles, motion(t, X (N, d)) -> (N, d) [m], written
            with jax.numpy; zero at t = 0. None holds them still.
        velocity: initial velocity (d,) or (N, d) [m/s].
        law: elastic law.
        kernel: smoothing kernel.
        smoothing_length: h [m]; None takes .87 spacings.
        pressure: model of the pressure with which a fluid meets it, as of a `Wall`.
        no_slip: whether viscous fluids stick to it.
        thickness: of a plate that may be thinner than the support radius of the fluids [m]; they then meet it as if it
            were as thick (see `jaxsph.thin_wall`). None takes it as thick.

    Raises:
        ValueError: a value out of its range, with the limit; a shape that does not fit.
    """

    name: str = static()
    particles: Particles
    density: Any
    youngs_modulus: Any
    poisson_ratio: Any
    clamped: Any = None
    motion: Callable | None = static(default=None)
    velocity: Any = None
    law: ElasticLaw = StVenantKirchhoff()
    kernel: Kernel = WendlandC2()
    smoothing_length: Any = None
    pressure: WallPressure = AdamiExtrapolation()
    no_slip: bool = static(default=True)
    thickness: float | None = static(default=None)

    def __post_init__(self):
        n, d = self.particles.positions.shape
        real = self.particles.positions.dtype
        checks.check_name(self.name, "youngs_modulus")
        for name in ("density", "youngs_modulus", "poisson_ratio"):
            object.__setattr__(self, name, as_real(getattr(self, name), real))
        clamped = self.clamped
        if callable(clamped):
            clamped = clamped(np.asarray(self.particles.positions))
        clamped = np.zeros(n, bool) if clamped is None else np.asarray(clamped)
        if clamped.shape != (n,) or clamped.dtype != bool:
            raise ValueError(f"clamped has shape {clamped.shape} and type {clamped.dtype}; it must be ({n},) booleans")
        object.__setattr__(self, "clamped", clamped)
        velocity = np.zeros(d) if self.velocity is None else self.velocity
        object.__setattr__(self, "velocity", as_real(velocity, real))
        check_model(self)
        checks.check_kind(f"{self.name}.law", self.law, ElasticLaw, "NeoHookean()")
        checks.check_kind(f"{self.name}.kernel", self.kernel, Kernel, "WendlandC4()")
        if self.motion is not None and not clamped.any():
            raise ValueError(
                f"{self.name}.motion moves the clamped particles, and none is clamped; say which, clamped="
            )
        checks.check_motion(self, clamped)
        h = SMOOTHING_LENGTH * self.particles.spacing if self.smoothing_length is None else self.smoothing_length
        object.__setattr__(self, "smoothing_length", as_real(h, real))
        self.check()

    def check(self, prefix: str = "") -> None:
        """Raise ValueError if a number is out of its range or has a shape that does not fit. Traced ones pass.

        Args:
            prefix: before the names in the message, such as "plate.".
        """
        n, d = np.shape(self.particles.positions)
        for name, unit in (("density", "kg/m^3"), ("youngs_modulus", "Pa"), ("smoothing_length", "m")):
            checks.check_positive(prefix + name, getattr(self, name), unit)
        if self.thickness is not None:
            checks.check_positive(prefix + "thickness", self.thickness, "m")
        checks.check_poisson_ratio(self.poisson_ratio)
        for name in ("density", "youngs_modulus", "poisson_ratio"):
            shape = np.shape(getattr(self, name))
            if shape not in ((), (n,)):
                raise ValueError(f"{prefix}{name} has shape {shape}; it must be one number or ({n},), one a particle")
        if np.shape(self.velocity) not in ((d,), (n, d)):
            raise ValueError(f"{prefix}velocity has shape {np.shape(self.velocity)}; it must be ({d},) or ({n}, {d})")
        checks.check_finite(f"{prefix}velocity", self.velocity)


@pytree_dataclass
class Topology:
    """What of a structure is fixed before any number is traced: the order of its particles and who is near whom.

    Attributes:
        order: (N,) the user's index of each particle in cell order.
        rank: (N,) place in cell order of each of the user's particles.
        neighbors: list of the reference configuration, in cell order, with the coincident left out.
        next_distance: of the nearest pair that is not listed [m]; the support radius may grow as far.
        thin: a `ThinWall` if fluids meet it and it is thinner than their support radius.
    """

    order: Any
    rank: Any
    neighbors: PairList
    next_distance: Any
    thin: Any = None

    def suffices(self, structure: Structure):
        """Whether the listed pairs are all within the support radius, which a traced smoothing length may change."""
        return structure.kernel.support_radius(structure.smoothing_length) <= self.next_distance


def topology(structure: Structure) -> Topology:
    """Find the neighbors in the reference configuration. Outside jit: it needs concrete positions.

    Raises:
        ValueError: traced positions or smoothing length, coincident particles, or a particle whose neighbors
            do not span the space, so that its correction matrix does not exist.
    """
    from scipy.spatial import KDTree  # .8 s to import

    if not is_concrete(structure.particles, structure.smoothing_length):
        raise ValueError(
            f"the positions or the smoothing length of {structure.name!r} are traced, so its neighbors cannot be "
            "found here; compute jaxsph.topologies(scene) outside of jit/grad and pass it as topologies_of_scene="
        )
    positions = np.asarray(structure.particles.positions, np.float64)
    n = len(positions)
    cutoff = float(np.asarray(structure.kernel.support_radius(float(structure.smoothing_length))))
    cells = np.floor((positions - positions.min(axis=0)) / cutoff).astype(np.int64)
    order = np.lexsort([*positions.T[::-1], *cells.T[::-1]])
    positions = positions[order]
    tree = KDTree(positions)
    pairs = tree.query_pairs(cutoff * (1 - 1e-9), output_type="ndarray")
    receivers, senders = np.concatenate([pairs, pairs[:, ::-1]]).T
    by_receiver = np.lexsort([senders, receivers])
    receivers, senders = receivers[by_receiver], senders[by_receiver]
    count = np.bincount(receivers, minlength=n)
    _check_neighborhoods(structure, positions, receivers, senders, count, order)
    slot = np.arange(len(receivers)) - np.repeat(np.cumsum(count) - count, count)
    indices = np.tile(np.arange(n), (max(int(count.max(initial=0)), 1), 1))
    indices[slot, receivers] = senders
    rank = np.empty(n, np.int64)
    rank[order] = np.arange(n)
    return Topology(
        order.astype(np.int32),
        rank.astype(np.int32),
        PairList(indices.astype(np.int32), count.astype(np.int32)),
        np.asarray(_next_distance(tree, cutoff, int(count.max(initial=0))), structure.dtype),
    )


def _next_distance(tree, cutoff, most):
    """The smallest distance of a pair that is larger than a cutoff, if a particle has `most` neighbors within it."""
    distance, _ = tree.query(tree.data, k=min(most + 2, tree.n))
    beyond = distance[distance > cutoff * (1 - 1e-9)]
    return float(np.min(beyond, initial=np.inf))


def _check_neighborhoods(structure, positions, receivers, senders, count, order):
    n, d = positions.shape
    offsets = (positions[senders] - positions[receivers]) / structure.particles.spacing
    if len(offsets) and np.min(np.sum(offsets**2, axis=1)) < 1e-12:
        pair = int(np.argmin(np.sum(offsets**2, axis=1)))
        i, j = order[receivers[pair]], order[senders[pair]]
        raise ValueError(f"particles {i} and {j} of {structure.name!r} are at the same place; leave one out")
    moments = np.zeros((n, d, d))
    np.add.at(moments, receivers, offsets[:, :, None] * offsets[:, None, :])
    flat = np.linalg.eigvalsh(moments)[:, 0] < 1e-3
    if flat.any():
        worst = int(np.argmax(flat))
        raise ValueError(
            f"particle {order[worst]} of {structure.name!r} at {positions[worst]} has {count[worst]} neighbors, which "
            f"do not span {d} dimensions: its correction matrix (16) does not exist. Make the body at least two "
            f"particles thick, or the smoothing length ({float(structure.smoothing_length):.4g} m) larger"
        )


@pytree_dataclass
class Reference:
    """A structure made ready: everything about the reference configuration that the sums need.

    Component first, particle last, in cell order. `uniform` and `varying` are the material fields that are one
    number, and those that differ from particle to particle (only these are gathered). `cells` are the volumes with
    which fluids meet the particles.
    """

    neighbors: PairList
    edges: Edges
    correction: Any
    uniform: dict
    varying: dict
    volume: Any
    cells: Any
    moving: Any
    positions: Any
    thin: Any = None

    @property
    def mass(self):
        """Masses (N,) [kg, in 2D per meter]."""
        return {**self.uniform, **self.varying}["density"] * self.volume


def reference(structure: Structure, topology: Topology, *, penalty: bool) -> Reference:
    """Correction matrix (16) and the kernel gradients of all pairs; differentiable in every number of the structure."""
    order, neighbors = topology.order, topology.neighbors
    positions = jnp.asarray(structure.particles.positions)[order].T
    volume = jnp.asarray(structure.particles.volumes)[order]
    h = structure.smoothing_length

    def geometry(a, b):
        x_ab = a["position"] - b["position"]
        volumes = a["volume"] * b["volume"]
        edge = {"gradient": volumes * structure.kernel.gradient(x_ab, h)}
        if penalty:
            squared = dot(x_ab, x_ab)
            weight = structure.kernel.w(x_ab, h) / jnp.where(squared > 0, squared, 1.0)
            edge |= {"reference": x_ab, "penalty_weight": volumes * weight}
        return edge

    # With both volumes in it every pair is symmetric or antisymmetric, and its gradient costs half.
    edges = pair_edges(geometry, {"position": positions, "volume": volume}, neighbors, backward=False)
    # V_a sum_b V_b grad W X_ba^T: the sign for which (16) and (17) give F = I when nothing has moved.
    moment = pair_sum(
        lambda a, b, edge: edge["gradient"][:, None] * (b - a)[None, :],
        positions, positions, neighbors, edges, symmetry=1,
    )  # fmt: skip
    materials = {name: getattr(structure, name) for name in ("density", "youngs_modulus", "poisson_ratio")}
    lam, mu = lame_parameters(materials["youngs_modulus"], materials["poisson_ratio"])
    materials |= {"lam": lam, "mu": mu}
    return Reference(
        neighbors=neighbors,
        edges=edges,
        correction=inverse(moment / volume),  # of numbers near 1: in float32 a determinant of volumes is zero early
        uniform={name: value for name, value in materials.items() if jnp.ndim(value) == 0},
        varying={name: jnp.asarray(value)[order] for name, value in materials.items() if jnp.ndim(value) == 1},
        volume=volume,
        cells=jnp.asarray(structure.particles.cells)[order],
        moving=jnp.asarray(~structure.clamped[order], positions.dtype),
        positions=positions,
        thin=topology.thin,
    )
