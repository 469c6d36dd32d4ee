"""The service's page, driven in headless Chromium."""

import os
import shutil
import time

import pytest

webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium")
pytest.importorskip("fastapi")
import yaml  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402

from tests.server.client import serving  # noqa: E402
from up_samp.fleet.starter import write_starter  # noqa: E402
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


def until(good, what, seconds=20):
    stop = time.monotonic() + seconds
    while time.monotonic() < stop:
        if good():
            return
        time.sleep(0.1)
    raise AssertionError(f"not within {seconds} s: {what}")
