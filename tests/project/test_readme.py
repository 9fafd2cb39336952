"""The README: its example runs, its commands and links exist; its tables are tested in test_pages."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_python_examples_run() -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})


def test_commands_exist() -> None:
    from rcbht_jax.cli.main import command_name

    lines = re.findall(r"^rcbht (.*)$", (ROOT / "README.md").read_text(), re.M)
    assert lines
    for line in lines:
        assert command_name(line.split()), line


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", (ROOT / "README.md").read_text()):
        assert target.startswith("http") or (ROOT / target).exists(), target
