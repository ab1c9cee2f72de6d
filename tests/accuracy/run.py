"""What accuracy costs in time: studies of flows, solids and fits, and the page docs/accuracy.md.

python tests/accuracy/run.py --only taylor_green,cavity    some of the cases
python tests/accuracy/run.py --quick                       coarse only, into out/accuracy

Each case writes its table (docs/results/accuracy/CASE.csv) and its picture (docs/images/accuracy_CASE.png) when it is
done; docs/results/accuracy.json holds the rows of all cases, those that were not run as they were. docs/accuracy.md is
then made from page.md and these. Exit code 1 if a case breaks off.
"""

from __future__ import annotations

import argparse
import math
import platform
import re
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "validation"), str(ROOT / "examples")]  # reference data, measures, fits
jax.config.update("jax_enable_x64", True)

import fit_cases  # noqa: E402
import fluid_cases  # noqa: E402
import peers  # noqa: E402
import solid_cases  # noqa: E402
import surface_cases  # noqa: E402
from cases import Case  # noqa: E402
from rows import load, machine, save  # noqa: E402  # pyright: ignore[reportMissingImports]

from jaxsph.accuracy import Choice, Results, best, cheapest  # noqa: E402

GROUPS = (fluid_cases, surface_cases, solid_cases, fit_cases)
CASES: list[Case] = [case for group in GROUPS for case in group.CASES]


def records(case: Case, results: Results) -> list[dict[str, Any]]:
    """Rows of the table: all runs, marked if they are on a front, then the answers."""
    fronts = {name: set(map(id, results.pareto(name))) for name in results.errors if _known(results, name)}
    about = f"{machine()}, Python {platform.python_version()}, jax {jax.__version__}"
    out = []
    for row in results:
        names = [name for name in row.errors if math.isfinite(row.errors[name])]
        out.append(
            {
                "id": case.id,
                "case": case.title,
                "particles": row.settings.get("particles"),
                "settings": _others(row.settings),
                "code": row.settings["code"],
                **{f"error_{k}": _error(row, results.errors, k) for k in (1, 2, 3)},
                "front": ", ".join(name for name in names if id(row) in fronts.get(name, ())),
                "seconds": _number(row.seconds),
                "compile_seconds": _number(row.compile_seconds),
                "steps": row.steps or None,
                "n_particles": row.n_particles or None,
                "memory_mb": _number(row.memory / 1e6),
                "failure": row.failure,
                "machine": about,
            }
        )
    return out


def answers(case: Case, results: Results) -> list[dict[str, Any]]:
    """What `cheapest` and `best` say, of each error."""
    out = []
    ours = results.where(code="jaxsph")
    for name in results.errors:
        asked = [(f"{name} within {100 * t:g} %", cheapest, t) for t in case.tolerances]
        asked += [(f"{name} in {s:g} s", best, s) for s in case.seconds]
        for question, answer, limit in asked:
            try:
                found: Choice | None = answer(ours, limit, error=name)
            except ValueError:
                found = None
            out.append(
                {
                    "id": f"answer.{case.id}",
                    "case": case.title,
                    "question": question,
                    "particles": found and found.settings["particles"],
                    "settings": _others(found.settings) if found else "none of the runs",
                    "error": found and found.error,
                    "seconds": found and found.row.seconds,
                    "machine": machine(),
                }
            )
    return out


def _known(results: Results, name: str) -> bool:
    return any(math.isfinite(row.errors.get(name, math.nan)) for row in results)


def _error(row, names: Sequence[str], k: int) -> float | None:
    """The k-th error of a row; the table has room for three."""
    return _number(row.errors.get(names[k - 1], math.nan)) if k <= len(names) else None


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _others(settings) -> str:
    shown = []
    for name, value in settings.items():
        if value is not None and name not in ("particles", "code"):
            shown.append(value if isinstance(value, str) else f"{name.replace('_', ' ')} {value:g}")
    return ", ".join(shown)


def run_case(case: Case, quick: bool, python: str, folder: Path) -> None:
    """Measure, then write table, picture and rows."""
    results = case.make(quick)
    results = results + Results(tuple(peers.rows(case, python, quick)))
    print(f"\n{results}\n", flush=True)
    results.save(folder / "results" / "accuracy" / f"{case.id}.csv")
    pictures = folder / "images"
    pictures.mkdir(parents=True, exist_ok=True)
    first = next(iter(case.labels))
    results.plot(pictures / f"accuracy_{case.id}.png", error=first, label=case.labels[first])
    made = {"accuracy": records(case, results), "accuracy_answers": answers(case, results)}
    order = [one.id for one in CASES]
    for name, new in made.items():
        path = folder / "results" / f"{name}.json"
        ids = {row["id"] for row in new}
        rows = [row for row in load(path) if row["id"] not in ids] + new
        save(path, sorted(rows, key=lambda row: order.index(row["id"].removeprefix("answer."))))


def chosen(only: str | None) -> list[Case]:
    """The cases named in a list with commas, all without one. Raises ValueError for a name that is none."""
    if only is None:
        return CASES
    names, known = [name.strip() for name in only.split(",")], [case.id for case in CASES]
    for name in names:
        if name not in known:
            raise ValueError(f"no case is called {name!r}; there are {', '.join(known)}")
    return [case for case in CASES if case.id in names]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; 0 if no case broke off."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", metavar="CASE,CASE", help=f"some of {', '.join(case.id for case in CASES)}")
    parser.add_argument("--quick", action="store_true", help="coarse resolutions only: does it work?")
    parser.add_argument("--out", type=Path, help="folder of results/ and images/ (default docs)")
    parser.add_argument("--peers", default=sys.executable, metavar="PYTHON", help="a Python that has the other codes")
    options = parser.parse_args(arguments)
    try:
        cases = chosen(options.only)
    except ValueError as error:
        parser.error(str(error))
    folder = options.out or ROOT / ("out/accuracy" if options.quick else "docs")
    broken = []
    for case in cases:
        print(f"\n{case.id}: {case.title}", flush=True)
        try:
            run_case(case, options.quick, options.peers, folder)
        except Exception:  # one case that breaks off must not lose the others: its traceback is shown, exit code 1
            traceback.print_exc()
            broken.append(case.id)
    if not options.quick and options.out is None:
        write_page(ROOT / "docs")
    if broken:
        print(f"broke off: {', '.join(broken)}", file=sys.stderr)
    return int(bool(broken))


def write_page(docs: Path) -> None:
    """docs/accuracy.md from page.md, of the cases that have results, with its tables filled as docs/build.py does."""
    sys.path.insert(0, str(docs))
    import build  # pyright: ignore

    known = {row["id"] for row in load(docs / "results" / "accuracy.json")}
    first, *sections = (Path(__file__).parent / "page.md").read_text(encoding="utf-8").split("\n## ")
    asked = lambda text: re.findall(r"results:begin accuracy (\w+)", text)  # noqa: E731
    missing = [case for case in CASES if case.id not in known]
    if missing:
        titles, ids = ", ".join(case.title for case in missing), ",".join(case.id for case in missing)
        first += f'\n**Not measured yet**: {titles}.\n`make accuracy ARGS="--only {ids}"` makes them.\n'
    shown = [first, *(text for text in sections if all(name in known for name in asked(text)))]
    text = build.fill("\n## ".join(shown))  # pyright: ignore[reportAttributeAccessIssue]
    (docs / "accuracy.md").write_text(text, encoding="utf-8")
    print(f"{docs / 'accuracy.md'} written")


if __name__ == "__main__":
    sys.exit(main())
