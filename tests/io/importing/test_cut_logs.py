"""Logs whose last line was cut off while it was written: all others are read, and the report quotes that one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import Imported, read_source

N = 30
FORCES = np.random.default_rng(0).normal(size=(N, 3)).round(3)
HEAD = "t,Fx,Fy,Fz,phase\n"
ROWS = "".join(f"{k * 0.01:.2f},{','.join(map(str, FORCES[k]))},{'für' if k < 9 else 'zu'}\n" for k in range(N))


def read(tmp_path: Path, content: str | bytes, name: str = "run.csv") -> Imported:
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return read_source(tmp_path / name)


def same(imported: Imported, quoted: str) -> None:
    recordings = imported.recordings
    assert recordings.note.tolist() == ["lines:1"]
    np.testing.assert_allclose(recordings.wrench[0], FORCES, rtol=1e-6)
    assert recordings.annotations.names().tolist() == ["für", "zu"]
    quote = f"'{quoted} (the last line, which is cut off)'"
    assert any(quote in remark for remark in imported.report.remarks), imported.report.remarks


@pytest.mark.parametrize("cut", ["0.30,1.2", "0.30", "0.3", "0.30,1.5,2.5,3.5"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_last_line_without_an_end_is_no_mistake(cut: str, end: str, tmp_path: Path) -> None:
    """The whole file was refused."""
    same(read(tmp_path, (HEAD + ROWS + cut).replace("\n", end)), f"{cut.split(',')[0]}, ...")


def test_a_log_of_numbers_may_be_cut_off(tmp_path: Path) -> None:
    rows = "".join(f"{k * 0.01:.2f} {' '.join(map(str, FORCES[k]))}\n" for k in range(N))
    for cut in ("0.30 1.", "0.30 1.5 2.5 1.250e", "0.30 1.5 2.5 1.250E-"):
        imported = read(tmp_path, f"t Fx Fy Fz\n{rows}{cut}")
        np.testing.assert_allclose(imported.recordings.wrench[0], FORCES, rtol=1e-6)


def test_a_sign_cut_in_two_does_not_change_the_encoding(tmp_path: Path) -> None:
    """The file was read as Windows-1252: its labels were garbled."""
    content = (HEAD.replace("phase", "phase,more") + ROWS.replace("\n", ",1\n") + "0.30,1.5,2.5,3.5,fü").encode()[:-1]
    same(read(tmp_path, content), "0.30, ...")


@pytest.mark.parametrize("text", [HEAD + ROWS + "0.30,1.2\n", HEAD + ROWS.replace("0.05,", '"0.05,') + "0.30,1"])
def test_a_short_line_with_an_end_and_an_open_quote_remain_mistakes(text: str, tmp_path: Path) -> None:
    """A quote that is not closed takes all later lines into its cell: these must not be lost."""
    with pytest.raises(InputError, match="cells; expected 5"):
        read(tmp_path, text)


@pytest.mark.parametrize("cut", ['{"t": 0.3, "Fx": 1.', '{"a": {"x": 1}', "{"])
def test_json_lines_may_be_cut_off(cut: str, tmp_path: Path) -> None:
    rows = [
        {
            "t": round(k * 0.01, 2),
            **dict(zip(("Fx", "Fy", "Fz"), FORCES[k], strict=True)),
            "phase": "für" if k < 9 else "zu",
        }
        for k in range(N)
    ]
    lines = "\n".join(map(json.dumps, rows))
    same(read(tmp_path, f"{lines}\n{cut}", "run.jsonl"), f"{cut} ...")
    with pytest.raises(InputError, match="line 31"):
        read(tmp_path, f"{lines}\n{cut}\n", "run.jsonl")
