"""Gradients through a hundred steps with the schemes of tests/test_schemes.py: both modes, finite differences."""

import pytest
from test_flow_gradients import Case, check, column, vortex

import jaxsph as sph

VORTICES = {
    "edac": (sph.EDAC(), [sph.TransportVelocity()]),
    "damped": (sph.ContinuityDensity(), [sph.AcousticDamper(0.5), sph.DeltaDiffusion(0.1)]),
    "corrected": (sph.ContinuityDensity(), [sph.KernelGradientCorrection(), sph.ParticleShifting(1.0, 0.2)]),
    "edac averaged": (sph.EDAC(averaged_pressure=True), [sph.ParticleShifting(1.0, 0.2)]),
}

SLOW = {"edac averaged", "corrected"}


@pytest.mark.parametrize("which", [pytest.param(w, marks=pytest.mark.slow) if w in SLOW else w for w in VORTICES])
def test_vortex(which):
    check(Case(vortex(*VORTICES[which])))


@pytest.mark.slow
def test_edac_column_in_a_tank():
    check(Case(column(sph.EDAC(free_surface=True), [])))


@pytest.mark.slow
def test_column_that_walls_repel():
    """Of particles with a jitter of a tenth of a spacing some are closer to the wall's than a spacing."""
    check(Case(column(sph.ContinuityDensity(), [sph.DeltaDiffusion(0.1), sph.WallRepulsion(0.5)])))


@pytest.mark.slow
def test_filtered_column_in_a_tank():
    check(Case(column(sph.ContinuityDensity(), [sph.ShepardFilter(16)])))
