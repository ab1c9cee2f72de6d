"""A trajectory file holds what was written, also when its writer was killed or the file damaged."""

import subprocess
import sys
import textwrap
from typing import Any

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import vtk
from vtkmodules.util.numpy_support import vtk_to_numpy

import jaxsph as sph
from jaxsph.files import TrajectoryWriter, fingerprint, hdf5, parameters, read_state, read_trajectory
from jaxsph.pytree import pytree_dataclass, static

SAVES = 21  # more than the first room of 16, so that the file is moved once
TIMES = 0.1 * np.arange(SAVES)


def write(path, kind: type = np.float64, d=2, close=True, **options):
    """Plate of 7 and water of 5 particles, every number different; returns what was given to the writer."""
    random = np.random.default_rng(1)
    systems = {"plate": random.random((7, d)).astype(kind), "water": random.random((5, d)).astype(kind)}
    given = []
    writer = TrajectoryWriter(path, systems, **options)
    for _ in TIMES:
        plate = {
            "displacement": random.random((7, d)).astype(kind),
            "von_mises": random.random(7).astype(kind),
            "cauchy": random.random((7, d, d)).astype(kind),
        }
        water = {"position": random.random((5, d)).astype(kind), "density": random.random(5).astype(kind)}
        given.append({"plate": plate, "water": water, "state": {"a": random.random(4), "n": np.int32(len(given))}})
        fields = {"plate": plate, "water": water}
        writer.append(TIMES[len(given) - 1], fields, state=given[-1]["state"])
    if close:
        writer.close()
    return systems, given


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("saves", [None, SAVES, 50])
def test_trajectory_comes_back_bit_for_bit(tmp_path, dtype, d, saves):
    systems, given = write(tmp_path / "run.vtkhdf", dtype, d, saves=saves)
    times, read, metadata = read_trajectory(tmp_path / "run.vtkhdf")
    np.testing.assert_array_equal(times, TIMES)
    for system, field in [
        ("plate", "displacement"),
        ("plate", "von_mises"),
        ("plate", "cauchy"),
        ("water", "position"),
        ("water", "density"),
    ]:
        expected = np.stack([save[system][field] for save in given])
        assert read[system][field].dtype == dtype
        np.testing.assert_array_equal(read[system][field], expected)
    moved = np.stack([systems["plate"] + save["plate"]["displacement"] for save in given])
    np.testing.assert_array_equal(read["plate"]["position"], moved)
    assert set(read["water"]) == {"position", "density"}, "fields of other systems do not leak in as NaN"
    np.testing.assert_array_equal(metadata["reference_positions"]["plate"], systems["plate"])
    assert not list(tmp_path.glob("*.part")), "nothing is left beside the file"


def vtk_steps(path):
    """All steps as vtkHDFReader gives them: times, and one polydata per step."""
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    outputs = []
    for step in range(reader.GetNumberOfSteps()):
        reader.SetStep(step)
        reader.Update()
        output = vtk.vtkPolyData()
        output.DeepCopy(reader.GetOutput())
        outputs.append(output)
    return np.array(times), outputs


@pytest.mark.parametrize("close", [True, False], ids=["closed", "still being written"])
@pytest.mark.parametrize("saves", [None, 50], ids=["growing", "room for 50"])
def test_vtk_reads_what_was_written(tmp_path, close, saves):
    systems, given = write(tmp_path / "run.vtkhdf", np.float32, 2, close, saves=saves)
    times, outputs = vtk_steps(tmp_path / "run.vtkhdf")
    np.testing.assert_array_equal(times, TIMES)
    assert len(outputs) == SAVES
    for save, output in zip(given, outputs, strict=True):
        assert output.GetNumberOfPoints() == output.GetNumberOfVerts() == output.GetNumberOfCells() == 12
        data = output.GetPointData()
        arrays = {data.GetArrayName(i): vtk_to_numpy(data.GetArray(i)) for i in range(data.GetNumberOfArrays())}
        expected = np.zeros((12, 3), np.float32)
        expected[:7, :2] = systems["plate"] + save["plate"]["displacement"]
        expected[7:, :2] = save["water"]["position"]
        np.testing.assert_array_equal(vtk_to_numpy(output.GetPoints().GetData()), expected)
        np.testing.assert_array_equal(arrays["system"], [0] * 7 + [1] * 5)
        np.testing.assert_array_equal(arrays["identity"], [*range(7), *range(5)])
        np.testing.assert_array_equal(arrays["Displacement"][:7, :2], save["plate"]["displacement"])
        assert np.all(arrays["Displacement"][:7, 2] == 0) and np.all(np.isnan(arrays["Displacement"][7:]))
        np.testing.assert_array_equal(arrays["VonMises"][:7], save["plate"]["von_mises"])
        np.testing.assert_array_equal(arrays["Cauchy"][:7].reshape(7, 3, 3)[:, :2, :2], save["plate"]["cauchy"])
        np.testing.assert_array_equal(arrays["Density"][7:], save["water"]["density"])
        assert np.all(np.isnan(arrays["Density"][:7]))


def test_vertex_cells_are_the_particles(tmp_path):
    write(tmp_path / "run.vtkhdf")
    vertices = vtk_steps(tmp_path / "run.vtkhdf")[1][-1].GetVerts()
    np.testing.assert_array_equal(vtk_to_numpy(vertices.GetConnectivityArray()), np.arange(12))


def test_paraview_needs_version_and_type_of_fixed_length(tmp_path):
    write(tmp_path / "run.vtkhdf")
    with h5py.File(tmp_path / "run.vtkhdf") as file:
        kind = file["VTKHDF"].attrs.get_id("Type")
        assert not kind.get_type().is_variable_str() and kind.get_type().get_cset() == h5py.h5t.CSET_ASCII
        assert file["VTKHDF"].attrs["Type"] == b"PolyData" and np.array_equal(
            np.asarray(hdf5.attribute(file, "VTKHDF", "Version")), [2, 0]
        )


def test_topology_is_stored_once(tmp_path):
    write(tmp_path / "run.vtkhdf")
    with h5py.File(tmp_path / "run.vtkhdf") as file:
        assert hdf5.array(file, "VTKHDF/Points").shape == (SAVES * 12, 3)
        assert hdf5.array(file, "VTKHDF/Vertices/Connectivity").shape == (12,)
        assert hdf5.array(file, "VTKHDF/PointData/identity").shape == (12,)


def test_metadata_units_and_versions(tmp_path):
    scene = {"plate": {"youngs_modulus": jnp.float32(1.4e6)}, "gravity": (0.0, -2.0)}
    write(
        tmp_path / "run.vtkhdf",
        metadata={"case": "CSM3", "level": np.int64(3)},
        scene=scene,
        units={"density": "g"},
    )
    _, _, metadata = read_trajectory(tmp_path / "run.vtkhdf")
    assert metadata["case"] == "CSM3" and metadata["level"] == 3 and metadata["dimension"] == 2
    assert metadata["versions"]["jax"] == jax.__version__ and metadata["precision"] == "float64"
    assert metadata["units"] == {
        "position": "m",
        "displacement": "m",
        "von_mises": "Pa",
        "cauchy": "Pa",
        "density": "g",
    }
    assert {"name": "plate.youngs_modulus", "value": 1.4e6, "unit": "Pa"} in metadata["parameters"]
    assert metadata["parameters"] == parameters(scene)
    assert metadata["systems"] == {"plate": 7, "water": 5}


def test_float32_file_of_a_float64_run_keeps_the_state_in_float64(tmp_path):
    _, given = write(tmp_path / "run.vtkhdf", np.float64, dtype=np.float32)
    _, read, _ = read_trajectory(tmp_path / "run.vtkhdf")
    assert read["plate"]["displacement"].dtype == read["plate"]["position"].dtype == np.float32
    state = read_state(tmp_path / "run.vtkhdf", given[-1]["state"])
    np.testing.assert_array_equal(state["a"], given[-1]["state"]["a"])


def test_integer_field_is_minus_one_where_it_is_absent(tmp_path):
    with TrajectoryWriter(tmp_path / "run.vtkhdf", {"a": np.zeros((2, 2)), "b": np.ones((1, 2))}) as writer:
        writer.append(0.0, {"a": {"neighbor_count": np.array([3, 4])}})
    data = vtk_steps(tmp_path / "run.vtkhdf")[1][0].GetPointData()
    np.testing.assert_array_equal(vtk_to_numpy(data.GetArray("NeighborCount")), [3, 4, -1])


def restart_state():
    """One leaf of every kind that a state may have, with the values that text or a cast would lose."""
    return {
        "time": jnp.asarray(0.1 + 0.2),
        "step": np.int64(2**62 + 1),
        "health": jnp.array([True, False]),
        "systems": {
            "plate": {"velocity": jnp.array([[np.nan, -0.0], [5e-324, np.inf]]), "empty": jnp.zeros((0, 2))},
            "fluid/a": {"density": jnp.arange(3, dtype=jnp.float32) / 3, "phase": jnp.array([1 + 2j])},
        },
        "count": 7,
    }


def bits(tree):
    return [(type(leaf), np.asarray(leaf).dtype, np.asarray(leaf).tobytes()) for leaf in jax.tree.leaves(tree)]


@pytest.mark.parametrize("saves", [1, 2, 17, 18])  # both slots, before and after a move of the file
def test_state_comes_back_bit_for_bit(tmp_path, saves):
    state = restart_state()
    with TrajectoryWriter(tmp_path / "run.vtkhdf", {"plate": np.zeros((2, 2))}) as writer:
        for i in range(saves):
            last = {**state, "step": np.int64(2**62 + i)}
            writer.append(float(i), {}, state=last)
    read = read_state(tmp_path / "run.vtkhdf", like=state)
    assert bits(read) == bits(last)
    assert jax.tree.structure(read) == jax.tree.structure(state)


@pytree_dataclass
class Now:
    """What the writer asks of a state: a time, and fields by system."""

    time: Any
    systems: dict


@pytree_dataclass
class Body:
    name: str = static()
    youngs_modulus: Any = 1.0


@pytree_dataclass
class World:
    systems: tuple
    gravity: Any
    effects: tuple = ()


@pytree_dataclass
class Drag:
    coefficient: Any


def test_leaves_are_named_as_a_scene_names_them():
    world = World((Body("beam", 2.0), Body("plate", 3.0)), jnp.array([0.0, -9.81]), (Drag(0.1),))
    assert [(p["name"], p["value"], p["unit"]) for p in parameters(world, {"coefficient": "1/s"})] == [
        ("beam.youngs_modulus", 2.0, "Pa"),
        ("plate.youngs_modulus", 3.0, "Pa"),
        ("gravity", [0.0, -9.81], "m/s^2"),
        ("Drag.coefficient", 0.1, "1/s"),
    ]
    assert list(fingerprint({"a": [1.0, (2.0, None)]})["leaves"]) == ["a.0", "a.1.0"]


def test_leaves_that_hdf5_does_not_hold_are_named(tmp_path):
    with TrajectoryWriter(tmp_path / "run.vtkhdf", {"plate": np.zeros((3, 2))}) as writer:
        with pytest.raises(ValueError, match="leaf noise is of type key<"):
            writer.append(0.0, {}, state={"noise": jax.random.key(0)})
        with pytest.raises(ValueError, match="leaf half is of type bfloat16"):
            writer.append(0.0, {}, state={"half": jnp.zeros(2, jnp.bfloat16)})
        with pytest.raises(ValueError, match=r"leaves of the tree share a name: a\|b"):
            writer.append(0.0, {}, state={"a/b": np.zeros(1), "a|b": np.zeros(1)})


def test_save_takes_a_state_as_the_simulation_holds_it(tmp_path):
    fields = {"plate": {"displacement": jnp.full((3, 2), 0.5), "velocity": jnp.ones((3, 2))}}
    state = Now(time=jnp.asarray(0.25), systems=fields)
    with TrajectoryWriter(tmp_path / "run.vtkhdf", {"plate": np.zeros((3, 2))}) as writer:
        writer.save(state, {"plate": {"von_mises": jnp.arange(3.0)}})
    times, read, _ = read_trajectory(tmp_path / "run.vtkhdf")
    assert times == [0.25]
    np.testing.assert_array_equal(read["plate"]["position"][0], np.full((3, 2), 0.5))
    np.testing.assert_array_equal(read["plate"]["von_mises"][0], [0.0, 1.0, 2.0])
    assert bits(read_state(tmp_path / "run.vtkhdf", state)) == bits(state)


KILLED = """
import sys
import numpy as np
from jaxsph.files import TrajectoryWriter

writer = TrajectoryWriter(sys.argv[1], {"a": np.zeros((50, 2))}, saves=int(sys.argv[2]) or None)
for i in range(int(sys.argv[3])):
    fields = {"a": {"displacement": np.full((50, 2), float(i))}}
    writer.append(float(i), fields, state={"n": np.full(100, i), "time": np.float64(i)})
    print(i, flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("room", [0, 1000], ids=["growing", "room for 1000"])
@pytest.mark.parametrize("after", [1, 5, 40, None])
def test_killed_writer_leaves_every_finished_save(tmp_path, room, after):
    """SIGKILL after a number of saves, or (None) at any moment of a writer that saves as fast as it can."""
    path = tmp_path / "run.vtkhdf"
    command = [sys.executable, "-c", textwrap.dedent(KILLED), str(path), str(room), str(after or 1000)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for _ in range(after or 23):
            process.stdout.readline()
        process.kill()
        finished = (after or 23) + len(process.stdout.read().split())

    times, read, _ = read_trajectory(path)
    # the last save may be whole before its writer could say so
    assert len(times) in ([after] if after else [finished, finished + 1])
    np.testing.assert_array_equal(times, np.arange(len(times)))
    np.testing.assert_array_equal(read["a"]["displacement"][:, 0, 0], times)
    state = read_state(path, {"n": np.zeros(100, int), "time": np.float64(0)})
    assert np.all(state["n"] == state["time"]), "the state is one whole state, not two halves"
    assert state["time"] - times[-1] in (0, 1)
    _, outputs = vtk_steps(path)
    assert len(outputs) - len(times) in (0, 1)
    np.testing.assert_array_equal(vtk_to_numpy(outputs[len(times) - 1].GetPoints().GetData())[:, 0], times[-1])


def test_a_half_written_slot_leaves_the_one_before(tmp_path):
    write(tmp_path / "run.vtkhdf")
    with h5py.File(tmp_path / "run.vtkhdf", "r+") as file:
        other = 1 - int(hdf5.attribute(file, "jaxsph/restart", "slot"))
        hdf5.dataset(file, f"jaxsph/restart/{other}/a")[:] = -1.0
    state = read_state(tmp_path / "run.vtkhdf", {"a": np.zeros(4), "n": np.int32(0)})
    assert state["n"] == SAVES - 1 and np.all(state["a"] >= 0)


def test_earlier_results_stay_until_the_first_save(tmp_path):
    write(tmp_path / "run.vtkhdf")
    TrajectoryWriter(tmp_path / "run.vtkhdf", {"a": np.zeros((1, 2))}).close()
    assert len(read_trajectory(tmp_path / "run.vtkhdf")[0]) == SAVES


def test_damaged_and_foreign_files_are_named(tmp_path):
    path = tmp_path / "run.vtkhdf"
    with pytest.raises(FileNotFoundError, match=r"run.vtkhdf: no such file"):
        read_trajectory(path)
    path.write_text("time,value\n")
    with pytest.raises(ValueError, match=r"run.vtkhdf: not an HDF5 file \(11 bytes"):
        read_trajectory(path)
    write(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=rf"cut short, it has {len(whole) // 2} bytes of the {len(whole)}"):
        read_trajectory(path)
    path.write_bytes(whole[:4000])
    with pytest.raises(ValueError, match="cut short"):
        read_state(path, {"a": np.zeros(4)})

    path.write_bytes(whole)
    with h5py.File(path, "r+") as file:
        file["jaxsph"].attrs["format_version"] = 99
    with pytest.raises(ValueError, match=r"format version 99 \(written by jaxsph .*this jaxsph reads format version 1"):
        read_trajectory(path)
    with h5py.File(path, "r+") as file:
        file["jaxsph"].attrs["format_version"] = 1
        del file["jaxsph/systems"]
    with pytest.raises(ValueError, match=r"dataset /jaxsph/systems is missing, expected a trajectory"):
        read_trajectory(path)
    with h5py.File(path, "r+") as file:
        del file["jaxsph"]
    with pytest.raises(ValueError, match=r"group /jaxsph is missing \(found at the top: VTKHDF\)"):
        read_trajectory(path)


def test_state_that_does_not_fit_is_named(tmp_path):
    path = tmp_path / "run.vtkhdf"
    write(path)
    with pytest.raises(ValueError, match=r"a has shape \(4,\) and type float64, `like` has \(5,\) and float64"):
        read_state(path, {"a": np.zeros(5), "n": np.int32(0)})
    with pytest.raises(ValueError, match=r"`like` has \(4,\) and float32; build the scene with .* the precision"):
        read_state(path, {"a": np.zeros(4, np.float32), "n": np.int32(0)})
    with pytest.raises(ValueError, match=r"missing \['b'\], not asked for \['n'\]"):
        read_state(path, {"a": np.zeros(4), "b": np.int32(0)})
    with TrajectoryWriter(path, {"a": np.zeros((1, 2))}) as writer:
        writer.append(0.0, {})
    with pytest.raises(ValueError, match="no state to restart from"):
        read_state(path, {"a": np.zeros(4)})


def test_another_scene_is_named_by_what_differs(tmp_path):
    path, like = tmp_path / "run.vtkhdf", {"a": np.zeros(4), "n": np.int32(0)}
    scene = {
        "plate": {"youngs_modulus": 1.4e6, "positions": np.arange(6.0).reshape(3, 2)},
        "gravity": (0.0, -2.0),
    }
    write(path, scene=scene)
    read_state(path, like, scene=jax.tree.map(np.copy, scene) | {"plate": scene["plate"]})
    other = {**scene, "plate": {**scene["plate"], "youngs_modulus": 1.5e6}}
    with pytest.raises(ValueError, match=r"plate.youngs_modulus: value 1400000.0 in the file, 1500000.0 in this scene"):
        read_state(path, like, scene=other)
    other = {**scene, "plate": {**scene["plate"], "positions": np.arange(6.0).reshape(3, 2) + 1}}
    with pytest.raises(ValueError, match=r"plate.positions: other numbers"):
        read_state(path, like, scene=other)
    other = {**scene, "plate": {**scene["plate"], "positions": np.zeros((4, 2))}}
    with pytest.raises(ValueError, match=r"plate.positions: shape \[3, 2\] in the file, \[4, 2\] in this scene"):
        read_state(path, like, scene=other)
    with pytest.raises(ValueError, match=r"viscosity is only in this scene"):
        read_state(path, like, scene={**scene, "viscosity": 1e-3})
    with pytest.raises(ValueError, match=r"the structure"):
        read_state(path, like, scene={**scene, "gravity": [0.0, -2.0]})
    write(path)
    with pytest.raises(ValueError, match="no fingerprint"):
        read_state(path, like, scene=scene)


def test_fingerprint_does_not_depend_on_where_functions_live():
    def tree(function):
        return jax.tree_util.Partial(function, 1.0)

    assert fingerprint(tree(lambda x: x))["hash"] == fingerprint(tree(lambda x: x))["hash"]
    assert "0x" not in fingerprint(tree(lambda x: x))["structure"]


def test_wrong_use_of_the_writer_is_refused(tmp_path):
    path, systems = tmp_path / "run.vtkhdf", {"plate": np.zeros((3, 2))}
    with pytest.raises(ValueError, match=r"directory .*nowhere does not exist; create it first"):
        TrajectoryWriter(tmp_path / "nowhere" / "run.vtkhdf", systems)
    with pytest.raises(ValueError, match="is a directory"):
        TrajectoryWriter(tmp_path, systems)
    with pytest.raises(ValueError, match="no system to save"):
        TrajectoryWriter(path, {})
    with pytest.raises(ValueError, match=r"shape \(3,\)"):
        TrajectoryWriter(path, {"plate": np.zeros(3)})
    with pytest.raises(ValueError, match="differ in dimension"):
        TrajectoryWriter(path, {"a": np.zeros((1, 2)), "b": np.zeros((1, 3))})
    with pytest.raises(ValueError, match="dtype is int32, expected a float type"):
        TrajectoryWriter(path, systems, dtype=np.int32)
    with pytest.raises(ValueError, match="saves is 0"):
        TrajectoryWriter(path, systems, saves=0)
    with pytest.raises(ValueError, match="expected what JSON holds"):
        TrajectoryWriter(path, systems, metadata={"file": object()})

    with TrajectoryWriter(path, systems) as writer:
        with pytest.raises(ValueError, match=r"no system 'water' in this file, expected one of \['plate'\]"):
            writer.append(0.0, {"water": {"density": np.zeros(3)}})
        with pytest.raises(ValueError, match=r"plate.velocity has shape \(2, 3\).*particles come first"):
            writer.append(0.0, {"plate": {"velocity": np.zeros((2, 3))}})
        with pytest.raises(ValueError, match="which is taken"):
            writer.append(0.0, {"plate": {"von_mises": np.zeros(3), "vonMises": np.zeros(3)}})
        writer.append(0.0, {"plate": {"velocity": np.zeros((3, 2))}}, state={"a": np.zeros(2)})
        with pytest.raises(ValueError, match=r"save at 0.0 s does not come after the last one at 0.0 s"):
            writer.append(0.0, {"plate": {"velocity": np.zeros((3, 2))}}, state={"a": np.zeros(2)})
        with pytest.raises(ValueError, match=r"differ from the first save: plate.density"):
            fields = {"velocity": np.zeros((3, 2)), "density": np.zeros(3)}
            writer.append(1.0, {"plate": fields}, state={"a": np.zeros(2)})
        with pytest.raises(ValueError, match="state of this save differs from the first save in a"):
            writer.append(1.0, {"plate": {"velocity": np.zeros((3, 2))}}, state={"a": np.zeros(3)})
    with pytest.raises(ValueError, match="writer is closed"):
        writer.append(1.0, {"plate": {"velocity": np.zeros((3, 2))}}, state={"a": np.zeros(2)})
    assert len(read_trajectory(path)[0]) == 1, "what was refused is not in the file"


def test_fingerprint_knows_what_functions_are_made_of():
    """Of motions of scenes, of lambdas, their enclosed numbers and defaults; a wrong one would go on without a word."""
    marks = [fingerprint(sph.scenes.moving_wall(5, speed=speed))["hash"] for speed in (0.3, 0.5, 0.3)]
    assert marks[0] == marks[2] != marks[1]

    def scene(amplitude, factor=None):
        constant = lambda x, t: 0.5 * x if factor is None else factor * x  # noqa: E731
        enclosed = lambda x, t: amplitude * x  # noqa: E731
        water = sph.Fluid("water", sph.box((0, 0), (0.4, 0.4), 0.1), 1000.0, 20.0)
        return sph.Scene(water, effects=[sph.BodyForce(enclosed), sph.BodyForce(constant)])

    marks = [fingerprint(scene(*about))["hash"] for about in ((1.0,), (2.0,), (1.0, 3.0), (1.0,), (np.ones(2),))]
    assert marks[0] == marks[3] and len(set(marks)) == 4


def test_every_field_of_a_state_has_a_unit():
    from jaxsph.files.units import UNITS

    scene = sph.scenes.dam_break_plate(10, 3, dtype=np.float32)
    effects = [*scene.effects, sph.ParticleShifting(free_surface=True), sph.AcousticDamper(), sph.TensileControl()]
    effects = {type(effect): effect for effect in [*effects, sph.DeltaDiffusion()]}.values()
    state = sph.initial_state(sph.Scene(*scene.systems, effects=list(effects), smoothing_length=scene.smoothing_length))
    missing = {field for fields in state.systems.values() for field in fields} - set(UNITS)
    assert not missing
