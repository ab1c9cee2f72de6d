"""Material laws."""

from jaxsph.materials.elastic import (
    ElasticLaw,
    NeoHookean,
    StVenantKirchhoff,
    lame_parameters,
    p_wave_speed,
    von_mises,
)
from jaxsph.materials.state_equation import Cole, LinearStateEquation, StateEquation
from jaxsph.materials.viscosity import AdamiViscosity, MonaghanViscosity, MorrisViscosity, ViscosityLaw

__all__ = [
    "AdamiViscosity",
    "Cole",
    "ElasticLaw",
    "LinearStateEquation",
    "MonaghanViscosity",
    "MorrisViscosity",
    "NeoHookean",
    "StVenantKirchhoff",
    "StateEquation",
    "ViscosityLaw",
    "lame_parameters",
    "p_wave_speed",
    "von_mises",
]
