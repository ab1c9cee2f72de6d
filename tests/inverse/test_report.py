"""A fit prints, pickles, saves and plots itself."""

import json
import pickle
import subprocess
import sys
from typing import Any

import h5py
import numpy as np
import pytest

import inverse


@pytest.fixture(scope="module")
def fit(toys):
    return inverse.fit(toys.oscillator(noise=0.05))


def test_table_says_what_was_found(fit):
    text = str(fit)
    for words in ("stiffness", "std. error", "identifiable", f"{fit.simulation_runs} runs", "compiling"):
        assert words in text


def test_dictionary_is_json(fit):
    summary = json.loads(json.dumps(fit.to_dict(), allow_nan=False))
    assert summary["values"]["stiffness"] == fit["stiffness"]
    assert summary["simulation_runs"] == fit.simulation_runs == len(summary["history"])
    assert summary["standard_errors"]["stiffness"] == fit.standard_errors["stiffness"]
    assert summary["seconds"] >= summary["compile_seconds"] + summary["run_seconds"]
    assert fit.iterations <= fit.simulation_runs - 1


def test_pickle(fit):
    again = pickle.loads(pickle.dumps(fit))
    assert str(again) == str(fit)


def test_saved_file_reads_back(fit, tmp_path):
    with h5py.File(fit.save(tmp_path / "fit.h5")) as opened:
        file: Any = opened
        assert np.array_equal(file["simulated"], fit.simulated)
        assert np.array_equal(file["history/run"], np.arange(1, fit.simulation_runs + 1))
        assert json.loads(file.attrs["summary"])["method"] == "gauss-newton"
        assert list(file["vector"].attrs["labels"]) == ["stiffness"]


def test_residuals_are_simulated_minus_observed_over_noise(fit):
    expected = (fit.simulated - fit.observed) / fit.standard_deviations
    np.testing.assert_allclose(fit.residuals, expected, rtol=1e-9, atol=1e-12)  # round-off


def test_plot(fit, tmp_path):
    assert fit.plot(tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")


def test_import_leaves_heavy_packages_alone():
    code = "import sys, inverse; print([m for m in ('matplotlib', 'jaxsph', 'h5py') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
