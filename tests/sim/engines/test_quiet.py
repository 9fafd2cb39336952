"""What Warp would print to standard output, where the results of a command with --json are."""

from __future__ import annotations

import logging
import warnings
from types import ModuleType
from typing import Any

import pytest

from sim_mjx.engines.quiet import log_warp


class LoggerBasic:
    """Like Warp's own."""


def _warp(logger: Any) -> ModuleType:
    module = ModuleType("warp")
    active = [logger]
    vars(module).update(get_logger=lambda: active[-1], set_logger=active.append)
    return module


def test_messages_of_warp_are_logged(caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]) -> None:
    warp = _warp(LoggerBasic())
    log_warp(warp)
    with caplog.at_level(logging.DEBUG, "sim_mjx.engines.quiet"):
        warp.get_logger().debug("step")
        warp.get_logger().info("Module smooth load on device 'cuda:0'")
        warp.get_logger().error("no kernel")
    with pytest.warns(DeprecationWarning, match="old"):
        warp.get_logger().warning("old", DeprecationWarning)
    assert [record.levelname for record in caplog.records] == ["DEBUG", "INFO", "ERROR"]
    assert capsys.readouterr().out == ""


def test_a_logger_of_the_user_stays() -> None:
    mine = object()
    warp = _warp(mine)
    log_warp(warp)
    assert warp.get_logger() is mine


def test_the_installed_warp_has_these_functions() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warp = pytest.importorskip("warp", reason='warp-lang is not installed: pip install "rcbht-jax[warp]"')
    assert type(warp.get_logger()).__module__ in ("sim_mjx.engines.quiet", "warp._src.logger")
    assert callable(warp.set_logger)
