"""The same case in other codes, each run in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from cases import Case, Peer

from jaxsph.accuracy import Row
from jaxsph.accuracy.study import line

FOLDER = Path(__file__).parent
CODES = {
    "pysph": ("PySPH", "pysph_flows.py", "float64", {}),
    # its library wants the system's libGLdispatch loaded before it
    "pysplishsplash": ("SPlisHSPlasH", "splishsplash_front.py", "float32", {"LD_PRELOAD": "libGLdispatch.so.0"}),
}
"""By package the code's name, the program here, its precision, and what its environment needs."""


def version(package: str, python: str) -> str | None:
    """Of a package in the environment of a Python, None if it is not there."""
    ask = f"import importlib.metadata as m; print(m.version({package!r}))"
    answer = subprocess.run([python, "-c", ask], capture_output=True, text=True, check=False)
    return answer.stdout.strip() if answer.returncode == 0 else None


def rows(case: Case, python: str, quick: bool) -> list[Row]:
    """Runs of the codes that have the case and are installed."""
    out = []
    for peer in case.peers:
        found, (name, *_) = version(peer.package, python), CODES[peer.package]
        if found is None:
            print(f"  {name} is not installed: it has no points (make accuracy installs it)", flush=True)
            continue
        for n in peer.resolutions[:1] if quick else peer.resolutions:
            out.append(_measure(peer, n, python, f"{name} {found}"))
            print("  " + line(out[-1]), flush=True)
    return out


def _measure(peer: Peer, n: int, python: str, code: str) -> Row:
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    _, program, precision, needs = CODES[peer.package]
    settings = {"particles": n, "precision": precision, "code": code}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.npz"
        command = [python, str(FOLDER / program), peer.name, "--particles", str(n), "--out", str(path)]
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads), **needs}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            name = signal.Signals(-done.returncode).name if done.returncode < 0 else "no reason given"
            reason = (done.stderr.strip().splitlines() or [name])[-1]
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
