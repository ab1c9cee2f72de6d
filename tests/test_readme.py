"""The README: its example runs as it stands, and what it points at exists. Also the tables that fill its markers."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def load_build():
    path = ROOT / "docs" / "build.py"
    spec = importlib.util.spec_from_file_location("docs_build", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


build = load_build()


def smaller(code: str, changes: dict[str, str]) -> str:
    """The example with other sizes; each text must stand in it once, so that the example tested is the one shown."""
    for old, new in changes.items():
        assert code.count(old) == 1, f"{old!r} stands {code.count(old)} times in the example of the README"
        code = code.replace(old, new)
    return code


def test_example_runs(tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    code = smaller(
        code,
        {
            "across=5": "across=3",
            "window=(0.01, 0.9)": "window=(0.01, 0.2)",
            '"examples/data/csm3_tip.csv"': repr(str(ROOT / "examples/data/csm3_tip.csv")),
            '"fit.png"': repr(str(tmp_path / "fit.png")),
        },
    )
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    # Three particles across are too stiff or too soft by several percent; a third of the start is what counts here.
    assert names["fit"]["beam.youngs_modulus"] == pytest.approx(1.4e6, rel=0.2)
    assert names["fit"].verdict == "identifiable"
    assert (tmp_path / "fit.png").stat().st_size > 0


def test_scene_of_ones_own_runs(tmp_path):
    page = (ROOT / "docs" / "fluids.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    code = smaller(
        code,
        {"dx, length, depth, g = 0.02,": "dx, length, depth, g = 0.05,", "t_end=2.0": "t_end=0.1",
         '"sloshing.vtkhdf"': repr(str(tmp_path / "sloshing.vtkhdf")), "progress=True": "progress=False"},
    )  # fmt: skip
    names: dict = {}
    exec(compile(code, "fluids.md", "exec"), names)
    water, tank = names["run"]["water"]["position"], names["run"]["tank"]["position"]
    # the tank goes by .02 (1 - cos .4) m, and the water within it
    assert float(tank[-1, 0, 0] - tank[0, 0, 0]) == pytest.approx(0.02 * (1 - np.cos(0.4)), rel=1e-4)
    assert np.asarray(water)[-1, :, 1].min() > 0
    assert (tmp_path / "sloshing.vtkhdf").stat().st_size > 0


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)]+)\)", README):
        assert target.startswith("http") or (ROOT / target).exists(), target


def test_commands_are_targets():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"`?make (\w+)", README):
        if target != "installs":
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"make {target}"


@pytest.mark.parametrize("page", build.pages(), ids=lambda page: page.name)
def test_markers_come_in_pairs_and_name_tables(page):
    text = page.read_text(encoding="utf-8")
    blocks = build.MARKED.findall(text)
    assert text.count("<!-- results:begin") == len(blocks)
    for _, ask, *_ in blocks:
        assert not ask or ask.partition(" ")[0] in build.TABLES


def test_tables_hold_the_rows_asked_for(tmp_path):
    columns, command = build.TABLES["validation"]
    row = dict.fromkeys([key for key, _ in columns], "x") | {"machine": "a machine", "limit": None}
    rows = [row | {"id": name, "case": name} for name in ("S01", "S02", "I01")]
    (tmp_path / "validation.json").write_text(json.dumps(rows))
    text = "<!-- results:begin validation I,S02 -->\nold\n<!-- results:end -->\n"
    filled = build.fill(text, tmp_path)
    assert re.findall(r"^\| (\w\d\d)", filled, re.MULTILINE) == ["I01", "S02"]
    assert "limit" not in filled and "old" not in filled and f"`{command}` on a machine" in filled
    assert build.fill(filled, tmp_path) == filled
    with pytest.raises(build.BuildError, match="no row whose id starts with 'T'"):
        build.fill(text.replace("I,S02", "T"), tmp_path)
    with pytest.raises(build.BuildError, match="'best' after the ids"):
        build.fill(text.replace("I,S02", "S best"), tmp_path)


def test_worst_row_of_each_case(tmp_path):
    """A miss outweighs what is near its limit, also where the limit is zero or the value not finite."""
    columns, _ = build.TABLES["validation"]
    row = dict.fromkeys([key for key, _ in columns], "x") | {"machine": "a machine"}
    figures = [("a", 0.5, 1.0), ("a", 3e-5, 1e-5), ("a", 9.0, None), ("b", 0.0, 0.0), ("b", -1.0, 2.0), ("c", 1.0, 0.0)]
    figures += [("c", 5.0, 1.0), ("d", None, 1.0), ("d", 2.0, 1.0)]
    rows = [
        row | {"id": "S", "case": case, "figure": f"f{number}", "value": value, "limit": limit}
        for number, (case, value, limit) in enumerate(figures)
    ]
    (tmp_path / "validation.json").write_text(json.dumps(rows))
    filled = build.fill("<!-- results:begin validation S worst -->\n<!-- results:end -->\n", tmp_path)
    lines = re.findall(r"^\| ([abcd]) \| (\d of \d) \| (f\d) ", filled, re.MULTILINE)
    assert lines == [("a", "1 of 2", "f1"), ("b", "2 of 2", "f3"), ("c", "0 of 2", "f5"), ("d", "0 of 2", "f7")]


def test_ratios_of_benchmarks(tmp_path):
    columns, _ = build.TABLES["benchmark"]
    row = dict.fromkeys([key for key, _ in columns], "x") | {"machine": "a machine", "id": "dam"}
    (tmp_path / "benchmark.json").write_text(json.dumps([row, row | {"case": "ratio", "unit": "times"}]))
    filled = build.fill("<!-- results:begin benchmark dam times -->\n<!-- results:end -->\n", tmp_path)
    assert filled.count("| ratio |") == 1 and "| x | x |" not in filled.splitlines()[3]
