"""One run, measured: its time without that of compiling, its steps, its memory."""

from __future__ import annotations

import ctypes
import gc
import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax


@dataclass(frozen=True)
class Cost:
    """Seconds of a run, seconds of compiling it, and bytes by which the process grew at most."""

    seconds: float
    compile_seconds: float
    memory: float


def measured(run: Callable[[], Any], warm_up: Callable[[], Any], share: float, repeats: int) -> tuple[Any, Cost]:
    """A run, and what it cost.

    Args:
        run: makes a run, whose result is ready when it returns.
        warm_up: makes a part of it, for which the same programs are compiled.
        share: how large that part is.
        repeats: of the run; the fastest counts.
    """
    begin = time.perf_counter()
    warm_up()
    first = time.perf_counter() - begin
    seconds, late, grown, result = math.inf, 0.0, math.nan, None
    for _ in range(repeats):
        result = None
        before = _start_of_memory()
        compiling = _Compiling()
        begin = time.perf_counter()
        result = run()
        wall = time.perf_counter() - begin
        # neighbor lists that had to grow were compiled anew on the way
        late += compiling.seconds()
        seconds = min(seconds, wall - compiling.seconds())
        grown = _growth(before)
    return result, Cost(seconds, max(first - share * seconds, 0.0) + late, grown)


_compiled = 0.0
_listening = False
_EVENTS = ("/jax/core/compile/jaxpr_to_mlir_module_duration", "/jax/core/compile/backend_compile_duration")


class _Compiling:
    """Seconds that jax spends on lowering and compiling from now on."""

    def __init__(self):
        global _listening
        if not _listening:
            jax.monitoring.register_event_duration_secs_listener(_listen)
            _listening = True
        self._before = _compiled

    def seconds(self) -> float:
        return _compiled - self._before


def _listen(event: str, duration_secs: float, **_: Any) -> None:
    global _compiled
    if event in _EVENTS:
        _compiled += duration_secs


def _start_of_memory() -> float:
    """Bytes in use, after what is not needed is given back and the mark of the highest is taken down."""
    gc.collect()
    device = jax.devices()[0]
    if device.platform != "cpu":
        return float((device.memory_stats() or {}).get("bytes_in_use", math.nan))
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")
        return _status("VmRSS")
    return math.nan


def _growth(before: float) -> float:
    device = jax.devices()[0]
    if device.platform != "cpu":
        return float((device.memory_stats() or {}).get("peak_bytes_in_use", math.nan)) - before
    return max(_status("VmHWM") - before, 0.0) if math.isfinite(before) else math.nan


def _status(name: str) -> float:
    """A number of /proc/self/status [bytes]."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return 1024.0 * float(line.split()[1])
    return math.nan
