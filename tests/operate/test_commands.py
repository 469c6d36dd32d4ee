"""``up-samp operate``, ``day`` and ``why`` from the command line."""

import json

import pytest

from tests.operate.sites import hall
from up_samp.cli import main
from up_samp.operate.store import Store, StoreError


def site_file(folder, robots=2):
    fleet = hall(folder, robots)
    fleet.add_order("o", "shelf0", {"at": "dock0", "service": 2})
    fleet.add_order("p", "rack1", {"at": "dock1", "service": 2})
    return fleet.save(folder / "site.yaml")


def test_a_day_is_simulated_and_reported(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["day", str(site_file(tmp_path, 1)), "--hours", "0.03", "--orders-per-hour", "60"]
    words += ["--noise", "0.02", "--delays", "0.2", "--out", str(out)]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "judged: 0 contacts, 0 lost, 0 twice, 0 elsewhere, 0 unruly, 0 crowded" in told
    figures = json.loads((out / "day.json").read_text())["figures"]
    assert figures["done"] == figures["orders"] > 0
    for name in ("gantt.png", "orders.png", "waiting.png"):
        assert (out / name).stat().st_size > 5000
    assert main(["why", str(out / "day.db"), "r0", "59:59"]) == 0
    assert "told r0: go to" in capsys.readouterr().out
    assert main(["day", *words[1:]]) == 2
    assert "is there already" in capsys.readouterr().err


def test_operating_begins_with_the_orders_of_the_file(tmp_path, capsys):
    file = site_file(tmp_path)
    words = ["operate", str(file), "--store", str(tmp_path / "day.db"), "--seconds", "2"]
    assert main(words) == 0
    store = Store(tmp_path / "day.db")
    assert set(store.jobs()) == {"o", "p"}
    with pytest.raises(StoreError):
        Store(tmp_path / "day.db")
    assert main(words) == 2
    assert "operated by another process" in capsys.readouterr().err
    store.close()
    assert main(words) == 0


def test_what_cannot_be_operated_is_refused_by_name(tmp_path, capsys):
    fleet = hall(tmp_path, 1)
    fleet.add_robot_type("fork", (0.5, 0.5), unloading="lifo")
    file = fleet.save(tmp_path / "site.yaml")
    assert main(["operate", str(file), "--store", str(tmp_path / "day.db"), "--seconds", "1"]) == 2
    assert "'fork'" in capsys.readouterr().err
