"""The figures of scripts/house.py, on a small package whose figures are known."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def house():
    spec = importlib.util.spec_from_file_location("house", ROOT / "scripts" / "house.py")
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules["house"] = module
    spec.loader.exec_module(module)
    return module


def write(folder, **files):
    (folder / "up_samp").mkdir()
    for name, text in files.items():
        (folder / "up_samp" / f"{name}.py").write_text(text)


def test_a_circle_of_imports_is_counted_once(house, tmp_path):
    write(
        tmp_path,
        one="from up_samp.two import f\n",
        two="from up_samp import three\n",
        three="def g():\n    import up_samp.one\n",
        four="from up_samp import one\n",
    )
    assert house.measure(tmp_path).circles == [["up_samp.one", "up_samp.three", "up_samp.two"]]


def test_imports_for_types_are_no_circle(house, tmp_path):
    write(
        tmp_path,
        one="from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from up_samp.two import f\n",
        two="from up_samp import one\n",
    )
    figures = house.measure(tmp_path)
    assert figures.circles == []
    assert figures.type_circles == [["up_samp.one", "up_samp.two"]]


def test_names_of_classes_rooms_and_tunables(house, tmp_path):
    write(
        tmp_path,
        one="class Work:\n    pass\n\n\nclass Only:\n    pass\n",
        two="class Work:\n    x: int = 1\n\n\nclass T:\n    a: int = tunable(1)\n    b: int\n",
    )
    room = tmp_path / "up_samp" / "room"
    room.mkdir()
    for number in range(21):
        (room / f"f{number}.py").write_text("")
    figures = house.measure(tmp_path)
    assert figures.shared_names == ["Work"]
    assert figures.big_rooms == ["up_samp/room"]
    told = figures.values()
    assert (told["classes"], told["tunables"], told["files"], told["lines"]) == (4, 1, 23, 13)


def test_functions_constants_and_lines(house, tmp_path):
    long = "def long():\n" + "    x = 1\n" * 51
    write(
        tmp_path,
        one='"""Docstring."""\n# note\nA = 1\nB: float = -2.5 * 3\nC = "text"\nD = True\n' + long,
        two="def wide(self, a, b, c, d, e, f, *, g):\n    return [x for x in a if b]\n",
    )
    figures = house.measure(tmp_path)
    assert (figures.functions, figures.long_functions, figures.wide_functions) == (2, 1, 1)
    assert (figures.constants, figures.files_with_constants) == (2, 1)
    assert figures.lines == 4 + 52 + 2


def test_what_stands_twice_counts_both_places(house, tmp_path):
    same = "".join(f"    step_{n}()\n" for n in range(7))
    write(
        tmp_path,
        one=f"def one():\n{same}",
        two=f"def two():\n{same}    other()\n",
        three="def three():\n    step_0()\n",
    )
    assert house.measure(tmp_path).said_twice == 2


@pytest.fixture(scope="module")
def package(house):
    return house.measure(ROOT)


def test_this_package_has_no_circle(package):
    assert package.files > 200
    assert package.circles == []


LIMITS = {
    "long_functions": 1,
    "wide_functions": 15,
    "long_files": 0,
    "said_twice": 7,
    "tunables": 9,
}
NUMBERS = 238
CLASSES = 527
COUNTS = {"shared_names": 0, "type_circles": 0, "big_rooms": 0}
"""What the figures may be at most: lower them when they fall, never raise them for convenience."""


def test_the_figures_do_not_grow(package):
    grown = {k: (getattr(package, k), most) for k, most in LIMITS.items()
             if getattr(package, k) > most}  # fmt: skip
    grown |= {k: (found, most) for k, most in COUNTS.items()
              if (most < len(found := getattr(package, k)))}  # fmt: skip
    assert not grown, f"(now, at most): {grown}; see scripts/house.py"
    # a tunable that no sweep shows to matter becomes a constant beside its use
    assert package.tunables + package.constants <= NUMBERS
    assert package.class_count <= CLASSES
    # what is left out of lines alone (imports, problems built line by line) raises this: count both
    assert package.branches / package.lines < 0.2750
