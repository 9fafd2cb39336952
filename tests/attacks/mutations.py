"""What a stranger may do to a file: random damage, and damage that knows the format."""

from __future__ import annotations

import io
import json
import os
import random
import re
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

NUMBERS = (0, -1, 1, 2**31, -(2**63), 10**30, 1e308, 1e-308, -0.0, 1.5, float("nan"), float("inf"), 1e9)
VALUES: tuple[Any, ...] = (
    None,
    True,
    "",
    "x",
    "../x",
    "\x1b[2J\x00",
    [],
    {},
    [[]],
    {"a": 1},
    "NaN",
    "\ud800",
    "9" * 400,
    *NUMBERS,
)
TOKENS = (
    b"nan", b"inf", b"-inf", b"1e999", b"", b"x", b"\x00", b"\xff\xfe", b'"', b",,,,", b"\t", b"1,5", b"0x10", b"-0",
    b"1e-400", "\u0661".encode(), b"\r", b"\r\n", b"\n\n", b"#", b"=1+1", b"{", b"}", b"[", b"]", b"null", b"1_0",
    b"9" * 400,
)  # fmt: skip


def damaged(rng: random.Random, raw: bytes) -> bytes:
    """Bytes after random damage."""
    data = bytearray(raw)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        at, size = rng.randrange(len(data) + 1), rng.choice((1, 2, 4, 8, 64, 300, 3000))
        match rng.randrange(9):
            case 0 | 1 if data:
                data[at % len(data)] ^= 1 << rng.randrange(8)
            case 2:
                del data[at:]
            case 3:
                data[at : at + size] = rng.randbytes(len(data[at : at + size]))
            case 4:
                data[at : at + size] = bytes([rng.choice((0, 255, 32, 10))]) * len(data[at : at + size])
            case 5:
                del data[at : at + size]
            case 6:
                data[at:at] = rng.randbytes(size)
            case 7:
                data[at:at] = data[: rng.randrange(len(data) + 1)][:5000]
            case _:
                return rng.choice((b"", b"\x00" * 100, rng.randbytes(500), raw + raw, raw[::-1][:20_000]))
    return bytes(data)


def damaged_text(rng: random.Random, raw: bytes) -> bytes:
    """A text in which numbers, words or lines are others."""
    if rng.random() < 0.25:
        return damaged(rng, raw)
    for _ in range(rng.choice((1, 1, 2, 5))):
        found = list(re.finditer(rb"[^\s,;=\[\]{}:]+|\n", raw[:200_000]))
        if not found:
            break
        one = rng.choice(found)
        token = rng.choice((*TOKENS, one.group() * 2, rng.choice(found).group(), b"[" * 3000))
        raw = raw[: one.start()] + token + raw[one.end() :]
    return raw


def damaged_json(rng: random.Random, value: Any) -> Any:
    """A JSON value with one part replaced, left out, or of another name."""
    if isinstance(value, dict | list) and value and rng.random() < 0.85:
        copy: Any = dict(value) if isinstance(value, dict) else list(value)
        key = rng.choice(list(copy)) if isinstance(copy, dict) else rng.randrange(len(copy))
        match rng.randrange(8):
            case 0:
                copy.pop(key)
            case 1 if isinstance(copy, dict):
                copy[rng.choice(("evil", "", "a.b", "x" * 500))] = copy.pop(key)
            case 2 if isinstance(copy, list):
                copy += copy[: rng.randrange(1, 4)]
            case _:
                copy[key] = damaged_json(rng, copy[key])
        return copy
    return rng.choice(VALUES)


def damaged_json_text(rng: random.Random, raw: bytes) -> bytes:
    """A JSON file with a damaged value, or damaged as text."""
    if rng.random() < 0.3:
        return damaged_text(rng, raw)
    return json.dumps(damaged_json(rng, json.loads(raw))).encode()


def damaged_archive(rng: random.Random, raw: bytes) -> bytes:
    """An NPZ file with another array, another description, or damaged as bytes."""
    if rng.random() < 0.4:
        return damaged(rng, raw)
    with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = rng.choice(list(arrays))
    if name == "meta" or ("meta" in arrays and rng.random() < 0.5):
        arrays["meta"] = np.array(json.dumps(damaged_json(rng, json.loads(str(arrays["meta"])))))
    else:
        arrays[name] = _damaged_array(rng, arrays[name])
    out = io.BytesIO()
    if rng.random() < 0.1:
        arrays.pop(name)
    np.savez_compressed(out, allow_pickle=True, **arrays)
    if rng.random() < 0.1:
        with zipfile.ZipFile(out, "a") as more, warnings.catch_warnings(action="ignore"):  # of a name twice
            more.writestr(rng.choice(("../x.npy", "x.npy", "meta.npy", "x" * 300)), _header(rng))
    return out.getvalue()


def _damaged_array(rng: random.Random, array: np.ndarray[Any, Any]) -> Any:
    kind = rng.randrange(8)
    if kind == 0:
        return np.array([{"a": 1}], object)
    if kind == 1:
        return np.array(["x"] * 3)
    if kind == 2:
        return array[:0]
    if kind == 3:
        return array[None]
    if kind == 4:
        return np.concatenate([np.atleast_1d(array)] * 2)
    if array.dtype.kind in "fiu" and array.size:
        changed = array.astype(np.float64 if kind == 5 else array.dtype).copy()
        with np.errstate(all="ignore"):
            place = np.unravel_index(rng.randrange(array.size), array.shape)
            number = rng.choice(NUMBERS)
            changed[place] = number if changed.dtype.kind == "f" else int(np.clip(np.nan_to_num(number), -100, 100))
        return changed
    return np.zeros(rng.choice(((1000, 1000), (0, 5), (), (3, 0))))


def _header(rng: random.Random) -> bytes:
    """The beginning of an array of absurd size or type."""
    shape = rng.choice(("(1000000000,)", "(4294967296, 2)", "(-1,)", "(1000000, 1000)", "('a',)", "()"))
    text = (
        f"{{'descr': '{rng.choice(('<f8', 'O', '<U1000000', 'V1000000000', 'm8'))}', 'fortran_order': False, 'shape': "
    )
    head = (text + shape + "}").ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head


def pipe(path: Path) -> None:
    """A pipe to which nobody writes."""
    os.mkfifo(path)


def _declaring(rng: random.Random, raw: bytes) -> bytes:
    """The description of an array that says that it is far larger than its chunks."""
    content = json.loads(raw)
    if shape := content.get("shape"):
        shape[rng.randrange(len(shape))] = rng.choice((10**12, 2**62))
    return json.dumps(content).encode()


def damage_tree(rng: random.Random, folder: Path) -> None:
    """Damage one file of a folder, or what it is."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    path = rng.choice(files)
    kind = rng.randrange(12)
    if kind == 0:
        path.unlink()
        pipe(path)
    elif kind == 1:
        path.unlink()
        path.symlink_to("/dev/zero")
    elif kind == 2:
        path.unlink()
        path.mkdir()
    elif kind == 3:
        path.unlink()
    elif kind == 4:
        path.write_bytes(rng.choice(files).read_bytes())
    elif path.name == "zarr.json" and kind == 5:
        path.write_bytes(_declaring(rng, path.read_bytes()))
    elif path.suffix == ".json" and kind < 10:
        path.write_bytes(damaged_json_text(rng, path.read_bytes()))
    else:
        path.write_bytes(damaged(rng, path.read_bytes()))
