"""The service's page, driven in headless Chromium."""

import json
import os
import re
import shutil
import time

import pytest

webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium")
pytest.importorskip("fastapi")
import yaml  # noqa: E402
from selenium.webdriver.common.actions.action_builder import ActionBuilder  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402

from tests.server.client import serving  # noqa: E402
from up_samp.fleet.files import write_starter  # noqa: E402
from up_samp.server.jobs import JobQueue  # noqa: E402

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")


@pytest.fixture
def browser(tmp_path):
    if BROWSER is None or DRIVER is None:
        pytest.skip("needs the browser chromium and its chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for argument in (
        "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        "--window-size=1300,1400", f"--user-data-dir={tmp_path / 'profile'}",
    ):  # fmt: skip
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.chrome.service.Service(DRIVER)
    driver = webdriver.Chrome(options=options, service=service)
    yield driver
    driver.quit()


def test_a_person_uploads_a_map_and_sees_a_plan(browser, tmp_path):
    problem_file, _, image = write_starter(tmp_path / "mine")
    problem = yaml.safe_load(problem_file.read_text())
    del problem["map"]
    problem["orders"] = problem["orders"][:1]
    with JobQueue() as jobs, serving(jobs) as client:
        browser.get(client.url)
        find = browser.find_element
        find(By.ID, "picture").send_keys(str(image))
        until(lambda: find(By.ID, "map").is_displayed(), "the map is shown at once")
        put(browser, "resolution", "0.1")
        put(browser, "problem", yaml.safe_dump(problem))
        put(browser, "goal", "1")
        find(By.ID, "send").click()
        until(lambda: "solved" in find(By.ID, "state").text, "a plan", 120)
        until(lambda: browser.find_elements(By.TAG_NAME, "iframe"), "the player")
        frame = find(By.TAG_NAME, "iframe")
        browser.switch_to.frame(frame)
        until(lambda: browser.find_elements(By.ID, "play"), "the player has loaded")
        assert find(By.ID, "clock").text
        browser.switch_to.default_content()
        if "PAGE_PICTURE" in os.environ:
            browser.save_screenshot(os.environ["PAGE_PICTURE"])
        assert find(By.ID, "makespan").text.isdigit()
        errors = [e for e in browser.get_log("browser") if e["level"] == "SEVERE"]
        assert errors == []


def test_what_is_wrong_is_said_on_the_page(browser, tmp_path):
    _, _, image = write_starter(tmp_path / "mine")
    with JobQueue() as jobs, serving(jobs) as client:
        browser.get(client.url)
        browser.find_element(By.ID, "picture").send_keys(str(image))
        put(browser, "problem", "{no json")
        browser.find_element(By.ID, "send").click()
        message = browser.find_element(By.ID, "message")
        until(lambda: "problem.yaml:1: not readable" in message.text, "a word about YAML")
        put(browser, "problem", '{"map": "x.yaml"}')
        browser.find_element(By.ID, "send").click()
        until(lambda: "must not name a map" in message.text, "the server's word")


def put(browser, name, value):
    browser.execute_script(
        "document.getElementById(arguments[0]).value = arguments[1]", name, value
    )


def until(good, what, seconds=60):
    stop = time.monotonic() + seconds
    while time.monotonic() < stop:
        if good():
            return
        time.sleep(0.1)
    raise AssertionError(f"not within {seconds} s: {what}")


def test_a_person_draws_a_site_from_nothing_and_solves_it(browser):
    with JobQueue() as jobs, serving(jobs) as client:
        browser.get(client.url)
        find = browser.find_element
        put(browser, "resolution", "0.1")
        put(browser, "size", "16, 10")
        find(By.ID, "blank").click()
        until(lambda: find(By.ID, "map").is_displayed(), "an empty floor")
        bare = picture(browser)
        drag(browser, "wall", (8, 2.5), (8.3, 10))
        until(lambda: picture(browser) != bare, "a wall")
        drag(browser, "place", (3, 7))
        drag(browser, "place", (13, 7), (13, 8.5))
        drag(browser, "robot", (3, 2))
        drag(browser, "order", (3.1, 7))
        assert "from p1" in find(By.ID, "message").text
        drag(browser, "order", (13, 7.1))
        told = problem_in(browser)
        assert set(told["places"]) == {"p1", "p2"}
        assert told["places"]["p1"] == pytest.approx([3, 7, 0], abs=0.1)
        assert told["places"]["p2"] == pytest.approx([13, 7, 1.57], abs=0.1)
        assert told["robots"]["r1"]["start"] == pytest.approx([3, 2, 0], abs=0.1)
        assert told["orders"] == [{"id": "o1", "pickup": "p1", "delivery": "p2"}]
        put(browser, "goal", "1")
        if "PAGE_PICTURE" in os.environ:
            browser.save_screenshot(os.environ["PAGE_PICTURE"])
        find(By.ID, "send").click()
        until(lambda: "solved" in find(By.ID, "state").text, "a plan", 120)
        until(lambda: browser.find_elements(By.TAG_NAME, "iframe"), "the player")
        job = jobs.all("plan")[-1]
        driven = [row[1:3] for m in json.loads(job.plan)["motions"] for row in m["samples"]]
        # round the wall, by the gap below it
        assert min(y for x, y in driven if abs(x - 8.1) < 0.3) < 2.5
        assert [e for e in browser.get_log("browser") if e["level"] == "SEVERE"] == []


def test_text_and_map_are_kept_in_step(browser):
    with JobQueue() as jobs, serving(jobs) as client:
        browser.get(client.url)
        find = browser.find_element
        find(By.ID, "blank").click()
        until(lambda: find(By.ID, "map").is_displayed(), "an empty floor")
        for x in (3, 8, 13):
            drag(browser, "place", (x, 5))
        for x in (3, 8, 8.1, 13):
            drag(browser, "order", (x, 5))
        assert [o["id"] for o in problem_in(browser)["orders"]] == ["o1", "o2"]
        before = picture(browser)
        typed = problem_in(browser)
        typed["places"]["p1"] = [3, 8, 0]
        put(browser, "problem", json.dumps(typed))
        browser.execute_script("problem.dispatchEvent(new Event('input'))")
        assert picture(browser) != before
        drag(browser, "remove", (3, 8))
        told = problem_in(browser)
        assert (set(told["places"]), [o["id"] for o in told["orders"]]) == ({"p2", "p3"}, ["o2"])
        yaml_text = "places: {p2: [8, 5, 0]}  # mine\n"
        put(browser, "problem", yaml_text)
        drag(browser, "place", (5, 5))
        assert "this text is not" in find(By.ID, "message").text
        assert find(By.ID, "problem").get_attribute("value") == yaml_text


def test_files_are_dropped_and_fit_on_a_phone(browser, tmp_path):
    problem_file, map_file, image = write_starter(tmp_path / "mine")
    browser.set_window_size(500, 1000)  # as narrow as Chromium's window gets
    with JobQueue() as jobs, serving(jobs) as client:
        browser.get(client.url)
        for file in (image, map_file, problem_file):
            drop(browser, file.name, file.read_bytes())
        find = browser.find_element
        until(lambda: find(By.ID, "map").is_displayed(), "the map")
        text = find(By.ID, "problem")
        until(lambda: "robots:" in text.get_attribute("value"), "the problem")
        assert not re.search(r"^map:", text.get_attribute("value"), re.MULTILINE)
        said = yaml.safe_load(map_file.read_text())
        assert float(find(By.ID, "resolution").get_attribute("value")) == said["resolution"]
        wide = browser.execute_script(
            "return [document.documentElement.scrollWidth, innerWidth, devicePixelRatio]"
        )
        assert wide[0] <= wide[1]


def problem_in(browser):
    return json.loads(browser.find_element(By.ID, "problem").get_attribute("value"))


def picture(browser):
    return browser.execute_script("return document.getElementById('map').toDataURL()")


def drag(browser, tool, start, end=None):
    """Press the mouse at a point of the map (m), and let go at another, or there."""
    browser.find_element(By.CSS_SELECTOR, f"input[value={tool}]").click()
    canvas = browser.find_element(By.ID, "map")
    browser.execute_script("arguments[0].scrollIntoView({block: 'nearest'})", canvas)
    ends = browser.execute_script(
        """
        const box = document.getElementById("map").getBoundingClientRect();
        const scale = box.width / editor.picture.width;
        return [arguments[0], arguments[1]].map(point => {
          const [u, v] = editor.pixel(point);
          return [box.left + u * scale, box.top + v * scale];
        });
        """,
        start,
        end or start,
    )
    actions = ActionBuilder(browser)
    actions.pointer_action.move_to_location(*map(round, ends[0])).pointer_down()
    actions.pointer_action.move_to_location(*map(round, ends[1])).pointer_up()
    actions.perform()


def drop(browser, name, data):
    browser.execute_script(
        """
        const files = new DataTransfer();
        files.items.add(new File([new Uint8Array(arguments[1])], arguments[0]));
        dispatchEvent(new DragEvent("drop", {dataTransfer: files, cancelable: true}));
        """,
        name,
        list(data),
    )
