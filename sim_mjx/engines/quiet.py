"""MJX, imported without what it prints where Warp is missing: standard output is for results, JSON among them."""

from __future__ import annotations

from contextlib import redirect_stdout

with redirect_stdout(None):
    from mujoco import mjx

__all__ = ["mjx"]
