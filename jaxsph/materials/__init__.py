"""Material laws."""

from jaxsph.materials.elastic import (
    ElasticLaw,
    NeoHookean,
    StVenantKirchhoff,
    lame_parameters,
    p_wave_speed,
    von_mises,
)

__all__ = ["ElasticLaw", "NeoHookean", "StVenantKirchhoff", "lame_parameters", "p_wave_speed", "von_mises"]
