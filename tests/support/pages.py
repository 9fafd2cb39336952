"""Python on pages: blocks of Markdown with the output shown below them, and cells of notebooks."""

from __future__ import annotations

import contextlib
import io
import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
NOTEBOOKS = sorted((ROOT / "docs").rglob("*.ipynb"))
_BLOCK = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", re.S | re.M)


def python_blocks(page: Path) -> list[tuple[str, str]]:
    """Code of each block and the output shown below it, "" where none is shown."""
    return _BLOCK.findall(page.read_text())


def notebook_cells(path: Path) -> list[str]:
    """Code of each code cell."""
    cells = json.loads(path.read_text())["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def run(code: str, namespace: dict[str, Any]) -> str:
    """What code prints; its names stay in ``namespace``."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        exec(compile(code, "page", "exec", dont_inherit=True), namespace)  # not the annotations of this file
    return output.getvalue()
