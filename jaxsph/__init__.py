"""Differentiable smoothed particle hydrodynamics in JAX."""

from jaxsph.versions import __version__, check_jax_version

check_jax_version()

from jaxsph import observe, scenes  # noqa: E402
from jaxsph.dynamics import stable_time_step, topologies  # noqa: E402
from jaxsph.effects import Damping, PenaltyForce  # noqa: E402
from jaxsph.errors import NotFinite, SimulationError, UnstableTimeStep  # noqa: E402
from jaxsph.geometry import Particles, ball, box, jitter  # noqa: E402
from jaxsph.integrate import Diffrax, KickDriftKick  # noqa: E402
from jaxsph.kernels import (  # noqa: E402
    CubicSpline,
    Gaussian,
    QuarticSpline,
    QuinticSpline,
    WendlandC2,
    WendlandC4,
    WendlandC6,
)
from jaxsph.materials import NeoHookean, StVenantKirchhoff  # noqa: E402
from jaxsph.pair_sum import Edges, PairList, pair_edges, pair_sum  # noqa: E402
from jaxsph.scene import Scene  # noqa: E402
from jaxsph.simulate import simulate  # noqa: E402
from jaxsph.state import State, initial_state  # noqa: E402
from jaxsph.structure import Structure  # noqa: E402
from jaxsph.trajectory import Trajectory  # noqa: E402

__all__ = [
    "CubicSpline",
    "Damping",
    "Diffrax",
    "Edges",
    "Gaussian",
    "KickDriftKick",
    "NeoHookean",
    "NotFinite",
    "PairList",
    "Particles",
    "PenaltyForce",
    "QuarticSpline",
    "QuinticSpline",
    "Scene",
    "SimulationError",
    "StVenantKirchhoff",
    "State",
    "Structure",
    "Trajectory",
    "UnstableTimeStep",
    "WendlandC2",
    "WendlandC4",
    "WendlandC6",
    "__version__",
    "ball",
    "box",
    "check_jax_version",
    "initial_state",
    "jitter",
    "observe",
    "pair_edges",
    "pair_sum",
    "scenes",
    "simulate",
    "stable_time_step",
    "topologies",
]
