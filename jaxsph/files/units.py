"""Units of the fields and parameters that a file holds (SI), and the list of a scene's parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxsph.files.leaves import named_leaves

UNITS: Mapping[str, str] = {
    "position": "m",
    "remainder": "m",
    "reference_position": "m",
    "displacement": "m",
    "spacing": "m",
    "smoothing_length": "m",
    "velocity": "m/s",
    "angular_velocity": "rad/s",
    "shift": "m/s",
    "speed": "m/s",
    "sound_speed": "m/s",
    "acceleration": "m/s^2",
    "surface_acceleration": "m/s^2",
    "gravity": "m/s^2",
    "density": "kg/m^3",
    "density_deviation": "kg/m^3",
    "density_rate": "kg/(m^3 s)",
    "density_gradient": "kg/m^4",
    "cover": "1",
    "mass": "kg",
    "volume": "m^3",
    "pressure": "Pa",
    "stress": "Pa",
    "von_mises": "Pa",
    "von_mises_stress": "Pa",
    "cauchy": "Pa",
    "cauchy_stress": "Pa",
    "youngs_modulus": "Pa",
    "background_pressure": "Pa",
    "modulus": "Pa",
    "poisson_ratio": "1",
    "coefficient": "1",
    "alpha": "1",
    "beta": "1",
    "strength": "1",
    "exponent": "1",
    "deformation_gradient": "1",
    "viscosity": "Pa s",
    "kinematic_viscosity": "m^2/s",
    "time": "s",
    "time_step": "s",
    "relaxation_time": "s",
    "rate": "1/s",
    "force": "N",
    "energy": "J",
}
"""Unit of each field and parameter by its name; "1" is dimensionless."""

_LARGEST_LISTED = 16


def parameters(tree: Any, units: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    """List the small leaves of a scene as `{"name", "value", "unit"}`, ready for JSON.

    `name` is where the leaf stands in the tree, `unit` comes from the last word of that name (`units` first,
    then `UNITS`, else ""). Leaves of more than 16 numbers (particle arrays) are left out: the scene's
    fingerprint covers them.
    """
    known = {**UNITS, **(units or {})}
    listed = []
    for name, leaf in named_leaves(tree):
        value = np.asarray(leaf)
        if value.size <= _LARGEST_LISTED and value.dtype.kind in "biuf":
            listed.append({"name": name, "value": value.tolist(), "unit": known.get(name.rsplit(".", 1)[-1], "")})
    return listed
