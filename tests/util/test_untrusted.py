"""Whatever is wrong with a JSON file is a ValueError."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rcbht_jax._util.untrusted import load_json


def test_json_of_unknown_origin(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for text in ("", "[", "[" * 100_000, '{"a":' * 100_000, "nonsense", "NaN", "[Infinity]", "1e999", "9" * 400):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"."):
            load_json(path)
    for content in (b'["\\ud800"]', b'{"\\udc00": 1}', b'["\xed\xa0\x80"]'):  # half a pair, escaped or not
        path.write_bytes(content)
        with pytest.raises(ValueError, match="not valid Unicode"):
            load_json(path)
    path.write_text('["\\ud83d\\ude00"]')
    assert load_json(path) == ["\U0001f600"]
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"."):
        load_json(path)
    path.write_text('{"a": [1]}')
    assert load_json(path) == {"a": [1]}
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="regular"):
        load_json(tmp_path / "pipe")
