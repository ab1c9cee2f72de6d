"""The same case of PySPH, run in a process of its own."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from cases import Case, Peer

from jaxsph.accuracy import Row
from jaxsph.accuracy.results import Results
from jaxsph.accuracy.study import line

PROGRAM = Path(__file__).parent / "pysph_flows.py"


def version(python: str) -> str | None:
    """Of PySPH in the environment of a Python, None if it is not there."""
    if python == sys.executable:
        try:
            return importlib.metadata.version("pysph")
        except importlib.metadata.PackageNotFoundError:
            return None
    ask = "import importlib.metadata as m; print(m.version('pysph'))"
    answer = subprocess.run([python, "-c", ask], capture_output=True, text=True, check=False)
    return answer.stdout.strip() if answer.returncode == 0 else None


def rows(case: Case, python: str, quick: bool) -> list[Row]:
    """Runs of PySPH; none if it has no such case or is not installed."""
    peer, found = case.peer, version(python)
    if peer is None:
        return []
    if found is None:
        print("  PySPH is not installed: no points of its own (make accuracy installs it)", flush=True)
        return []
    out = []
    for n in peer.resolutions[:1] if quick else peer.resolutions:
        row = _measure(peer, n, python, f"PySPH {found}")
        print("  " + line(Results((row,)), row), flush=True)
        out.append(row)
    return out


def _measure(peer: Peer, n: int, python: str, code: str) -> Row:
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    settings = {"particles": n, "precision": "float64", "code": code}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.npz"
        command = [python, str(PROGRAM), peer.name, "--particles", str(n), "--out", str(path)]
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            return Row(settings, {}, float("nan"), failure=reason)
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
    measures = {name: arrays[name].item() for name in ("seconds", "steps", "n_particles")}
    return Row(
        settings,
        peer.errors_of(arrays),
        measures["seconds"],
        steps=round(measures["steps"]),
        n_particles=round(measures["n_particles"]),
    )
