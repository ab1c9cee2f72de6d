"""Measure the speed of jaxsph beside other codes and formulations, in the same run on the same cores.

python tests/benchmarks/run.py --only pair_sum,neighbors     some of the parts
python tests/benchmarks/run.py --quick                       small sizes, into out/benchmark_quick.json

Every part runs in a process of its own for each precision, one after the other. Rows are printed as they come and
written to docs/results/benchmark.json after each part; the rows of parts that were not run stay as they are. Exit
code 1 if a part breaks off. A peer that is not installed has a row that says so, without a value.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from measure import machine, threads

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("pair_sum", "neighbors", "structure", "dam_break", "modes", "reach", "turns", "coupled")
PRECISIONS = ("float32", "float64")
COLUMNS = (
    ("case", 30),
    ("figure", 42),
    ("value", 8),
    ("unit", 20),
    ("peer", 13),
    ("precision", 9),
    ("threads", 7),
    ("cpu_per_wall", 8),
    ("resolution", 0),
)


def measure_part(part: str, precision: str, quick: bool, path: Path) -> None:
    """Run one part in this process and leave its rows in a file after each batch."""
    made: list[dict[str, Any]] = []
    for batch in importlib.import_module(part).rows(precision, quick):
        made += batch
        save(path, made)


def run_part(part: str, precision: str, quick: bool) -> tuple[list[dict[str, Any]], bool]:
    """Rows of one part in a fresh process, and whether it went through."""
    environment = {
        **os.environ,
        "JAX_ENABLE_X64": "1" if precision == "float64" else "0",
        "JAX_PLATFORMS": "cpu",
        "OMP_NUM_THREADS": str(threads()),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rows.json"
        command = [sys.executable, __file__, "--part", part, "--precision", precision, "--out", str(path)]
        finished = subprocess.run([*command, "--quick"] if quick else command, env=environment, check=False)
        return load(path), finished.returncode == 0


def load(path: Path) -> list[dict[str, Any]]:
    """Rows of a file, none if there is no file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []


def save(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write all rows at once: a run that is killed leaves the last whole file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    partial.replace(path)


def merge(old: Iterable[dict], new: Sequence[dict], again: Iterable[tuple[str, str]]) -> list[dict]:
    """New rows and the old ones not made again, in the order of the parts.

    Of a (part, precision) measured again no old row stays; of one that broke off those that were not reached stay.
    """

    def origin(row):
        return row["id"].partition(".")[0], row["precision"]

    def key(row):
        return row["id"], row["figure"], row["peer"]

    done, made = set(again), {key(row) for row in new}
    rows = [row for row in old if origin(row) not in done and key(row) not in made] + list(new)
    return sorted(rows, key=lambda row: PARTS.index(origin(row)[0]) if origin(row)[0] in PARTS else len(PARTS))


def table(rows: Sequence[dict[str, Any]]) -> str:
    """All rows, for the screen."""

    def cell(value):
        if value is None:
            return "-"
        return (f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}") if isinstance(value, float) else str(value)

    lines = [" ".join(f"{name:<{width}}" for name, width in COLUMNS)]
    lines += [" ".join(f"{cell(row.get(name)):<{width}}" for name, width in COLUMNS) for row in rows]
    return "\n".join(line.rstrip() for line in lines)


def chosen(only: str | None) -> list[str]:
    """The parts named in a list with commas, all without one. Raises ValueError for a name that is no part."""
    if only is None:
        return list(PARTS)
    names = [name.strip() for name in only.split(",")]
    for name in names:
        if name not in PARTS:
            raise ValueError(f"no part is called {name!r}; there are {', '.join(PARTS)}")
    return [part for part in PARTS if part in names]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; 0 if every part went through."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", metavar="PART,PART", help=f"some of {', '.join(PARTS)}")
    parser.add_argument("--quick", action="store_true", help="small sizes and few repetitions: does it work?")
    parser.add_argument("--out", type=Path, help="file of the rows (default docs/results/benchmark.json)")
    parser.add_argument("--part", choices=PARTS, help=argparse.SUPPRESS)  # how it calls itself for one part
    parser.add_argument("--precision", choices=PRECISIONS, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.part is not None:
        measure_part(options.part, options.precision, options.quick, options.out)
        return 0
    try:
        parts = chosen(options.only)
    except ValueError as error:
        parser.error(str(error))
    default = ROOT / ("out/benchmark_quick.json" if options.quick else "docs/results/benchmark.json")
    path = default if options.out is None else options.out
    old, new, again, broken = load(path), [], [], []
    print(machine(), flush=True)
    for part in parts:
        for precision in PRECISIONS:
            print(f"\n{part}, {precision}", flush=True)
            rows, whole = run_part(part, precision, options.quick)
            new += rows
            if whole:
                again.append((part, precision))
            else:
                broken.append(f"{part} in {precision}")
            save(path, merge(old, new, again))
    print(f"\n{table(new)}\n\n{len(new)} rows written to {path}")
    if broken:
        print(f"broke off: {', '.join(broken)}", file=sys.stderr)
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
