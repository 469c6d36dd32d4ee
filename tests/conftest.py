import gc

import pytest
from unified_planning.engines.factory import Factory

from up_samp.model import deadline
from up_samp.search import budget, proof


def pytest_configure(config):
    # looking for garbage so seldom takes 6 % and more off the time of all tests
    gc.set_threshold(100_000, 25, 25)
    # nobody reads them; for whom they are is looked up in the whole stack for each planner
    Factory._print_credits = lambda *_: None


def pytest_addoption(parser):
    parser.addoption("--long", action="store_true", help="run the slow tests too")


def pytest_collection_finish():
    # what is imported stays: nobody has to look through it for garbage again and again
    gc.collect()
    gc.freeze()


def pytest_unconfigure():
    gc.unfreeze()  # libraries say what is left at the end


def pytest_collection_modifyitems(config, items):
    if config.getoption("--long"):
        return
    slow = [item for item in items if "long" in item.keywords]
    if len(slow) < len(items):
        # to skip a third of all tests one by one takes longer
        items[:] = [item for item in items if "long" not in item.keywords]
        config.hook.pytest_deselected(items=slow)
        return
    for item in slow:
        item.add_marker(pytest.mark.skip(reason="slow; use --long"))


@pytest.fixture(autouse=True)
def nothing_is_refuted(caplog):
    """Fail where a claim of the package was refuted by the package (it logs that as an error)."""
    yield
    told = [r.getMessage() for r in caplog.get_records("call")]
    assert not [message for message in told if message.startswith("refuted:")]


@pytest.fixture(autouse=True, scope="session")
def nobody_else_is_counted():
    """Let deadlines count what is computed: solves get as far however busy the machine is."""
    with deadline.computing_time():
        yield


@pytest.fixture
def on_the_clock(monkeypatch):
    """Let deadlines go by the machine's clock, as they do for users."""
    monkeypatch.setattr(deadline, "_computing", [False])


@pytest.fixture
def unexplained(monkeypatch):
    """Spare most of the time in which fewer facts that leave no schedule, and what these run into,
    are looked for: it is mostly used up.
    """
    monkeypatch.setitem(budget.PARTS, "why there is no schedule", (0.2, 3.0))
    for most in ("_DEMANDS", "_LIMITS"):
        monkeypatch.setattr(proof, most, 0)


@pytest.fixture(autouse=True, scope="session")
def patience_ends_soon():
    """Spare the time in which plans of tests that look at something else might get better."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(budget.PARTS, "patience", (0.0, 0.0))
        patch.setattr(budget, "_PATIENCE", 0.1)
        yield
