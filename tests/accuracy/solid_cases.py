"""Solids: the Turek-Hron beam, and a column of water on an elastic plate."""

from __future__ import annotations

import numpy as np
from cases import Case, studied
from motion import TIP, csm3_reference, oscillation  # pyright: ignore[reportMissingImports]
from reference import number  # pyright: ignore

import jaxsph
from jaxsph.accuracy import Results, Study, grid
from jaxsph.pytree import replace

DEFLECTION = number("fsi/hydrostatic_plate_fem.csv", "w_fem_midplane_m", nu="0.3")


def csm3(quick: bool) -> Results:
    """Amplitude and frequency of the tip over ten seconds, beside finite elements by the same processing."""
    expected = csm3_reference()

    def error_of(run):
        found = oscillation(np.asarray(run.times, float), np.asarray(run.probe("beam", TIP).displacement[:, 1], float))
        names = ("frequency", "amplitude", "fundamental")
        return {name: abs(getattr(found, name) / getattr(expected, name) - 1) for name in names}

    def scene_of(particles=5, penalty=0.05):
        scene = jaxsph.scenes.turek_hron_beam(particles)
        effects = (jaxsph.PenaltyForce(penalty),) if penalty else ()
        return replace(scene, effects=effects)

    study = Study(scene_of, 10.0, 0.005, error_of=error_of, title="Beam CSM3, 10 s of free motion")
    two = {"particles": (5, 9), "precision": ("float32",)}
    settings = [
        *grid(precision=["float32"], particles=(3, 5, 7, 9, 13)),
        *grid(precision=["float64"], particles=(5, 9)),
        *grid(**two, step_fraction=(0.45,)),
        *grid(**two, penalty=(0.0, 0.01)),
        *grid(**two, neighbors=(14,)),
        *grid(precision=["float64"], particles=(3, 5), integrator=("Tsit5",), tolerance=(1e-4,)),
    ]
    return studied(study, settings, quick, grid(precision=["float32"], particles=(3, 5)))


def column_on_plate(quick: bool) -> Results:
    """Mean deflection of the middle over the second half of .5 s, in which the plate swings several times."""

    def error_of(run):
        middle = np.asarray(run.probe("plate", (0.5, -0.025)).displacement[:, 1], float)
        late = np.asarray(run.times, float) >= 0.25
        return {"deflection": abs(float(np.mean(middle[late])) / DEFLECTION - 1)}

    def scene_of(particles=5, smoothing=1.5):
        return jaxsph.scenes.water_column_on_plate(particles, smoothing=smoothing)

    title = "Column of water on an elastic plate, .25 to .5 s"
    study = Study(scene_of, 0.5, 0.0025, error_of=error_of, title=title)
    settings = [
        *grid(precision=["float32"], particles=(3, 4, 5, 7)),
        *grid(precision=["float64"], particles=(3, 5)),
        *grid(precision=["float32"], particles=(3, 5), smoothing=(2.0,)),
    ]
    return studied(study, settings, quick, grid(precision=["float32"], particles=(3,)))


CASES = [
    Case(
        "beam_csm3",
        "Beam CSM3",
        {
            "frequency": "relative error of the frequency",
            "amplitude": "relative error of the amplitude",
            "fundamental": "relative error of the amplitude of the fundamental",
        },
        csm3,
        (0.02, 0.01, 0.005),
    ),
    Case(
        "column_on_plate",
        "Column on a plate",
        {"deflection": "relative error of the mean deflection"},
        column_on_plate,
        (0.1, 0.05),
        (10.0, 60.0),
    ),
]
