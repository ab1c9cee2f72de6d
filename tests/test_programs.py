"""What is absent from a scene is absent from the program: no arithmetic, no gather, no array in the state.

Programs are read before they are compiled, with lists and fields of which only the shapes are known.
"""

from functools import cache

import bodies
import fluids
import jax
import jax.numpy as jnp
import numpy as np
import programs
import pytest
from programs import numbers

import jaxsph as sph
from jaxsph import density, effects, materials, walls
from jaxsph.effects import FlowEffect, Shifting
from jaxsph.flow import density_rates, forces
from jaxsph.pytree import replace

N, WALL = 36, 90  # particles of the column and of its tank
OF_FLUID, OF_FLUID_AT_WALL = (2, N), (2, WALL)  # a vector, where fluid gathers and where the wall does
RATE, EXTRAPOLATION, FORCE = [(2, N), (2, N), (N,)], [(2, WALL), (WALL,), (WALL,)], [(2, N), (N,), (N,)]
"""What the passes of fluid over fluid, of wall over fluid, and of forces gather: position and velocity and density;
position, density and pressure, twice."""
BARE = [*RATE, (2, N), *EXTRAPOLATION, *FORCE, *FORCE]  # of a wall that stands still the rate gathers the position only


def bare(*listed, **about) -> sph.Scene:
    """Water in a tank, without anything that need not be: no viscosity, no effect."""
    of_wall = {key: about.pop(key) for key in ("motion", "velocity", "pressure", "no_slip") if key in about}
    scene = fluids.column(effects=listed, **{"viscosity": None, "velocity": None, **about})
    tank = replace(scene["tank"], **of_wall)
    return replace(scene, systems=(scene["water"], tank))


def pushed(time, positions):
    return jnp.zeros_like(positions).at[:, 0].set(time**2)


def swaying(positions, time):
    return jnp.cos(positions) * time


@cache
def of_bare():
    return programs.step(bare())


CALLED_FOR = {
    # what the scene calls for: (scene, vectors that a step gathers beside the bare one, what the fluid's state adds)
    "acoustic damper": (lambda: bare(sph.AcousticDamper()), [], {"density_rate": (N,)}),
    "artificial viscosity": (lambda: bare(sph.ArtificialViscosity()), [OF_FLUID], {}),
    "density diffusion": (lambda: bare(sph.DensityDiffusion()), [], {}),
    # the gradient for the rate, and with the forces the volume
    "delta diffusion": (lambda: bare(sph.DeltaDiffusion()), [OF_FLUID, (N,)], {"density_gradient": (2, N)}),
    "shifting at a surface": (lambda: bare(sph.ParticleShifting(free_surface=True)), [], {"shift": (2, N)}),
    # the shift in both passes, and the velocity that it carries
    "shifting": (lambda: bare(sph.ParticleShifting()), [OF_FLUID] * 3, {"shift": (2, N)}),
    "transport velocity": (lambda: bare(sph.TransportVelocity()), [OF_FLUID] * 3, {"shift": (2, N)}),
    "tensile control": (lambda: bare(sph.TensileControl()), [], {"cover": (N,)}),
    "wall repulsion": (lambda: bare(sph.WallRepulsion()), [], {}),
    "body force": (lambda: bare(sph.BodyForce(swaying)), [], {}),
    # the velocity of fluid, at fluid and at wall, and with which the wall answers
    "no slip": (lambda: bare(viscosity=1.0), [OF_FLUID, OF_FLUID, OF_FLUID_AT_WALL], {}),
    "viscosity": (lambda: bare(viscosity=1.0, no_slip=False), [OF_FLUID], {}),
    "moving wall": (lambda: bare(motion=pushed), [OF_FLUID], {}),
    "clipping": (lambda: bare(pressure=sph.AdamiExtrapolation(clip=True)), [], {}),
    "dynamic pressure": (lambda: bare(pressure=sph.BernoulliExtrapolation()), [OF_FLUID_AT_WALL], {}),
}


def fields_of(program, name):
    return {field: value.shape for field, value in program.state[name].items()}


def test_a_bare_scene_gathers_what_its_equations_read():
    """Two passes over fluid and two over its wall, and one in which the wall gets its pressure."""
    program = of_bare()
    assert program.passes == 5
    assert program.gathered == numbers(BARE)
    expected = {"position": (2, N), "velocity": (2, N), "acceleration": (2, N), "density_deviation": (N,)}
    assert fields_of(program, "water") == expected
    assert fields_of(program, "tank") == {}


def kind(effect):
    """Name of a case: nothing in it may differ from process to process."""
    return type(effect).__name__


@pytest.mark.parametrize("name", CALLED_FOR)
def test_an_effect_adds_its_own_arithmetic_gathers_and_state_and_no_pass(name):
    make, gathered, state = CALLED_FOR[name]
    program = programs.step(make())
    assert program.size > of_bare().size
    assert program.cost["flops"] > of_bare().cost["flops"]
    assert program.cost["bytes accessed"] > of_bare().cost["bytes accessed"]
    assert program.passes == of_bare().passes
    assert program.gathered == numbers(BARE + gathered)
    assert fields_of(program, "water") == fields_of(of_bare(), "water") | state
    of_wall = {"position": (2, WALL), "velocity": (2, WALL)} if name == "moving wall" else {}
    assert fields_of(program, "tank") == of_wall


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(lambda: bare(sph.ShepardFilter()), id="a filter acts between steps"),
        pytest.param(lambda: bare(velocity=np.array([0.3, 0.0])), id="nothing sticks to a wall that slides"),
    ],
)
def test_what_does_nothing_in_a_step_leaves_its_program_as_it_was(scene):
    assert programs.step(scene()).text == of_bare().text


def forbidden(*_, **__):
    raise AssertionError("called in a scene that does not list it")


def test_what_is_absent_is_never_asked(monkeypatch):
    """The program is the one that would be there had no effect ever been written."""
    modules = (effects, materials, walls, density)
    classes = {c for module in modules for c in vars(module).values() if isinstance(c, type)}
    mine = {sph.LinearStateEquation, sph.AdamiExtrapolation, sph.ContinuityDensity}
    for cls in classes - mine:
        for base in (FlowEffect, Shifting, materials.ViscosityLaw, walls.WallPressure, density.DensityCalculator):
            if issubclass(cls, base) and cls not in (FlowEffect, walls.WallPressure, density.DensityCalculator):
                for method in [k for k, v in vars(cls).items() if callable(v) and not k.startswith("_")]:
                    monkeypatch.setattr(cls, method, forbidden)
    assert programs.step(bare()).text == of_bare().text


@pytest.mark.parametrize(
    ("listed", "changes_rate", "changes_force"),
    [
        (sph.ArtificialViscosity(), False, True),
        (sph.DensityDiffusion(), True, False),
        (sph.DeltaDiffusion(), True, True),  # forces read the volume instead of dividing by the density
        (sph.TensileControl(), False, True),
        (sph.BodyForce(swaying), False, True),
        (sph.ParticleShifting(free_surface=True), False, False),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, bool) else "",
)
def test_an_effect_leaves_the_fields_of_others_alone(listed, changes_rate, changes_force):
    """The density's rate, and the acceleration, have the same program as without it unless it is of them."""
    for of_sum, changes in ((_rate, changes_rate), (_acceleration, changes_force)):
        assert (programs.lower(of_sum, bare(listed)).text == _of_bare(of_sum).text) != changes


@cache
def _of_bare(of_sum):
    return programs.lower(of_sum, bare())


def _rate(scene, references, columns, lists, placed):
    return density_rates(scene, references, columns, placed, lists, forward_mode=True)["water"]


def _acceleration(scene, references, columns, lists, placed):
    return forces(scene, references, columns, placed, lists, 0.0, forward_mode=True)["water"]["acceleration"]


def test_a_corrected_gradient_takes_a_pass_for_its_moments():
    """Over the fluid and over its wall: the one effect on fluids that does."""
    usual, corrected = (
        programs.step(bare(sph.ParticleShifting(), *more)) for more in ([], [sph.KernelGradientCorrection()])
    )
    assert corrected.passes == usual.passes + 2


def test_all_effects_share_the_passes():
    listed = [
        sph.ArtificialViscosity(), sph.DeltaDiffusion(), sph.TensileControl(), sph.BodyForce(swaying),
        sph.ParticleShifting(free_surface=True),
    ]  # fmt: skip
    program = programs.step(bare(*listed, viscosity=1.0, motion=pushed))
    assert program.passes == of_bare().passes
    # Each field once in a pass, however many effects read it: the velocity is read by both viscosities.
    of_both = [OF_FLUID, OF_FLUID, OF_FLUID, OF_FLUID, OF_FLUID_AT_WALL, (N,)]
    assert program.gathered == numbers(BARE + of_both)


def test_a_structure_in_the_fluid_brings_its_own_passes_and_fields():
    """Two over its own pairs, and four with the fluid: rate, pressure, the force on the fluid and that on itself."""
    body = sph.Structure("block", sph.box((0.4, 0.0), (0.1, 0.15), 0.05), 1000.0, 1e6, 0.3)
    without, alone = bare(), programs.step(sph.Scene(body))
    program = programs.step(replace(without, systems=(*without.systems, body)))
    assert program.passes == of_bare().passes + alone.passes + 4
    assert fields_of(program, "water") == fields_of(of_bare(), "water")
    assert set(program.state["block"]) == {*alone.state["block"], "surface_acceleration"}


@pytest.mark.parametrize(
    ("calculator", "passes", "state"),
    [
        (sph.ContinuityDensity(), 2, set()),
        (sph.SummationDensity(), 2, set()),
        (sph.EDAC(free_surface=True), 2, {"pressure"}),
        (sph.EDAC(), 3, {"pressure"}),  # the density is a sum as well
        (sph.EDAC(averaged_pressure=True), 4, {"pressure"}),  # and the mean of the pressure another
    ],
    ids=["continuity", "summation", "EDAC at a surface", "EDAC", "EDAC with averaged pressure"],
)
def test_density_calculators_make_the_passes_that_they_need(calculator, passes, state):
    program = programs.step(fluids.periodic(effects=[], viscosity=None, density=calculator))
    assert program.passes == passes
    always = {"position", "velocity", "acceleration", "density_deviation"}
    assert set(program.state["water"]) == always | state


@pytest.mark.parametrize(
    "law", [sph.MorrisViscosity(), sph.AdamiViscosity(), sph.MonaghanViscosity()], ids=lambda law: type(law).__name__
)
def test_viscosity_laws_read_the_velocity_and_nothing_more(law):
    without = programs.step(fluids.periodic(effects=[], viscosity=None))
    program = programs.step(fluids.periodic(effects=[], law=law))
    vector = (2, fluids.CELLS[2] ** 2)
    assert program.gathered == without.gathered + numbers([vector])
    assert program.passes == without.passes
    assert fields_of(program, "water") == fields_of(without, "water")


def block(*listed):
    return sph.Scene(bodies.block(), effects=listed)


@pytest.mark.parametrize(
    "listed",
    [sph.PenaltyForce(0.05), sph.Damping(1.0), sph.KelvinVoigt(1e-4), sph.BodyForce(swaying)],
    ids=lambda listed: type(listed).__name__,
)
def test_effects_on_structures_add_their_own(listed):
    """Without the penalty force two passes: over displacements and over tractions. It takes a third between them."""
    n = bodies.block().n_particles
    without, program = programs.step(block()), programs.step(block(listed))
    assert without.passes == 2
    assert without.gathered == numbers([(2, n), (2, 2, n)])
    more = [(2, n), (2, 2, n)] if isinstance(listed, sph.PenaltyForce) else []
    assert program.passes == 2 + bool(more)
    assert program.gathered == without.gathered + numbers(more)
    assert program.size > without.size
    assert fields_of(program, "block") == fields_of(without, "block")


def test_the_compiled_program_is_as_lean():
    """XLA leaves of a scene without effects the gathers that were counted, and less arithmetic and memory than with."""
    lean = programs.step(fluids.periodic(effects=[], viscosity=None))
    rich = programs.step(fluids.periodic(effects=[sph.ParticleShifting()]))
    compiled = [program.lowered.compile() for program in (lean, rich)]
    for program, made in zip((lean, rich), compiled, strict=True):
        assert str(made.as_text()).count(" gather(") == program.n_gathers
    costs = [dict(made.cost_analysis() or {}) for made in compiled]
    for what in ("flops", "bytes accessed"):
        assert costs[0][what] < costs[1][what]
    arguments, results = (
        [getattr(made.memory_analysis(), f"{kind}_size_in_bytes") for made in compiled]
        for kind in ("argument", "output")
    )
    # The shift, in and out; of the scene the viscosity, the effect's one number, and the volumes whose sum is kept.
    number = 8
    shift, volumes = 2 * 100 * number, 100 * number
    assert results[1] - results[0] == shift + 8  # one pointer for one array more
    assert arguments[1] - arguments[0] == shift + volumes + 2 * number


def test_reverse_mode_knows_nothing_of_fields_that_nobody_reads():
    """Its adjoint gathers, for a pair that reads x: x and the cotangent; nothing of y and z."""
    lists = programs.neighbors(N)
    fields = {name: jax.ShapeDtypeStruct((2, N), np.float64) for name in ("x", "y", "z")}

    def loss(fields, lists, a_reads, b_reads):
        def of_pair(a, b):
            not_used = jnp.sum(a["z"]) * b["z"]  # noqa: F841
            return jnp.sum(a[a_reads] * b[b_reads])

        return jnp.sum(sph.pair_sum(of_pair, fields, fields, lists) ** 2)

    def gathered(*reads):
        lowered = jax.jit(jax.grad(lambda fields, lists: loss(fields, lists, *reads))).lower(fields, lists)
        return programs.Program(lowered, {}).gathered

    # once for the value; once for the adjoint, with the cotangent
    assert gathered("x", "x") == numbers([(2, N), (2, N), (N,)])
    assert gathered("x", "y") == numbers([(2, N), (2, N), (2, N), (N,)])
