"""Measurements from arrays and files; every bad file is answered with its name, column and line."""

import h5py
import numpy as np
import pytest

from inverse import Observations

CSV = """# tip of a beam
t_s,ux_m,uy_m,noise

0.0,0.0,0.0,1e-4
0.1,1.0,-2.0,2e-4
0.2,2.0,-4.0,1e-4
0.3,3.0,-6.0,1e-4
"""


@pytest.fixture
def tip(tmp_path):
    def write(text=CSV):
        path = tmp_path / "tip.csv"
        path.write_text(text)
        return path

    return write


def test_csv_columns_noise_window_and_every(tip):
    data = Observations.from_csv(tip(), columns=["uy_m", "ux_m"], noise="noise", window=(0.1, 0.3), every=2)
    assert np.array_equal(data.times, [0.1, 0.3])
    assert np.array_equal(data.values, [[-2.0, 1.0], [-6.0, 3.0]])
    assert np.array_equal(np.asarray(data.standard_deviations), [[2e-4, 2e-4], [1e-4, 1e-4]])
    assert data.columns == ("uy_m", "ux_m")


def test_csv_single_name_gives_a_vector_and_default_takes_all(tip):
    assert Observations.from_csv(tip(), columns="uy_m", noise=1e-3).values.shape == (4,)
    both = Observations.from_csv(tip(), noise=["noise", "noise"])
    assert both.columns == ("ux_m", "uy_m")
    assert np.asarray(both.standard_deviations).shape == (4, 2)
    assert Observations.from_csv(tip(), columns=["uy_m"]).standard_deviations is None


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (("", ""), {"columns": ["uz_m"]}, r"tip.csv: no column 'uz_m'; line 2 names t_s, ux_m, uy_m, noise"),
        (("", ""), {"time": "time"}, "no column 'time'"),
        (("-2.0", "oops"), {}, r"tip.csv, line 5, column 'uy_m': 'oops' is not a number"),
        (("-2.0", "nan"), {}, r"line 5, column 'uy_m': nan is not finite"),
        (("0.2,2.0,-4.0,1e-4", "0.2,2.0"), {}, r"line 6, column 'uy_m': '' is not a number"),
        (("0.2,", "0.1,"), {}, r"line 6, column 't_s': times must increase, but 0.1 follows 0.1"),
        (("2e-4", "-2e-4"), {"noise": "noise"}, r"line 5, column 'noise': a standard deviation of -0.0002"),
        (("", ""), {"noise": -1.0}, "noise=-1.0 must be a standard deviation > 0"),
        (("", ""), {"noise": [1.0, 1.0, 1.0]}, "has 3 entries for 2"),
        (("", ""), {"window": (0.5, 0.9)}, "ends after the last sample at 0.3 s"),
        (("", ""), {"window": (0.3, 0.1)}, "begin before it ends"),
        (("", ""), {"window": (0.11, 0.19)}, "no sample"),
        (("", ""), {"every": 0}, "every=0"),
        ((CSV, "t_s,uy_m\n"), {}, "at least one line of numbers"),
        (("0.0,0.0", "-0.1,0.0"), {}, "before the run starts at 0 s"),
    ],
)
def test_bad_csv(tip, change, options, words):
    options = {"columns": None if "noise" not in str(options.get("noise")) else ["uy_m"], **options}
    if options["columns"] is None:
        options["columns"] = ["ux_m", "uy_m"]
    with pytest.raises(ValueError, match=words):
        Observations.from_csv(tip(CSV.replace(*change) if change[0] else CSV), **options)


def test_hdf5(tmp_path):
    path = tmp_path / "tip.h5"
    with h5py.File(path, "w") as file:
        file["t_s"] = np.array([0.0, 0.5, 1.0])
        file["tip/uy"] = np.array([0.0, 1.0, 0.5])
        file["broken"] = np.array([0.0, np.nan, 0.5])
        file["table"] = np.zeros((3, 2))
    data = Observations.from_hdf5(path, columns="tip/uy", noise=0.1, window=(0.5, 1.0))
    assert np.array_equal(data.values, [1.0, 0.5])
    with pytest.raises(ValueError, match=r"tip.h5: no dataset 'uy'; the file holds .*tip/uy"):
        Observations.from_hdf5(path, columns="uy")
    with pytest.raises(ValueError, match=r"tip.h5, dataset 'broken', index 1: nan is not finite"):
        Observations.from_hdf5(path, columns="broken")
    with pytest.raises(ValueError, match="a vector of numbers"):
        Observations.from_hdf5(path, columns="table")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([0.0, 1.0], [1.0]), "do not fit 2 times"),
        (([0.0, 1.0], [1.0, np.nan]), r"values\[1\] = nan"),
        (([0.0, 0.0], [1.0, 1.0]), "times must increase"),
        (([], []), "T >= 1"),
        (([0.0, 1.0], [1.0, 1.0], 0.0), "must be a finite number > 0"),
        (([0.0, 1.0], [1.0, 1.0], [1.0, -1.0]), "standard deviation -1 at sample 1"),
        (([0.0, 1.0], [1.0, 1.0], [1.0, 1.0, 1.0]), "do not fit values"),
    ],
)
def test_bad_arrays(arguments, words):
    arguments = [np.asarray(a) for a in arguments]
    with pytest.raises(ValueError, match=words):
        Observations(*arguments)


def test_noise_has_the_stated_level_and_is_reproducible():
    times = np.arange(20_000.0)
    clean = Observations(times, np.stack([np.sin(times), 5 * np.cos(times)], axis=1))
    noisy = clean.with_noise(relative=0.05, seed=3)
    measured = np.std(noisy.values - clean.values, axis=0)
    # 5 % of amplitudes 1 and 5; the estimate of a standard deviation scatters by 1 / sqrt(2 T) = .5 %
    np.testing.assert_allclose(measured, [0.05, 0.25], rtol=0.02)
    np.testing.assert_allclose(
        np.asarray(noisy.standard_deviations)[0], [0.05, 0.25], rtol=1e-5
    )  # whole seconds miss the peaks
    assert np.array_equal(noisy.values, clean.with_noise(relative=0.05, seed=3).values)
    assert not np.array_equal(noisy.values, clean.with_noise(relative=0.05, seed=4).values)
    with pytest.raises(ValueError, match="one of the two"):
        clean.with_noise()
