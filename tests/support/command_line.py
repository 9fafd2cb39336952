"""The command ``rcbht`` as tests call it."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from rcbht_jax.cli.main import main


class CommandLine:
    """Calls of ``rcbht`` with words of any type; each returns what that call printed."""

    def __init__(self, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
        self._capsys, self._monkeypatch = capsys, monkeypatch

    def __call__(self, *words: object) -> str:
        """Standard output of a call that succeeds."""
        return self.ended(0, *words).out

    def refused(self, *words: object) -> str:
        """Standard error of a call whose input is wrong."""
        return self.ended(2, *words).err

    def json(self, *words: object) -> dict[str, Any]:
        """The result as JSON, which is all of standard output."""
        return json.loads(self(*words, "--json"))

    def events(self, *words: object) -> list[dict[str, Any]]:
        """The lines of JSON on standard output."""
        return [json.loads(line) for line in self(*words).splitlines()]

    def feed(self, lines: bytes | Iterable[dict[str, Any] | bytes] | np.ndarray) -> None:
        """Put bytes, lines of JSON or readings ``[time, axis]`` at 200 Hz on standard input."""
        data = lines if isinstance(lines, bytes) else json_lines(lines)
        self._monkeypatch.setattr(sys, "stdin", type("Stdin", (), {"buffer": io.BytesIO(data)}))

    def ended(self, status: int, *words: object) -> Any:
        """What a call with this exit status printed: out and err."""
        self._capsys.readouterr()
        found = main([str(word) for word in words])
        said = self._capsys.readouterr()
        assert found == status, said.err
        assert "Traceback" not in said.err
        return said


def json_lines(rows: Iterable[dict[str, Any] | bytes] | np.ndarray) -> bytes:
    """Rows as lines of JSON, bytes as they are; an array is readings at 200 Hz."""
    if isinstance(rows, np.ndarray):
        rows = [{"wrench": row, "time": 0.005 * k} for k, row in enumerate(rows.tolist())]
    return b"".join(row if isinstance(row, bytes) else json.dumps(row).encode() + b"\n" for row in rows)
