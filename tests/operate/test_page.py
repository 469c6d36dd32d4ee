"""The live floor: an interface with two tokens, and its page in headless Chromium."""

import json
import os
import threading
import urllib.error
import urllib.request

import pytest

pytest.importorskip("fastapi")
pytest.importorskip("selenium", reason="needs selenium")

from selenium.webdriver.common.action_chains import ActionChains

from tests.operate.days import Day
from tests.server.test_page import browser, until  # noqa: F401
from up_samp.server.floor import FloorPage


@pytest.fixture
def floor(tmp_path):
    """A floor whose loop runs in this thread by ``floor.run``."""
    day = Day(tmp_path, robots=2)
    page = FloorPage(day.operation, "127.0.0.1", 0)
    yield day, page
    page.close()
    day.operation.close()


def ask(page, method, path, token, body=None):
    url = page.told[0].partition(": ")[2].partition("/?")[0]
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    data = json.dumps(body or {}).encode() if method == "POST" else None
    request = urllib.request.Request(url + path, data, headers, method=method)
    try:
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.status, json.loads(answer.read())
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.loads(error.read())


def serving(page):
    """Return what makes of a look at the page one for which the page is served first."""

    def seen(good):
        def look():
            page.serve()
            return good()

        return look

    return seen


class Asking:
    """Asks in another thread while the loop serves."""

    def __init__(self, page):
        self.page = page

    def __call__(self, *what):
        found = []
        thread = threading.Thread(target=lambda: found.append(ask(self.page, *what)))
        thread.start()
        while thread.is_alive():
            self.page.serve()
            thread.join(0.01)
        return found[0]


def test_who_may_look_may_not_operate(floor):
    day, page = floor
    told = Asking(page)
    assert told("GET", "/v1/floor", "wrong")[0] == 401
    assert told("POST", "/v1/hold", page.read)[0] == 403
    assert day.operation.held == {}
    assert told("POST", "/v1/hold", page.write, {"robot": "r1", "why": "a test"}) == (
        200, {"done": True},
    )  # fmt: skip
    assert day.operation.held == {"r1": "a test"}
    assert told("POST", "/v1/release", page.write)[0] == 200
    order = {"id": "o1", "pickup": "shelf0", "delivery": "dock0"}
    assert told("POST", "/v1/orders", page.write, order)[0] == 200
    status, why = told("POST", "/v1/orders", page.write, {**order, "id": "o2", "pickup": "shelfX"})
    assert status == 422
    assert "no place 'shelfX'" in why["detail"]
    page._at = 0.0
    page.serve()
    status, seen = told("GET", "/v1/floor", page.read)
    assert [o["id"] for o in seen["orders"]] == ["o1"]
    assert told("DELETE", "/v1/orders/o1", page.write)[0] == 200
    assert day.state("o1") == "cancelled"
    assert told("POST", "/v1/areas/wet", page.write, {"corners": [[1, 1], [2, 1]]})[0] == 422
    by_hand = {"why": "pushed aside", "pose": [6.0, 8.5, 1.0]}
    assert told("POST", "/v1/robots/r1/leave", page.write, by_hand)[0] == 200
    assert day.operation.away == {"r1": "pushed aside"}
    assert day.operation.pose("r1") == (6.0, 8.5, 1.0)
    assert told("POST", "/v1/robots/r1/join", page.write, {"pose": [6.0, 8.5]})[0] == 422
    assert told("POST", "/v1/robots/r1/join", page.write, {"pose": [6.0, 9.0, 0]})[0] == 200
    assert (day.operation.away, day.operation.pose("r1")) == ({}, (6.0, 9.0, 0.0))


def test_an_operator_sees_robots_and_holds_them(floor, browser):  # noqa: F811
    day, page = floor
    day.order("o0", "rack0", "dock1", due=100.0)
    day.order("o1", "shelf2", "dock0", due=40.0)
    day.order("later", "rack1", "dock0", release=1000.0)
    day.until(lambda: day.state("o0") == "planned" and day.state("o1") == "planned")
    stop = day.clock.now() + 6.0
    day.until(lambda: day.clock.now() >= stop)
    day.operation.block("people", [(18.0, 10.0), (22.0, 10.0), (22.0, 13.0), (18.0, 13.0)])

    browser.get(page.told[1].partition(": ")[2])
    find, seen = browser.find_element, serving(page)
    until(seen(lambda: find("id", "link").text == "live"), "the page is live")
    until(seen(lambda: "o1" in find("id", "orders").text), "the orders")
    assert "people" in find("id", "areas").text
    assert "waiting, released in 16 min" in find("id", "orders").text
    if "PAGE_PICTURE" in os.environ:
        browser.save_screenshot(os.environ["PAGE_PICTURE"])
    find("id", "stop").click()
    until(seen(lambda: set(day.operation.held) == {"r0", "r1"}), "all are held")
    until(seen(lambda: "held on the page" in find("id", "robots").text), "the page says so")
    find("id", "go").click()
    until(seen(lambda: not day.operation.held), "all are released")
    browser.execute_script("window.scrollTo(0, 0)")
    find("id", "draw").click()
    corners = ((-100, -60), (-20, -60), (-20, 40), (-100, 40), (-98, -58))
    for x, y in corners:  # the last closes it
        ActionChains(browser).move_to_element_with_offset(
            find("id", "floor"), x, y
        ).click().perform()
    until(seen(lambda: len(day.operation.areas) == 2), "an area drawn by hand")
    (drawn,) = day.operation.areas.keys() - {"people"}
    assert len(day.operation.areas[drawn]) == 4
    until(seen(lambda: drawn in find("id", "areas").text), "the area drawn")
    browser.get(page.told[0].partition(": ")[2])
    until(seen(lambda: "r0" in find("id", "robots").text), "the page to look")
    assert not find("id", "deeds").is_displayed()
    assert not browser.find_elements("css selector", "td button")
    errors = [e for e in browser.get_log("browser") if e["level"] == "SEVERE"]
    assert errors == []


def test_an_operator_says_where_a_robot_stands_that_is_not_heard(floor, browser):  # noqa: F811
    """Nothing is planned anew as long as it may drive on."""
    day, page = floor
    day.order("o0", "rack0", "dock1", robots=["r0"])
    day.until(lambda: day.state("o0") == "planned")
    stop = day.clock.now() + 6.0
    day.until(lambda: day.clock.now() >= stop)
    day.operation.leave("r0", "silent")
    assert day.operation.adrift() == ["r0"]

    browser.get(page.told[1].partition(": ")[2])
    find, seen = browser.find_element, serving(page)
    until(seen(lambda: "nothing is planned anew" in find("id", "robots").text), "what is wrong")
    if "PAGE_PICTURE" in os.environ:
        browser.save_screenshot(os.environ["PAGE_PICTURE"])
    (stands,) = find("id", "robots").find_elements("xpath", ".//button[contains(., 'it stands')]")
    stands.click()
    until(seen(lambda: not day.operation.adrift()), "it is known to stand")
    assert day.operation.away == {"r0": "silent"}
    until(seen(lambda: "it stands" not in find("id", "robots").text), "the page says so")
