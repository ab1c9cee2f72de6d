"""Differentiable smoothed particle hydrodynamics in JAX."""

from jaxsph.versions import __version__, check_jax_version

check_jax_version()

from jaxsph import accuracy, observe, scenes  # noqa: E402
from jaxsph.density import EDAC, ContinuityDensity, SummationDensity  # noqa: E402
from jaxsph.dynamics import topologies  # noqa: E402
from jaxsph.effects import (  # noqa: E402
    AcousticDamper,
    ArtificialViscosity,
    BodyForce,
    Contact,
    Damping,
    DeltaDiffusion,
    DensityDiffusion,
    KelvinVoigt,
    KernelGradientCorrection,
    ParticleShifting,
    PenaltyForce,
    ShepardFilter,
    TensileControl,
    TransportVelocity,
    WallRepulsion,
)
from jaxsph.error_control import Diffrax  # noqa: E402
from jaxsph.errors import (  # noqa: E402
    NeighborOverflow,
    NotFinite,
    ParticleOutside,
    SimulationError,
    SkinExceeded,
    UnstableTimeStep,
)
from jaxsph.fluid import Fluid  # noqa: E402
from jaxsph.geometry import Particles, ball, box, clamped_strip, jitter, polygon, tank  # noqa: E402
from jaxsph.integrate import KickDriftKick  # noqa: E402
from jaxsph.kernels import (  # noqa: E402
    CubicSpline,
    Gaussian,
    QuarticSpline,
    QuinticSpline,
    WendlandC2,
    WendlandC4,
    WendlandC6,
)
from jaxsph.materials import (  # noqa: E402
    AdamiViscosity,
    Cole,
    LinearStateEquation,
    MonaghanViscosity,
    MorrisViscosity,
    NeoHookean,
    StVenantKirchhoff,
)
from jaxsph.neighbors import Domain  # noqa: E402
from jaxsph.packing import Packed, relax  # noqa: E402
from jaxsph.pair_sum import Edges, PairList, pair_edges, pair_sum  # noqa: E402
from jaxsph.rigid_body import RigidBody  # noqa: E402
from jaxsph.scene import Scene  # noqa: E402
from jaxsph.simulate import simulate  # noqa: E402
from jaxsph.stable_step import stable_substeps, stable_time_step  # noqa: E402
from jaxsph.state import State, initial_state  # noqa: E402
from jaxsph.structure import Structure  # noqa: E402
from jaxsph.trajectory import Trajectory  # noqa: E402
from jaxsph.walls import (  # noqa: E402
    AdamiExtrapolation,
    BernoulliExtrapolation,
    PressureMirroring,
    PressureZeroing,
    Wall,
    WallContinuity,
    WallSummation,
)

__all__ = [
    "EDAC",
    "AcousticDamper",
    "AdamiExtrapolation",
    "AdamiViscosity",
    "ArtificialViscosity",
    "BernoulliExtrapolation",
    "BodyForce",
    "Cole",
    "Contact",
    "ContinuityDensity",
    "CubicSpline",
    "Damping",
    "DeltaDiffusion",
    "DensityDiffusion",
    "Diffrax",
    "Domain",
    "Edges",
    "Fluid",
    "Gaussian",
    "KelvinVoigt",
    "KernelGradientCorrection",
    "KickDriftKick",
    "LinearStateEquation",
    "MonaghanViscosity",
    "MorrisViscosity",
    "NeighborOverflow",
    "NeoHookean",
    "NotFinite",
    "Packed",
    "PairList",
    "ParticleOutside",
    "ParticleShifting",
    "Particles",
    "PenaltyForce",
    "PressureMirroring",
    "PressureZeroing",
    "QuarticSpline",
    "QuinticSpline",
    "RigidBody",
    "Scene",
    "ShepardFilter",
    "SimulationError",
    "SkinExceeded",
    "StVenantKirchhoff",
    "State",
    "Structure",
    "SummationDensity",
    "TensileControl",
    "Trajectory",
    "TransportVelocity",
    "UnstableTimeStep",
    "Wall",
    "WallContinuity",
    "WallRepulsion",
    "WallSummation",
    "WendlandC2",
    "WendlandC4",
    "WendlandC6",
    "__version__",
    "accuracy",
    "ball",
    "box",
    "check_jax_version",
    "clamped_strip",
    "initial_state",
    "jitter",
    "observe",
    "pair_edges",
    "pair_sum",
    "polygon",
    "relax",
    "scenes",
    "simulate",
    "stable_substeps",
    "stable_time_step",
    "tank",
    "topologies",
]
