"""MJX without what it and Warp print: standard output is for results."""

from __future__ import annotations

import logging
import sys
import warnings
from contextlib import redirect_stdout
from types import ModuleType
from typing import Any

with redirect_stdout(None):
    from mujoco import mjx

__all__ = ["log_warp", "mjx"]

_LOG = logging.getLogger(__name__)


class _WarpLog:
    """Warp's messages as records of Python's ``logging``, its warnings as Python's."""

    def debug(self, message: str) -> None:
        _LOG.debug(message)

    def info(self, message: str) -> None:
        _LOG.info(message)

    def warning(self, message: str, category: Any = None, stacklevel: int = 1) -> None:
        warnings.warn(message, category, stacklevel=stacklevel)

    def error(self, message: str) -> None:
        _LOG.error(message)


def log_warp(warp: ModuleType) -> None:
    """Send what Warp writes to standard output, a line per kernel that it loads, to ``logging``.

    A logger that somebody else has set stays.
    """
    if type(warp.get_logger()).__name__ == "LoggerBasic":
        warp.set_logger(_WarpLog())


if (_warp := sys.modules.get("warp")) is not None:  # MJX imports it where it is installed
    log_warp(_warp)
