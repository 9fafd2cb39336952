"""Checkpoints of interrupted work: JSON that is resumed only by the same work."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax._util.untrusted import load_json
from rcbht_jax.errors import InputError


def save(path: Path, made_by: Any, content: Any) -> None:
    """Write a checkpoint, atomically.

    Args:
        path: file to create or replace.
        made_by: everything that the content depends on (JSON value).
        content: JSON value; infinities and NaN are allowed.
    """
    with atomic_write(path) as draft:
        draft.write_text(json.dumps({"made_by": made_by, "content": content}), encoding="utf-8")


def load(path: Path, made_by: Any) -> Any:
    """The content of a checkpoint; None if there is no file.

    Raises:
        InputError: the file is damaged, not a checkpoint, or belongs to a run with another ``made_by``.
    """
    try:
        stored = load_json(path, finite=False)
        known, content = stored["made_by"], stored["content"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is not a checkpoint or is damaged; delete it to start again.") from error
    wanted = json.loads(json.dumps(made_by))
    if known != wanted:
        name, known, wanted = first_difference(known, wanted)
        differs = f"{name} {json.dumps(known)}, not {json.dumps(wanted)}".lstrip()
        if known is wanted is None:
            differs = f"one of them alone has {name}"
        raise InputError(
            f"{path} belongs to a run with other data or options ({differs}); finish that run, choose another file, or "
            "delete this one to start again."
        )
    return content


def first_difference(known: Any, wanted: Any, name: str = "") -> tuple[str, Any, Any]:
    """The place of the first value in which two JSON values differ, and that value in both; None = null or lacking.

    >>> first_difference({"job": {"seed": 1}}, {"job": {"seed": 2}})
    ('job.seed', 1, 2)
    """
    if not (isinstance(known, dict) and isinstance(wanted, dict)):
        return name, known, wanted
    keys = sorted({*known, *wanted})
    key = next(key for key in keys if (key in known) != (key in wanted) or known.get(key) != wanted.get(key))
    return first_difference(known.get(key), wanted.get(key), f"{name}.{key}" if name else key)
