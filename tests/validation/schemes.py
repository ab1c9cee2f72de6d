"""F31 to F34: schemes that a scene may call for, each where it belongs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from flows import vortex_errors
from rows import Case, Row, precision

import jaxsph
from jaxsph.pytree import replace
from jaxsph.scenes.free_flow import rings

GRAVITY = 9.81


def corrected(quick: bool) -> Iterator[list[Row]]:
    """Taylor-Green vortex from particles moved by up to a fifth of the spacing, with and without the correction."""
    usual = [jaxsph.DensityDiffusion(0.1), jaxsph.ParticleShifting(1.0)]
    particles, errors = 25 if quick else 50, {}
    for dtype in (np.float32,) if quick else (np.float32, np.float64):
        for name, extra in (("usual", []), ("corrected", [jaxsph.KernelGradientCorrection()])):
            scene = jaxsph.scenes.taylor_green(particles, disorder=0.2, effects=[*usual, *extra], dtype=dtype)
            errors[name], effective = vortex_errors(jaxsph.simulate(scene, 1.0, 0.05))
            where = (f"{particles} x {particles}, disordered", precision(dtype))
            yield [
                Row(f"relative L1 error of the speed, t = 1, {name}", errors[name], 0.03, *where),
                Row(f"|effective / physical viscosity - 1|, {name}", effective, None, *where),
            ]


def edac(quick: bool) -> Iterator[list[Row]]:
    """Taylor-Green vortex with the pressure as a field of its own and particles moved by a background pressure."""
    particles = 25 if quick else 50
    for dtype in (np.float32,) if quick else (np.float32, np.float64):
        effects = [jaxsph.TransportVelocity()]
        # From a lattice the vortex runs along rows of particles until rounding breaks them: later in float64.
        scene = jaxsph.scenes.taylor_green(particles, disorder=0.2, effects=effects, density=jaxsph.EDAC(), dtype=dtype)
        error, effective = vortex_errors(jaxsph.simulate(scene, 1.0, 0.05))
        where = (f"{particles} x {particles}, disordered", precision(dtype))
        yield [
            Row("relative L1 error of the speed, t = 1", error, 0.03, *where),
            Row("|effective / physical viscosity - 1|", effective, 0.02, *where),
        ]


def filtered(quick: bool) -> Iterator[list[Row]]:
    """Still water as F09, the density smoothed every 20 steps instead of diffused."""
    height, density, particles = 0.9, 1000.0, 20
    unit = np.sqrt(height / GRAVITY)
    for dtype in (np.float32,) if quick else (np.float32, np.float64):
        effects = [jaxsph.ShepardFilter(20), jaxsph.ArtificialViscosity(0.02)]
        scene = jaxsph.scenes.still_water(particles, height=height, density=density, effects=effects, dtype=dtype)
        run = jaxsph.simulate(scene, 10 * unit, unit)
        fields = run["water"]
        exact = density * GRAVITY * (height - np.asarray(fields["position"][-1, :, 1], float))
        error = np.asarray(jaxsph.observe.pressure(scene, run.final, "water"), float) - exact
        speed = np.max(np.linalg.norm(np.asarray(fields["velocity"][-1], float), axis=1)) / np.sqrt(GRAVITY * height)
        where = (f"{particles} over the depth", precision(dtype))
        yield [
            Row("relative L2 error of the pressure, t = 10 sqrt(H/g)",
                float(np.sqrt(np.sum(error**2) / np.sum(exact**2))), None, *where),
            Row("largest speed / sqrt(gH), t = 10 sqrt(H/g)", float(speed), None, *where),
        ]  # fmt: skip


def full_pipe(packed: bool, dtype, across: int = 40) -> jaxsph.Scene:
    """Water at rest that fills a round pipe of 1 m, cut out of a lattice; its particles packed or as they are."""
    spacing, radius, density = 1.0 / across, 0.5, 1000.0
    disk = jaxsph.ball((0.0, 0.0), radius, spacing, dtype=dtype)
    shell = rings((0.0, 0.0), radius + 4 * spacing, spacing, dtype=dtype)
    shell = shell.where(np.linalg.norm(shell.positions, axis=1) > radius)
    disk = replace(disk, volumes=np.full(len(disk), np.pi * radius**2 / len(disk), disk.positions.dtype))
    if packed:
        disk = jaxsph.relax(disk, walls=shell).particles
    water = jaxsph.Fluid(
        "water",
        disk,
        density=density,
        sound_speed=10 * np.sqrt(2 * GRAVITY * 2 * radius),
        pressure=lambda x: density * GRAVITY * (radius - x[:, 1]),
    )
    return jaxsph.Scene(
        water,
        jaxsph.Wall("pipe", shell, no_slip=False),
        gravity=(0.0, -GRAVITY),
        effects=[jaxsph.DeltaDiffusion(0.1), jaxsph.ArtificialViscosity(0.02)],
        smoothing_length=1.5 * spacing,
        domain=jaxsph.Domain((-1, -1), (1, 1)),
    )


def packing(quick: bool) -> Iterator[list[Row]]:
    """The largest speed within sqrt(D / g) of water that should stay at rest."""
    unit = np.sqrt(1.0 / GRAVITY)
    for dtype in (np.float32,) if quick else (np.float32, np.float64):
        fastest = {}
        for packed in (False, True):
            run = jaxsph.simulate(full_pipe(packed, dtype), unit, unit / 50)
            speed = np.linalg.norm(np.asarray(run["water"]["velocity"], float), axis=-1)
            fastest[packed] = float(speed.max()) / np.sqrt(GRAVITY)
        where = ("40 across a round pipe", precision(dtype))
        yield [
            Row("largest speed / sqrt(gD), cut out of a lattice", fastest[False], None, *where),
            Row("largest speed / sqrt(gD), packed", fastest[True], None, *where),
            Row("packed / cut out of a lattice", fastest[True] / fastest[False], 0.5, *where),
        ]


CASES = [
    Case("F31", "Taylor-Green vortex, KernelGradientCorrection", corrected),
    Case("F32", "Taylor-Green vortex, EDAC and TransportVelocity", edac),
    Case("F33", "Still water, ShepardFilter", filtered),
    Case("F34", "Water at rest in a round pipe, packing", packing),
]
