"""The picture of the page in README and docs: the top of a results folder's report.html, as a browser shows it.

    python tools/make_page_picture.py runs docs/images/page.png [ADDRESS]

Needs chromium, chromedriver and selenium (the extra `test`). ADDRESS: what follows report.html, to choose a case.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

SIZE = {"width": 1280, "height": 1240, "deviceScaleFactor": 1, "mobile": False}


def main(runs: str, picture: str, address: str = "") -> None:
    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for word in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"):
        options.add_argument(word)
    options.add_argument(f"--user-data-dir={tempfile.mkdtemp()}")
    browser = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", SIZE)
        browser.get(f"{(Path(runs) / 'report.html').absolute().as_uri()}{address}")
        time.sleep(3)
        browser.execute_script("scrollTo(0, 0)")
        bottom = browser.execute_script("return document.querySelector('.player').getBoundingClientRect().bottom + 24")
        shown = cv2.imdecode(np.frombuffer(browser.get_screenshot_as_png(), np.uint8), cv2.IMREAD_COLOR)
        cv2.imwrite(picture, shown[: int(bottom)], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    finally:
        browser.quit()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", metavar="RUNS", help="results folder")
    parser.add_argument("picture", metavar="PICTURE", help="the file to write (.png)")
    parser.add_argument("address", nargs="?", default="", metavar="ADDRESS", help="what follows report.html")
    main(**vars(parser.parse_args()))
