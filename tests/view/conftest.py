"""A headless Chromium that is asked for nothing by the network."""

import json
import shutil
import time

import pytest

_ARGUMENTS = (
    *("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--disable-dev-shm-usage"),
    *("--enable-unsafe-swiftshader", "--disable-background-networking", "--disable-sync"),
    *("--disable-component-update", "--disable-default-apps", "--disable-extensions"),
    *("--no-first-run", "--no-default-browser-check", "--metrics-recording-only"),
    *("--force-device-scale-factor=1", "--host-resolver-rules=MAP * ~NOTFOUND"),
)


class Browser:
    """Chromium with one page; ``close`` ends it."""

    def __init__(self, profile, *extra):
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        options.binary_location = shutil.which("chromium")
        for one in (*_ARGUMENTS, "--window-size=720,560", f"--user-data-dir={profile}", *extra):
            options.add_argument(one)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = webdriver.Chrome(options, Service(shutil.which("chromedriver")))
        self.driver.set_script_timeout(20)

    def close(self):
        self.driver.quit()

    def open(self, path, state="ready", seconds=30.0):
        """Load a file and wait until its scene is in ``state``; the seconds that this took."""
        self.driver.get_log("browser")
        self.driver.get_log("performance")
        started = time.monotonic()
        self.driver.get(path.as_uri())
        self.wait(
            lambda: self.run("document.querySelector('.msal-scene').dataset.state") == state,
            seconds,
        )
        self.settle()
        return time.monotonic() - started

    def wait(self, is_so, seconds=10.0):
        end = time.monotonic() + seconds
        while not is_so():
            assert time.monotonic() < end, self.run("document.body.innerText")
            time.sleep(0.02)

    def settle(self):
        """Wait until what was asked for is on the screen."""
        self.driver.execute_async_script(
            "const done = arguments[0];requestAnimationFrame(() => requestAnimationFrame(done))"
        )

    def run(self, expression):
        return self.driver.execute_script(f"return {expression}")

    def press(self, selector, *keys):
        """Focus an element and press keys."""
        from selenium.webdriver.common.action_chains import ActionChains

        self.run(f"document.querySelector({json.dumps(selector)}).focus()")
        for key in keys:
            ActionChains(self.driver, duration=0).send_keys(key).perform()
        self.settle()

    def click(self, text):
        """Click the button of this text."""
        for one in self.driver.find_elements("css selector", "button"):
            if one.text == text:
                one.click()
                return self.settle()
        raise AssertionError(f"there is no button {text!r}")

    def pixels(self, selector=".msal-stage"):
        """(h, w, 3) int16 of an element as it is on the screen."""
        import io

        import numpy as np
        from PIL import Image

        shot = self.driver.find_element("css selector", selector).screenshot_as_png
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(np.int16)

    def requests(self):
        """The addresses that the page asked for since it was opened, but for those in itself."""
        events = [
            json.loads(one["message"])["message"] for one in self.driver.get_log("performance")
        ]
        asked = [
            e["params"]["request"]["url"]
            for e in events
            if e["method"] == "Network.requestWillBeSent"
        ]
        asked += [e["params"]["url"] for e in events if e["method"] == "Network.webSocketCreated"]
        return [url for url in asked if not url.startswith(("data:", "blob:"))]

    def complaints(self):
        """What stands in the console since the page was opened."""
        return [
            one["message"]
            for one in self.driver.get_log("browser")
            # The software renderer tells that reading pixels back is slow.
            if "GPU stall" not in one["message"]
        ]


@pytest.fixture(scope="session")
def browsers(tmp_path_factory):
    """Make browsers by their additional arguments; each is made once."""
    pytest.importorskip("selenium", reason="selenium is not installed")
    for program in ("chromium", "chromedriver"):
        if shutil.which(program) is None:
            pytest.skip(f"there is no {program}")
    made = {}

    def browser(*extra):
        if extra not in made:
            made[extra] = Browser(tmp_path_factory.mktemp("profile"), *extra)
        return made[extra]

    yield browser
    for one in made.values():
        one.close()


@pytest.fixture
def browser(browsers):
    """The browser that most tests share."""
    return browsers()
