"""Results on disk: small JSON files with what is needed to repeat them."""

from __future__ import annotations

import inspect
import json
import math
import os
import platform
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jax

import rcbht_jax
from rcbht_jax._util.atomic import atomic_write

COMMITTED = Path(__file__).resolve().parents[1] / "results"
RESULTS = Path(os.environ.get("RCBHT_RESULTS") or COMMITTED).resolve()
_PICTURES = COMMITTED.parents[1] / "docs" / "images"


def committed(name: str) -> Any:
    """The numbers of a committed result, without the record of how they were made."""
    record = json.loads((COMMITTED / f"{name}.json").read_text(encoding="utf-8"))
    return record.get("result", record)


def record_of(name: str, folder: Path | None = None) -> dict[str, Any]:
    """A result file of a folder, ``RESULTS`` by default, as it is; nothing if there is none."""
    path = (folder or RESULTS) / f"{name}.json"
    record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return record


def parts_of(name: str, command: str, parts: Iterable[str]) -> dict[str, Any]:
    """Those parts of a result that are there already, made by the same command."""
    record = record_of(name)
    result = record["result"] if record.get("command") == command else {}
    return {part: result[part] for part in parts if part in result}


def given(values: Mapping[str, Any], defaults: Mapping[str, Any]) -> str:
    """The options of a command that are not the defaults, as they are written; ``FOLDER`` stands for a path.

    >>> given({"trials": 3, "only": ("a", "b c"), "seed": 0}, {"trials": 6, "only": (), "seed": 0})
    " --trials 3 --only a 'b c'"
    """
    words: list[str] = []
    for name, default in defaults.items():
        if (value := values[name]) != default:
            each = value if isinstance(value, tuple | list) else [] if value is True else [value]
            words += [f"--{name.replace('_', '-')}", *("FOLDER" if isinstance(one, Path) else str(one) for one in each)]
    return "".join(f" {shlex.quote(word)}" for word in words)


def defaults_of(main: Callable[..., None]) -> dict[str, Any]:
    """Names and defaults of the options of a program."""
    parameters = inspect.signature(main).parameters.values()
    return {one.name: one.default for one in parameters if one.default is not one.empty}


def machine() -> str:
    """The machine in words."""
    kinds = Counter(device.device_kind for device in jax.devices())
    devices = ", ".join(f"{count} x {kind}" if count > 1 else kind for kind, count in sorted(kinds.items()))
    return f"{os.cpu_count()} CPU cores ({platform.machine()}), JAX {jax.__version__} on {devices}"


def pictures() -> Path:
    """Folder of the pictures that an experiment draws while it measures: beside its results."""
    folder = _PICTURES if RESULTS == COMMITTED else RESULTS / "images"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def not_finite(value: Any, at: str = "result") -> str:
    """Where the first number is that strict JSON cannot hold; "" = nowhere."""
    if isinstance(value, float):
        return "" if math.isfinite(value) else f"{at} is {value}"
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list | tuple) else ()
    return next((found for key, one in pairs if (found := not_finite(one, f"{at} > {key}"))), "")


def write_result(name: str, command: str, result: Any, seed: int | None = None, show: bool = True) -> Path:
    """Write ``<name>.json`` in ``RESULTS``, whole or not at all, and print it if ``show``.

    Raises:
        ValueError: a number is NaN or infinite, which is not JSON; write None, with the reason beside it.
    """
    if wrong := not_finite(result):
        raise ValueError(f"{name}: {wrong}; write None, with the reason beside it.")
    record = {
        "command": command,
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine(),
        "rcbht_jax_version": rcbht_jax.__version__,
        "seed": seed,
        "result": result,
    }
    RESULTS.mkdir(parents=True, exist_ok=True)
    path = RESULTS / f"{name}.json"
    with atomic_write(path) as draft:
        draft.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    if show:
        print(path.read_text())
    return path
