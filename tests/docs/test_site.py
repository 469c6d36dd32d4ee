"""The documentation builds as a site, with warnings as errors; the files that it names exist."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
COMPARISON = ROOT / "docs" / "comparison.md"
NAMED = re.compile(r"(?<![\w./*-])[\w./*-]+\.py\b")


def missing(text):
    """Return the Python files between backticks that are neither in the package nor in the
    repository (``*`` as in a shell); a name alone has to be that of a file somewhere.
    """
    named = {f for code in re.findall(r"`([^`\n]+)`", text) for f in NAMED.findall(code)}
    places = [ROOT / name for name in ("up_samp", "tests", "scripts", "examples", "benchmarks")]
    folders = {True: (ROOT / "up_samp", ROOT), False: places}
    return sorted(
        f
        for f in named
        if not any(
            next(folder.glob(f if "/" in f else f"**/{f}"), None) for folder in folders["/" in f]
        )
    )


def test_a_file_that_is_gone_is_found():
    text = "`search/loop.py`, `loop.py: f`, `gone.py`, in `a/gone.py: f` and `up_samp/*/loop.py`"
    assert missing(text) == ["a/gone.py", "gone.py"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_files_that_a_page_names_are_there(page):
    assert missing(page.read_text(encoding="utf-8")) == []


def anchors(text):
    """Return the names by which links lead to the headings of a page, as mkdocs makes them."""
    titles = re.findall(r"^#+ (.*)", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    plain = (re.sub(r"[^\w\s-]", "", title).strip().lower() for title in titles)
    return {re.sub(r"[-\s]+", "-", title) for title in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_to_headings(page):
    text = page.read_text(encoding="utf-8")
    for target, name in re.findall(r"\]\(([\w.-]*)#([^)]+)\)", text):
        other = page.with_name(target or page.name).read_text(encoding="utf-8")
        assert name in anchors(other), f"{target}#{name}"


def test_what_we_say_we_can_is_shown():
    _, _, tables = COMPARISON.read_text(encoding="utf-8").partition("## Feature by feature")
    cells = re.findall(r"^\| [^|]+ \| ([^|]+) \|", tables, re.MULTILINE)
    told = [cell for cell in cells if cell not in {"`up_samp`", "---"}]
    assert len(told) > 40
    assert [cell for cell in told if cell != "no" and "](" not in cell] == []


def test_every_word_of_a_refusal_is_told():
    """The words are the first argument of ``Violation``, and the second one of ``_worst``."""
    told = (ROOT / "docs" / "semantics.md").read_text(encoding="utf-8")
    places = {"Violation": 0, "_worst": 1}
    words = set()
    for file in (ROOT / "up_samp" / "validation").glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            place = places.get(getattr(getattr(node, "func", None), "id", ""))
            if place is not None and isinstance(node.args[place], ast.Constant):
                words.add(node.args[place].value)
    assert len(words) > 20
    assert {word for word in words if f"`{word}`" not in told} == set()


def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("mkdocs")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(tmp_path / "site")],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    for page in PAGES:
        name = "index.html" if page.stem == "index" else f"{page.stem}/index.html"
        assert (tmp_path / "site" / name).exists(), f"{page.name} is not part of the site"
    api = (tmp_path / "site" / "api" / "index.html").read_text()
    assert "seconds_per_unit" in api
    assert "plan_from_dict" in api
