"""S03, S04, S09: cantilevers at rest under their own weight, reached by damping."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from motion import TIP
from reference import number
from rows import Case, Row, across, precision

import jaxsph

# Residual speed over that of a vibration of the deflection's size: a part of the smallest limit. In float32 rounding
# keeps the fastest modes moving at some 4e-3 of it; their displacements are thousands of times smaller.
STATIC_LIMITS = {"float64": 1e-3, "float32": 1e-2}


def settle(scene: jaxsph.Scene, at, angular_frequency: float) -> tuple[np.ndarray, float]:
    """Tip displacement (d,) [m] at rest, and the largest speed left, over angular frequency times deflection.

    The scene's damping is critical for its first mode, so that every mode falls by exp(-w t) or nearly.
    """
    t_end = 14 / angular_frequency  # exp(-14) (1 + 14) = 1e-5
    run = jaxsph.simulate(scene, t_end, t_end / 10)
    name = scene.systems[0].name
    tip = np.asarray(run.probe(name, at).displacement, float)[-1]
    speed = float(np.max(np.abs(np.asarray(run[name]["velocity"][-1], float))))
    return tip, speed / (angular_frequency * float(np.max(np.abs(tip))))


def turek_hron(case: str, youngs_modulus: float, quick: bool) -> Iterator[list[Row]]:
    """CSM1 or CSM2."""
    frequency = 1.0956 * np.sqrt(youngs_modulus / 1.4e6)  # of CSM3, scaled with the stiffness
    damping = jaxsph.Damping(2 * 2 * np.pi * frequency)
    uy = number("solid/turek_hron_csm.csv", "value_or_mean", case=case, quantity="uy_A")
    ux = number("solid/turek_hron_csm.csv", "value_or_mean", case=case, quantity="ux_A")
    runs = [(5, np.float64), (9, np.float64), (9, np.float32), (17, np.float64)]
    limits = {9: 0.03, 17: 0.015}
    for particles, dtype in runs[:1] if quick else runs:
        scene = jaxsph.scenes.turek_hron_beam(particles, youngs_modulus=youngs_modulus, effects=[damping], dtype=dtype)
        tip, residual = settle(scene, TIP, 2 * np.pi * frequency)
        limit, where = limits.get(particles), (across(particles), precision(dtype))
        yield [
            Row("relative error, tip uy", abs(tip[1] / uy - 1), limit, *where),
            # the tip shortens with the square of the deflection: twice its error
            Row("relative error, tip ux", abs(tip[0] / ux - 1), None if limit is None else 2 * limit, *where),
            Row("residual speed / (2 pi f |uy|)", residual, STATIC_LIMITS[where[1]], *where),
        ]


def csm1(quick: bool) -> Iterator[list[Row]]:
    return turek_hron("CSM1", 1.4e6, quick)


def csm2(quick: bool) -> Iterator[list[Row]]:
    return turek_hron("CSM2", 5.6e6, quick)


def elastica(quick: bool) -> Iterator[list[Row]]:
    """A slender bar (L / h = 20) whose weight makes w L^3 / EI = 1; shear adds .3 % to the elastica's deflection."""
    length, thickness, density, modulus, poisson = 0.4, 0.02, 1000.0, 1.4e6, 0.3
    bending = modulus * thickness**3 / 12 / (1 - poisson**2)
    gravity = bending / (density * thickness * length**3)
    angular_frequency = 1.8751**2 * np.sqrt(bending / (density * thickness * length**4))
    limits = {9: 0.03}
    for particles in (5,) if quick else (5, 9):
        scene = jaxsph.scenes.cantilever(
            length,
            thickness,
            particles,
            density=density,
            youngs_modulus=modulus,
            poisson_ratio=poisson,
            gravity=(0.0, -gravity),
            effects=[jaxsph.Damping(2 * angular_frequency)],
            dtype=np.float64,
        )
        tip, residual = settle(scene, (length, 0.0), angular_frequency)
        expected = number("solid/elastica_self_weight.csv", "uy_tip_over_L") * length
        where = (across(particles), "float64")
        yield [
            Row("relative error, tip uy", abs(tip[1] / expected - 1), limits.get(particles), *where),
            Row("residual speed / (2 pi f |uy|)", residual, STATIC_LIMITS[where[1]], *where),
        ]


CASES = [
    Case("S03", "Turek-Hron beam, CSM1 (static)", csm1),
    Case("S04", "Turek-Hron beam, CSM2 (static)", csm2),
    Case("S09", "Elastica under its own weight, w L^3 / EI = 1", elastica),
]
