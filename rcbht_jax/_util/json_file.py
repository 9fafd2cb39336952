"""JSON files of unknown origin: whatever is wrong with one is a ValueError."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def load_json(path: Path) -> Any:
    """The value in a JSON file.

    >>> load_json(Path("limits.json"))  # doctest: +SKIP

    Raises:
        OSError: the file cannot be read.
        ValueError: it is a pipe or a device, which might never end, is not JSON, or is nested too deeply.
    """
    if path.exists() and not path.is_file():
        raise ValueError(f"{path} is not a regular file")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
