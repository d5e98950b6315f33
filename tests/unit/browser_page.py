"""A headless Chromium for tests of pages; they are skipped, with the reason, where there is none."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ALONE = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--hide-scrollbars",
)  # fmt: skip
LOCAL = ("file:", "data:", "blob:", "about:")


def started(folder: Path) -> Iterator[Any]:
    """A browser with a profile of its own in a folder, until it is no longer wanted."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    from selenium.webdriver.chrome.service import Service

    browser, driver = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if not browser or not driver:
        pytest.skip("no chromium and chromedriver here (Debian: apt-get install chromium chromium-driver)")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for word in (*ALONE, f"--user-data-dir={folder}"):
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=Service(driver))
    try:
        yield found
    finally:
        found.quit()


UNFOLDED = """for (const part of document.querySelectorAll("details")) part.open = true;
    for (let y = 0; y < document.documentElement.scrollHeight; y += 700) {
        scrollTo(0, y);
        await new Promise((next) => setTimeout(next, 60));
    }
    scrollTo(0, 0);"""


class Page:
    """One page in the browser. `faults()`: what the console says, and every request beyond the file itself;
    `barriers()`: what axe-core finds that shuts people out.
    """

    def __init__(self, browser: Any):
        self.browser = browser

    def open(self, path: Path, address: str = "", width: int = 1280, dark: bool = False) -> Page:
        said = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        self.browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", said)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
        self.browser.get("about:blank")
        for log in ("browser", "performance"):
            self.browser.get_log(log)
        self.browser.get(f"{path.as_uri()}{address}")
        return self

    def run(self, script: str) -> Any:
        """What a script returns, awaited."""
        told = self.browser.execute_async_script(
            f"const done = arguments[0]; (async () => {{ {script} }})()"
            ".then((value) => done({ value }), (fault) => done({ fault: String(fault) }))"
        )
        assert "fault" not in told, told["fault"]
        return told.get("value")

    def wait(self, condition: str) -> None:
        """Until a condition holds, in whichever page is loaded by then; an error after twenty seconds."""
        from selenium.common.exceptions import JavascriptException

        for _ in range(400):
            with contextlib.suppress(JavascriptException):  # the page was just being loaded anew
                if self.browser.execute_script(f"return Boolean({condition})"):
                    return
            time.sleep(0.05)
        raise AssertionError(condition)

    def barriers(self) -> list[str]:
        """One line for each element that breaks a rule, with all of the page unfolded and drawn."""
        from axe_core_python.selenium import Axe

        self.run(UNFOLDED)
        self.wait('document.querySelectorAll(".later [data-fragment]").length === 0')
        found = Axe().run(self.browser, options={"resultTypes": ["violations"]})
        return [f"{rule['id']}: {one['html'][:200]}" for rule in found["violations"] for one in rule["nodes"]]

    def faults(self) -> list[str]:
        said = [entry["message"] for entry in self.browser.get_log("browser")]
        events = [json.loads(entry["message"])["message"] for entry in self.browser.get_log("performance")]
        asked = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
        return said + [url for url in asked if not url.startswith(LOCAL)]
