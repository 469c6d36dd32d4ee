"""What is wrong with a problem file is told where it is written, in its words, before solving."""

import copy
import cProfile
import dataclasses

import pytest
import yaml

from up_samp.fleet import Fleet, FleetError, read_problem_file
from up_samp.fleet.checks import Level, check_fleet
from up_samp.fleet.faults import find_faults
from up_samp.fleet.fields import FILE_LIMITS
from up_samp.fleet.files import read_record, write_starter
from up_samp.fleet.picture import draw_fleet
from up_samp.fleet.records import Order


@pytest.fixture
def site(tmp_path):
    return write_starter(tmp_path)[0]


def changed(site, old, new):
    text = site.read_text()
    assert old in text
    site.write_text(text.replace(old, new))
    return site


WRONG = [
    ("  home1: [", "  r1: [1, 1, 0]\n  home1: [", r"places\.r1: the name is taken by robots\.r1"),
    ("[1.2, 0.8] ", "[[0, 0], [2, 2], [2, 0], [0, 2]] ", r"crosses itself at \(1, 1\)"),
    ("[1.2, 0.8] ", "[[0, 0], [1, 0], [2, 0]] ", r"agv\.footprint: (has no area|touches)"),
    ("leaf: [0.6, 3.8]", "leaf: [[0, 0], [2, 2], [2, 0], [0, 2]]", r"gate\.leaf: touches or cros"),
    ("dockB: [", "dock B: [", r"places\.dock B: a name has letters.*'dock_B'\?"),
    ("map: warehouse", "map: nowhere", r"problem\.yaml:\d+: map: .*'.*nowhere\.yaml' does not"),
    ("shelf1: [25,", "shelf1: [yes,", r"shelf1\[0\]: should be a number, and is yes, on or true"),
    ("shelf1: [25,", "shelf1: [25:30,", r"'25:30' is no number: .* base 60, as 1530"),
    ("shelf1: [25,", "shelf1: [025,", r"'025' is no number: .* base 8, as 21"),
    ("seconds: 2", "seconds: off", r"gate\.seconds: should be a number, and is no, off or false"),
    ("start: home1", "start: no", r"should be a name .*, or text, and is no, .*quote a name"),
    ("orders:\n", "zones:\n  z: {polygon: [[1, 1]], max_robots: 1}\norders:\n", "needs 3 or more"),
    ("orders:\n", "orders: " + "[" * 40_000 + "\n", "nested too deeply"),
    (
        "shelf1: [25,",
        f"shelf1: [{'9' * 5001},",
        r"problem\.yaml:\d+: \S+: '9+\.\.\. is too long for a",
    ),
    (
        "shelf1: [25,",
        f"shelf1: [0{'7' * 5001},",
        r"yaml:\d+: \S+: '07+\.\.\. is too long for a number",
    ),
    (
        "shelf1: [25,",
        f"shelf1: [0x{'f' * 5001},",
        r"yaml:\d+: \S+: '0xf+\.\.\. is too long for a number",
    ),
    (
        "shelf1: [25,",
        f"shelf1: [1{':59' * 3001},",
        r"yaml:\d+: \S+: '1[:59]+\.\.\. is too long for a nu",
    ),
    ("shelf1: [25,", f"shelf1: [1{':59' * 90},", r"is no number: .* base 60, as [0-9.]+e\+"),
    (
        "shelf1: [25,",
        "shelf1: [2026-13-45,",
        r"problem\.yaml:\d+: \S+: '2026-13-45' cannot be read",
    ),
    (
        "delivery: dockA}",
        "delivery: dockA, window: [0, 2]}",
        r"window: .* belongs to something else",
    ),
]


@pytest.mark.parametrize(("old", "new", "said"), WRONG, ids=range(len(WRONG)))
def test_wrong_files_are_told_by_line(site, old, new, said):
    with pytest.raises(FleetError, match=said) as error:
        read_problem_file(changed(site, old, new))
    assert f"{site}:" in str(error.value)
    assert len({*error.value.faults}) == len(error.value.faults)


BAD = (True, None, -1, 1e12, 1.5, "x y", "25x", [], [1, 2], [[1, 2]], {}, {"a": 1}, 10**400)
PYTHON = ("valid", "validation", "instance", "dictionary", "tuple", "Tuple", "parse", "Input")


def test_messages_are_in_the_words_of_files(site):
    """Every value of a file in turn is something else."""
    good = yaml.safe_load(site.read_text())
    good["zones"] = {"z": {"polygon": [[1, 1], [5, 1], [5, 5]], "max_robots": 2}}
    good["tasks"] = [{"id": "t", "at": ["dockA"], "duration": 2}]
    count = 0
    for path in places(good):
        for bad in BAD:
            data = copy.deepcopy(good)
            part = data
            for key in path[:-1]:
                part = part[key]
            part[path[-1]] = bad
            site.write_text(yaml.safe_dump(data))
            try:
                read_problem_file(site)
            except FleetError as error:
                count += 1
                for fault in error.faults:
                    assert not set(fault.what.split()) & set(PYTHON), (path, bad, fault.what)
    assert count > 200


def places(value, path=()):
    if path and path[0] in ("zones", "tasks", "doors", "robot_types"):
        yield path
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(inner, dict | list):
            yield from places(inner, (*path, key))


def told(site, level):
    findings = check_fleet(read_problem_file(site), site.parent)
    return [f for f in findings if f.level is level]


def test_a_window_that_closes_before_the_shortest_drive(site):
    (found,) = told(changed(site, "window: [0, 300]", "window: [0, 9]"), Level.ERROR)
    assert found.subject == "o3"
    assert "its delivery closes at 9 s; by the shortest drives" in found.what


def test_tardiness_without_due_times(site):
    assert told(site, Level.WARNING) == []
    changed(site, "objective: makespan", "objective: [{tardiness: 10, driving: 1}, makespan]")
    (found,) = told(site, Level.WARNING)
    assert found.subject == "objective"
    assert "say when orders and tasks are due" in found.what
    draw_fleet(read_problem_file(site), site.parent, [found])
    site.write_text(site.read_text().replace("{id: o1,", "{id: o1, due: 50,"))
    assert told(site, Level.WARNING) == []


def test_an_end_where_somebody_stays(site):
    changed(site, "start: home1, end: home1}", "start: home1}")
    (found,) = told(changed(site, "start: home2, end: home2}", "start: home2, end: home1}"),
                    Level.WARNING)  # fmt: skip
    assert "'r1' stands at first, which has no end" in found.what
    changed(site, "robots:\n", "robots:\n  r3: {type: agv, start: home3, end: home3}\n")
    changed(site, "home2: [", "home3: [3, 8, 0]\n  home2: [")
    only = site.read_text().replace("delivery: ", "robots: [r3], delivery: ")
    site.write_text(only.replace("opened_from: button", "opened_from: home1"))
    assert "'r1' stands at first" in told(site, Level.ERROR)[0].what


def test_a_place_for_one_type_alone_is_a_warning_and_drawn(site):
    changed(site, "robots:\n", "  big: {footprint: [3.5, 3.5]}\n\nrobots:\n")
    changed(site, "r2: {type: agv", "r2: {type: big")
    changed(site, "shelf1: [25, 4, 0]", "shelf1: [28.5, 4, 0]")
    assert told(site, Level.ERROR) == []
    findings = check_fleet(read_problem_file(site), site.parent)
    assert ("shelf1", "big") in [(f.subject, f.type) for f in findings]
    ax = draw_fleet(read_problem_file(site), site.parent, findings)
    shapes = [p.get_path().get_extents() for p in ax.patches]
    assert any((s.width, s.height) == pytest.approx((3.5, 3.5)) and s.x1 > 30 for s in shapes)
    changed(site, "type: agv, start", "type: big, start")
    assert "shelf1" in {f.subject for f in told(site, Level.ERROR)}


def test_many_corners_are_refused_by_their_limit(site):
    fleet = Fleet.from_file(site)
    with pytest.raises(FleetError, match=f"the limit is {FILE_LIMITS.corners}: leave out"):
        fleet.add_robot_type("round", [(k, k * k) for k in range(FILE_LIMITS.corners + 1)])


def test_names_are_compared_across_kinds_as_they_are_added(site):
    fleet = Fleet.from_file(site)
    with pytest.raises(FleetError, match="the name is taken by robots"):
        fleet.add_robot("dockA", "agv", "dockA")
    assert "dockA" not in fleet.records.robots


def test_long_chains_and_circles(site):
    text = site.read_text()
    head = text[: text.index("orders:")]
    order = "  - {{id: o{0}, pickup: shelf1, delivery: dockA, after: [{1}]}}\n"
    chain = [order.format(k, f"o{k + 1}") for k in range(1500)]
    last = order.format(1500, "")
    site.write_text(f"{head}orders:\n{''.join(chain)}{last}")
    assert len(read_problem_file(site).orders) == 1501
    site.write_text(f"{head}orders:\n{''.join(chain)}{last.replace('[]', '[o1499]')}")
    with pytest.raises(FleetError, match=r"goes round in a circle: o1(499|500) after o1"):
        read_problem_file(site)


def small_site():
    fleet = Fleet("map.yaml")
    fleet.add_robot_type("agv", (1, 1), capacity={"item": 1})
    for k in range(4):
        fleet.add_place(f"p{k}", k, 0)
    fleet.add_robot("r", "agv", "p0")
    fleet.add_resource("tool")
    fleet.add_task("made", modes={"one": {"duration": 3, "input": "p1", "output": "p2"}})
    fleet.add_order("box", "p1", "p2", attached={"footprint": [0.4, 0.4], "offset": [1, 0, 0]})
    fleet.add_order("taken", "p2", "p3", attached="box")
    return fleet


def test_what_is_added_is_looked_at_with_what_it_names_alone(monkeypatch):
    fleet = small_site()

    def whole(records):
        raise AssertionError("all of it is looked at")

    monkeypatch.setattr("up_samp.fleet.fleet.find_faults", whole)
    for k in range(50):
        after = {"after": f"o{k - 1}"} if k else {}
        fleet.add_order(f"o{k}", {"at": "p1", "resources": "tool"}, {"task": "made"}, **after)
        fleet.add_task(f"t{k}", "p2", duration=1, after=f"o{k}")
    monkeypatch.undo()
    assert find_faults(fleet.records) == []
    assert len(fleet.records.jobs) == 103
    assert [o.id for o in fleet.with_settings(margin=0.2).records.orders][-1] == "o49"


@pytest.mark.parametrize(
    "order",
    [
        {"id": "taken", "pickup": "p1", "delivery": "p2"},
        {"id": "made", "pickup": "p1", "delivery": "p2"},
        {"id": "x", "pickup": "p1", "delivery": "p9"},
        {"id": "x", "pickup": "p1", "delivery": "p2", "after": "nobody"},
        {"id": "x", "pickup": "p1", "delivery": "p2", "after": "x"},
        {"id": "x", "pickup": "p2", "delivery": "p3", "attached": "box"},
        {"id": "x", "pickup": "p3", "delivery": "p1", "attached": "x"},
        {"id": "x", "pickup": "p1", "delivery": "p2", "attached": "taken"},
        {"id": "x", "pickup": "p1", "delivery": {"task": "mode"}},
        {"id": "x", "pickup": "p1", "delivery": "p2", "load": {"item": 2}},
        {"id": "x", "pickup": {"at": "p1", "window": [0, 1], "service": 3}, "delivery": "p2"},
        {
            "id": "x",
            "pickup": "p1",
            "delivery": "p2",
            "attached": {"footprint": [[0, 0], [1, 1], [2, 2]], "offset": [1, 0, 0]},
        },
        {"id": "x", "pickup": "p1", "delivery": "p2", "penalty": 3},
        {"id": "x", "pickup": "p1", "delivery": "p2", "skills": "fly"},
        {"id": "x", "pickup": "p1", "delivery": "p2", "robots": "s"},
    ],
    ids=str,
)
def test_faults_of_what_is_added_are_those_of_the_whole(order):
    fleet = small_site()
    before = fleet.records
    with pytest.raises(FleetError) as told:
        fleet.add_order(**order)
    assert fleet.records == before
    added = read_record(Order, order, ("orders", 2))
    whole = find_faults(dataclasses.replace(before, orders=(*before.orders, added)))
    others = {f for f in whole if f.path[:2] == ("orders", 1)}  # who takes that load, too
    assert set(told.value.faults) == set(whole) - others


def calls_of(site, orders):
    """How many functions are called while a starter problem with so many orders is checked."""
    record = yaml.safe_load(site.read_text())
    record["orders"] = [
        {**copy.deepcopy(record["orders"][k % 3]), "id": f"o{k}"} for k in range(orders)
    ]
    file = site.with_name(f"{orders}.yaml")
    file.write_text(yaml.safe_dump(record))
    profile = cProfile.Profile()
    findings = profile.runcall(check_fleet, read_problem_file(file), file.parent)
    assert not [f for f in findings if f.level is Level.ERROR]
    return sum(entry.callcount for entry in profile.getstats())


def test_what_is_looked_at_grows_with_the_orders_and_not_with_their_pairs(site):
    few, many = calls_of(site, 300), calls_of(site, 3_000)
    assert many < 12 * few
