"""The figures kept and the tables made from them (scripts/figures.py, scripts/figure_tables.py)."""

import ast
import importlib
import json
import re
import sys
from pathlib import Path

import pytest

from tests.motion.fleet import tight_places
from up_samp.benchmarks import instances

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))


@pytest.fixture(scope="module")
def scripts():
    sys.path.insert(0, str(ROOT / "scripts"))
    try:
        yield {n: importlib.import_module(n) for n in ("figures", "figure_tables", "measures")}
    finally:
        sys.path.remove(str(ROOT / "scripts"))


@pytest.fixture(scope="module")
def figures(scripts):
    return scripts["figures"]


@pytest.fixture(scope="module")
def tables(scripts):
    return scripts["figure_tables"]


def test_every_figure_has_its_function_and_is_named_once(scripts, figures):
    names = [f.name for f in figures.FIGURES]
    assert len(set(names)) == len(names)
    for f in figures.FIGURES:
        assert f.how in scripts["measures"].MEASURES, f.name
        assert set(f.short) <= set(f.cases), f.name
        assert len(set(f.cases)) == len(f.cases), f.name
        assert {v.better for v in f.values} <= {"lower", "higher", ""}, f.name


def is_there(module, name):
    found = importlib.import_module(module)
    package = hasattr(found, "__path__")
    return hasattr(found, name) or (package and importlib.util.find_spec(f"{module}.{name}"))


def test_what_is_measured_with_is_still_in_the_package():
    files = [*(ROOT / "benchmarks").rglob("*.py"), *(ROOT / "scripts").glob("*.py")]
    nodes = [(f.name, n) for f in files for n in ast.walk(ast.parse(f.read_text("utf-8")))]
    used = [(f, n) for f, n in nodes if isinstance(n, ast.ImportFrom) and n.module]
    lost = [
        (file, node.module, name.name)
        for file, node in used
        if node.module.partition(".")[0] == "up_samp"
        for name in node.names
        if not is_there(node.module, name.name)
    ]
    assert len(used) > 50
    assert not lost


def test_the_cases_are_those_of_the_package(figures):
    assert set(figures.PUBLISHED) == {i.name for i in instances("paper")}
    assert set(figures.PROOFS) < set(figures.PUBLISHED)
    assert {name: case.bodies for name, case in tight_places.CASES.items()} == figures.TIGHT


def test_the_tables_of_the_pages_are_what_the_figures_give(figures, tables):
    kept, found = figures.read(figures.KEPT), []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        found += re.findall(r"<!-- figures: ([\w-]+) -->", text)
        assert text == tables.renewed(text, kept), (
            f"{page.name}: run python scripts/figures.py --none --docs"
        )
    assert sorted(found) == sorted(tables.TABLES), "each table is on one page"


def test_a_table_says_what_its_figures_say(tables):
    about = {"commit": "abc", "machine": "M, 2 cores", "load": 0.5}
    row = {"activities": 250, "makespan": 76, "bound": 57, "cpu": 4.14, "cpu_reading": 0.3,
           "cpu_building": 1.3, "cpu_validating": 0.1, "peak": 343.2, **about}  # fmt: skip
    rows = {"5x10": row, "10x30": {"failed": "no answer within 9 s", **about}}
    page = "# A\n<!-- figures: scale -->\nold\n<!-- end -->\nrest\n"
    after = tables.renewed(page, {"scale": rows})
    assert "| 5x10 | 250 | 76 | 57 | 4.1 | 0.3 | 1.3 | 0.1 | 343 |" in after
    assert "no answer within 9 s" in after
    assert "`abc`: M, 2 cores; load 0.5.*" in after
    assert "old" not in after
    rows["10x30"]["load"] = 7.0
    assert "load 0.5 to 7: beside other work" in tables.renewed(page, {"scale": rows})
    rows["10x30"]["load"] = 0.5
    assert after.endswith("<!-- end -->\nrest\n")
    assert tables.renewed(after, {"scale": rows}) == after


def test_a_day_tells_all_that_was_wrong_by_name(tables):
    day = {"orders": 9, "done": 7, "per_hour": 1.0, "tardiness": 0.0, "flow": 0.0, "waiting": 0.0}
    day |= {"plans": 9, "dropped": 1, "planning": 0.1, "step": 0.1, "early": 9.0, "held": 9.0}
    day |= {"commit": "abc", "machine": "M, 2 cores", "load": 0.5, "wrong": 0}
    rows = {"good": day, "bad": day | {"wrong": 3, "crowded": 1, "lost": 2}}
    page = tables.renewed("<!-- figures: days -->\n<!-- end -->\n", {"days": rows})
    assert [line.split(" | ")[6] for line in page.splitlines() if " | 7 of 9 | " in line] == [
        *("0", "2 lost, 1 crowded")
    ]


def one(figures, *values, **more):
    return figures.Figure("f", "house", ("c",), (), 10, values, **more)


def lines_of(figures, value, before, now, machines):
    """``machines``: a letter each, "M" is machine m when it was slow."""
    figure = one(figures, value)
    rows = [
        {value.name: x, "machine": m.lower(), "pace": 90.0 if m == "M" else 30.0}
        for x, m in zip((before, now), machines, strict=True)
    ]
    return list(figures.compared(figure, "c", *rows))


@pytest.mark.parametrize(
    ("value", "before", "now", "machines", "worse"),
    [
        (("makespan", "units", "lower", 0.0), 76, 77, "mm", True),
        (("makespan", "units", "lower", 0.0), 76, 76, "mm", False),
        (("makespan", "units", "lower", 0.02), 100, 102, "mm", False),
        (("makespan", "units", "lower", 0.02), 100, 103, "mm", True),
        (("bound", "units", "higher", 0.0), 57, 56, "mm", True),
        (("bound", "units", "higher", 0.0), 57, 60, "mm", False),
        (("cpu", "s", "lower", 0.25), 10.0, 12.7, "mm", True),
        (("cpu", "s", "lower", 0.25), 10.0, 12.5, "mm", False),
        (("cpu", "s", "lower", 0.25), 10.0, 99.0, "mn", False),  # another machine
        (("cpu", "s", "lower", 0.25), 10.0, 29.0, "mM", False),  # busy with something else
        (("makespan", "units", "lower", 0.0), 76, 77, "mn", True),
        (("cpu", "s", "lower", 0.25), 0.05, 0.14, "mm", False),  # noise
        (("seconds", "s", "", 0.0), 1.0, 9.0, "mm", False),  # only told
        (("makespan", "units", "lower", 0.0), 76, None, "mm", True),  # no plan any more
    ],
)
def test_what_is_worse(figures, value, before, now, machines, worse):
    ((line, verdict),) = lines_of(figures, figures.Value(*value), before, now, machines)
    assert verdict is worse
    assert ("WORSE" in line) is worse


def test_a_failure_is_a_row_that_says_why(figures):
    ((line, verdict),) = figures.compared(one(figures), "c", {}, {"failed": "exit status 1: x"})
    assert verdict
    assert "exit status 1: x" in line


def test_runs_make_medians_and_tell_what_should_have_been_the_same(figures):
    cpu = figures.Value("cpu", "s", tolerance=0.25)
    figure = one(figures, cpu, figures.Value("makespan", "units"))
    rows = [{"cpu": c, "makespan": 7} for c in (3.0, 1.0, 2.0)]
    assert figures.merged(figure, rows) == {"cpu": 2.0, "makespan": 7}
    rows[1]["makespan"] = 8
    found = figures.merged(figure, rows)
    assert found == {"cpu": 2.0, "makespan": 7, "varies": ["makespan"]}
    lines = [line for line, _ in figures.compared(figure, "c", {}, {**found, "machine": "m"})]
    assert ["not the same in all runs" in line for line in lines] == [False, True]
    assert figures.merged(figure, [rows[0], {"failed": "x"}]) == {"failed": "x"}


def test_a_measure_that_fails_or_hangs_is_a_row(figures):
    failed = figures.once(one(figures), "c", ROOT / "nowhere")
    assert failed["failed"] == "exit status 1: AssertionError: no package in this checkout"
    slow = figures.Figure("f", "start_up", ("import up_samp",), (), 0.05, ())
    assert figures.once(slow, "import up_samp", ROOT) == {"failed": "no answer within 0.05 s"}


def test_the_checkout_that_is_measured_is_the_one_that_is_named(figures, tmp_path):
    (tmp_path / "up_samp").mkdir()
    (tmp_path / "up_samp" / "__init__.py").write_text("raise RuntimeError('the other one')\n")
    row = figures.once(one(figures), "c", tmp_path)
    assert (row["lines"], row["files"]) == (1, 1)
    start = figures.Figure("f", "start_up", ("import up_samp",), (), 60, ())
    row = figures.once(start, "import up_samp", tmp_path)
    assert row == {"failed": "exit status 1: RuntimeError: the other one"}


def test_rows_are_written_one_by_one_in_the_order_of_the_list(figures, tmp_path):
    figure = figures.Figure("f", "house", ("b", "a"), (), 10, ())
    figures.put(tmp_path, figure, "a", {"x": 1})
    figures.put(tmp_path, figure, "b", {"x": 2})
    figures.put(tmp_path, figure, "a", {"x": 3})
    kept = json.loads((tmp_path / "f.json").read_text())
    assert list(kept.items()) == [("b", {"x": 2}), ("a", {"x": 3})]
    assert [p.name for p in tmp_path.iterdir()] == ["f.json"]


def test_a_figure_that_is_not_there_is_refused(figures):
    with pytest.raises(SystemExit, match="no figure nothing"):
        figures.chosen(False, ["nothing"])
    assert {f.name for f, _ in figures.chosen(False, ["scale", "house"])} == {"scale", "house"}
    assert [(f.name, c) for f, c in figures.chosen(False, ["scale/5x10"])] == [("scale", "5x10")]
    assert len(figures.chosen(True, [])) < len(figures.chosen(False, [])) / 4


LONG = (
    "executor/10 robots, 200 activities",
    "tight-places/pocket, car",
    "traffic/pillars, car, 5",
    "presets/default",
    "schedulers/ft06",
    "relaxations/jobshop-r1-j3-m6",
    "resolving/jobshop-r2-j2-m2",
    "clairvoyant/jobshop-r2-j2-m2",
    "replan/logistics-do-oc-r3-i4",
)
"""A case of what the package's inside may break without another test that says so."""


@pytest.mark.long
@pytest.mark.parametrize("name", LONG)
def test_it_can_be_measured(figures, name):
    ((figure, case),) = figures.chosen(False, [name])
    row = figures.once(figure, case, ROOT)
    assert "failed" not in row, row
    assert {value.name for value in figure.values} <= set(row)
