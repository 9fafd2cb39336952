"""MJX, imported without the text that it prints where Warp is missing: standard output is for results."""

from __future__ import annotations

from contextlib import redirect_stdout

with redirect_stdout(None):
    from mujoco import mjx

__all__ = ["mjx"]
