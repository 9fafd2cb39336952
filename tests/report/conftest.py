"""Pages in a browser."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support import browser


@pytest.fixture(scope="package", autouse=True)
def one_browser() -> Iterator[None]:
    """Chromium starts with the first test that needs it, and ends with the last one."""
    yield
    browser.close()
