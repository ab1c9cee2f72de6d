"""What a scene may or may not call for, one file each. An effect that a scene does not list is not compiled."""

from jaxsph.effects.acoustic_damper import AcousticDamper
from jaxsph.effects.artificial_viscosity import ArtificialViscosity
from jaxsph.effects.body_force import BodyForce
from jaxsph.effects.contact import Contact
from jaxsph.effects.damping import Damping
from jaxsph.effects.density_diffusion import DeltaDiffusion, DensityDiffusion
from jaxsph.effects.flow_effect import FlowEffect
from jaxsph.effects.gradient_correction import KernelGradientCorrection
from jaxsph.effects.kelvin_voigt import KelvinVoigt
from jaxsph.effects.penalty import PenaltyForce
from jaxsph.effects.shepard_filter import ShepardFilter
from jaxsph.effects.shifting import ParticleShifting, Shifting, TransportVelocity
from jaxsph.effects.tensile_control import TensileControl
from jaxsph.effects.wall_repulsion import WallRepulsion

__all__ = [
    "AcousticDamper",
    "ArtificialViscosity",
    "BodyForce",
    "Contact",
    "Damping",
    "DeltaDiffusion",
    "DensityDiffusion",
    "FlowEffect",
    "KelvinVoigt",
    "KernelGradientCorrection",
    "ParticleShifting",
    "PenaltyForce",
    "ShepardFilter",
    "Shifting",
    "TensileControl",
    "TransportVelocity",
    "WallRepulsion",
]
