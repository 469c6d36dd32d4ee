"""Others' files that no one should write: each refused by name, in words, in bounded time."""

import copy
import json
import random
from pathlib import Path

import pytest
import yaml

from up_samp.cli import main
from up_samp.fleet.importers import import_file
from up_samp.model import SampError

SAMPLES = Path(__file__).parents[1] / "fleet" / "importers" / "samples"
SVG = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">{}</svg>'
BOX = '<rect width="9" height="9"/>'
BOMB = "".join(
    f'<g id="g{i + 1}">{f"<use href={chr(34)}#g{i}{chr(34)}/>" * 10}</g>' for i in range(9)
)
LIF = '{{"layouts": [{{"nodes": [{{"nodeId": "n", "nodePosition": {{"x": {}, "y": 0}}}}]}}]}}'
LONG = "9" * 5001
RMF = (SAMPLES / "small.building.yaml").read_text()

FILES = {
    "svg: a copy of itself": ("x.svg", SVG.format('<use id="a" href="#a"/>'), "copies what it is"),
    "svg: copies of each other": (
        "x.svg",
        SVG.format('<g id="a"><use href="#b"/></g><g id="b"><use xlink:href="#a"/></g>'),
        "copies what it is",
    ),
    "svg: 10^9 copies": (
        "x.svg", SVG.format(f'<g id="g0">{BOX}</g>{BOMB}'), "more than 200000 elements",
    ),
    "svg: 5,000 groups": ("x.svg", SVG.format("<g>" * 5000 + BOX + "</g>" * 5000), "more than 40"),
    "svg: a million corners": (
        "x.svg", SVG.format(f'<polygon points="{"1,2 " * 1_000_000}"/>'), "more than 200000",
    ),
    "svg: far away": ("x.svg", SVG.format('<rect width="1e300" height="9"/>'), "no number"),
    "svg: not finite": ("x.svg", SVG.format('<path d="M 0 0 L nan 1 L 1e999 1 z"/>'), "x.svg"),
    "svg: entities": (
        "x.svg",
        '<!DOCTYPE svg [<!ENTITY a0 "x">'
        + "".join(f'<!ENTITY a{i + 1} "{f"&a{i};" * 10}">' for i in range(9))
        + "]>" + SVG.format("<text>&a9;</text>"),
        "x.svg: not readable as SVG",
    ),
    "svg: 20 MB": ("x.svg", SVG.format(" " * 20_000_000), "larger than 16 MB"),
    "jsp: a huge number": ("x.jsp", "1 1\n0 1e400", "no number"),
    "jsp: not a number": ("x.jsp", "1 1\n0 nan", "no number"),
    "jsp: a long number": ("x.jsp", f"1 1\n0 {LONG}", "no number"),
    "jsp: a billion jobs": ("x.jsp", "1000000 1\n0 1", "1000000 jobs are announced"),
    "jsp: a hall of 400 km": (
        "x.jsp", f"1 200000\n{'0 1 ' * 200000}", "200000 machines are too many",
    ),
    "jsp: fewer than none": ("x.jsp", "-1 -1\n0 1", "x.jsp"),
    "fjs: a million ways": ("x.fjs", "1 1\n1000000 1000000 1 1", "ends too early"),
    "lif: brackets": ("x.lif", "[" * 100_000, "nested too deeply"),
    "lif: nan": ("x.lif", LIF.format("NaN"), "NaN is no number"),
    "lif: infinite": ("x.lif", LIF.format("1e999"), "inf is no number"),
    "lif: a long number": ("x.lif", LIF.format(LONG), "x.lif"),
    "lif: far away": ("x.lif", LIF.format("1e300"), "no number"),
    "lif: text": ("x.lif", LIF.format('"wide"'), "x.lif"),
    "league: brackets": ("x.json", "[" * 100_000, "nested too deeply"),
    "rmf: brackets": ("x.building.yaml", "levels: " + "[" * 40_000, "nested too deeply"),
    "rmf: blocks": ("x.building.yaml", "- " * 5_000, "nested too deeply"),
    "rmf: a long number": ("x.building.yaml", RMF.replace("500, 100", f"{LONG}, 100"), "x.build"),
    "rmf: infinite": ("x.building.yaml", RMF.replace("500, 100", ".inf, 100"), "no number"),
    "map: a billion cells": ("x.map", "type o\nheight 1000000000\nwidth 1\nmap\n.", "1 rows"),
    "map: a long number": ("x.map", f"type o\nheight {LONG}\nwidth 1\nmap\n.", "x.map"),
    "dxf: nothing of it": ("x.dxf", "0\nSECTION\n" * 1000, "x.dxf"),
    "problem: brackets": ("x.yaml", "orders: " + "[" * 40_000, "x.yaml:1: nested too deeply"),
    "problem: a long number": ("x.yaml", f"map: m.yaml\nmargin: {LONG}", "x.yaml"),
}  # fmt: skip


@pytest.mark.parametrize("kind", FILES)
def test_hostile_files_are_refused_by_name(kind, tmp_path, capsys):
    name, text, said = FILES[kind]
    if name.endswith(".svg"):
        pytest.importorskip("svgelements")
    if name.endswith(".dxf"):
        pytest.importorskip("ezdxf")
    file = tmp_path / name
    file.write_text(text)
    command = ["check", str(file)]
    if not kind.startswith("problem"):
        command = ["import", str(file), "--out", str(tmp_path / "out")]
        command += ["--kind", "league"] if kind.startswith("league") else []
    assert main(command) == 2
    told = capsys.readouterr().err
    assert said in told
    assert str(file) in told
    assert "internal error" not in told
    assert len(told) < 1000


@pytest.mark.parametrize("radius", [1e8, 1e300])
def test_circles_larger_than_any_floor_are_refused(radius, tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    drawing = ezdxf.new(units=6)
    drawing.modelspace().add_circle((0, 0), radius)
    drawing.saveas(tmp_path / "x.dxf")
    with pytest.raises(SampError, match=r"x\.dxf: .* no number up to"):
        import_file(tmp_path / "x.dxf", tmp_path / "out")


def test_a_map_of_a_layout_is_not_written_elsewhere(tmp_path):
    """Its YAML may name an image by any path: cells are copied, not names."""
    (tmp_path / "maps").mkdir()
    examples = Path(__file__).parents[2] / "examples" / "maps"
    (tmp_path / "corridor.png").write_bytes((examples / "corridor.png").read_bytes())
    said = (examples / "corridor.yaml").read_text().replace("corridor.png", "../corridor.png")
    (tmp_path / "maps" / "c.yaml").write_text(said)
    target = tmp_path / "deep" / "out"
    command = ["import", str(SAMPLES / "small.lif.json"), "--out", str(target)]
    assert main([*command, "--map", str(tmp_path / "maps" / "c.yaml")]) == 0
    assert {p.name for p in (tmp_path / "deep").iterdir()} == {"out"}
    assert {p.name for p in target.iterdir()} == {"map.yaml", "map.png", "problem.yaml"}


ODD = (None, True, -1, 0, 10**400, 1e308, float("nan"), float("inf"), "", "x", "9" * 5001, [], {},
       [[]], {"x": 1}, [1, 2, 3])  # fmt: skip


def places_in(value, path=()):
    """The path of everything in nested data."""
    if isinstance(value, list):
        value = dict(enumerate(value))
    for key, part in value.items() if isinstance(value, dict) else ():
        yield (*path, key)
        yield from places_in(part, (*path, key))


def altered(data, rng):
    """The data with one or two values replaced, removed or doubled."""
    data = copy.deepcopy(data)
    for _ in range(rng.choice((1, 1, 2))):
        *path, last = rng.choice(list(places_in(data)))
        part = data
        for key in path:
            part = part[key]
        how = rng.random()
        if how < 0.1:
            del part[last]
        elif how < 0.2 and isinstance(part, list):
            part.append(part[last])
        else:
            part[last] = copy.deepcopy(rng.choice(ODD))
    return data


def altered_words(text, rng):
    """The text with some words replaced or lines moved."""
    lines = [line.split(" ") for line in text.splitlines()]
    for _ in range(rng.choice((1, 1, 2))):
        line = rng.choice(lines)
        odd = ("", "-1", "1e400", "nan", "x", "9" * 5001, "1000000000", "0", "# x", "2.5")
        line[rng.randrange(len(line))] = rng.choice(odd)
        if rng.random() < 0.1:
            rng.shuffle(lines)
    return "\n".join(" ".join(line) for line in lines)


SOURCES = ("small.lif.json", "small.building.yaml", "small.json", "small.jsp", "small.fjs",
           "small.map", "small.scen", "small.svg", "layers.svg")  # fmt: skip


@pytest.mark.parametrize("sample", SOURCES)
@pytest.mark.parametrize(
    ("first", "count"), [(0, 12), pytest.param(12, 500, marks=pytest.mark.long)]
)
def test_altered_files_are_imported_or_refused_by_name(sample, first, count, tmp_path):
    """Whatever is in the place of a value, nothing but an error of ours comes of it."""
    if sample.endswith(".svg"):
        pytest.importorskip("svgelements")
    for beside in SAMPLES.iterdir():
        (tmp_path / beside.name).write_text(beside.read_text())
    text = (SAMPLES / sample).read_text()
    file = tmp_path / f"x.{sample.partition('.')[2]}"
    kind = "league" if sample == "small.json" else None
    refused = []
    for seed in range(first, first + count):
        rng = random.Random(seed)
        if sample.endswith(".json"):
            file.write_text(json.dumps(altered(json.loads(text), rng)))
        elif sample.endswith(".yaml"):
            file.write_text(yaml.safe_dump(altered(yaml.safe_load(text), rng), sort_keys=False))
        else:
            file.write_text(altered_words(text, rng))
        try:
            import_file(file, tmp_path / "out", kind)
        except SampError as error:
            refused.append(str(error))
    assert refused
    assert all(str(file) in text and len(text) < 3000 for text in refused)


@pytest.mark.parametrize("seed", [35, 295])
def test_long_words_of_a_file_are_not_told_whole(seed, tmp_path):
    """A node is called by 5,001 digits where it is listed, or where it is meant."""
    for beside in SAMPLES.iterdir():
        (tmp_path / beside.name).write_text(beside.read_text())
    data = json.loads((SAMPLES / "small.lif.json").read_text())
    file = tmp_path / "x.lif.json"
    file.write_text(json.dumps(altered(data, random.Random(seed))))
    assert LONG in file.read_text()
    with pytest.raises(SampError) as told:
        import_file(file, tmp_path / "out")
    assert str(file) in str(told.value)
    assert len(str(told.value)) < 1000
