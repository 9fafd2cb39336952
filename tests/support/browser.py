"""A real browser without a window, for pages that must work in one."""

from __future__ import annotations

import functools
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip


@functools.cache
def _running() -> tuple[Any, tempfile.TemporaryDirectory[str]]:
    """The driver of a Chromium that all tests of this process share, and its profile: to start one takes seconds."""
    program, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (program and driver):
        pytest.skip("no browser here; install chromium and chromium-driver to test pages in it")
    webdriver = pytest.importorskip("selenium.webdriver")
    profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
    options = webdriver.ChromeOptions()
    options.binary_location = program
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    for flag in (*FLAGS, f"--user-data-dir={profile.name}"):
        options.add_argument(flag)
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(driver)), profile


def close() -> None:
    """End Chromium if it runs."""
    if _running.cache_info().currsize:
        page, profile = _running()
        _running.cache_clear()
        page.quit()
        profile.cleanup()


@contextmanager
def browser(width: int, height: int) -> Iterator[Any]:
    """A Selenium driver of Chromium with a new page of this size in CSS pixels; below 600 it is a phone.

    Skips the test where Chromium or its driver is not installed.
    """
    page, _ = _running()
    empty = page.current_window_handle
    page.switch_to.new_window("window")
    page.implicitly_wait(0)
    page.get_log("browser")  # of former pages
    try:
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        yield page
    finally:
        page.close()
        page.switch_to.window(empty)
