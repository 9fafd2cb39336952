"""Rows of results: as the files hold them, in the table of a report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.report.page import results_html
from rcbht_jax.report.results import SCHEMA, cells, read_results

RESULTS = Path(__file__).resolve().parents[2] / "experiments" / "results"


def rows_file(folder: Path, **changed: Any) -> Path:
    """A file of result rows in the schema of docs/howto/share.md."""
    peer = {"name": "rocket", "mean": 0.99, "interval": [0.9, 1]}
    row = {"group": "g", "what": "<b>first</b>", "paper": "0.97", "ours": 0.9812, "interval": [0.95, 1], "peer": peer,
           "duration": 0.5, "flags": ["few"], "source": "a.json"}  # fmt: skip
    second = row | {"what": "second", "paper": "", "interval": None, "peer": None, "duration": None, "flags": []}
    record = {
        "schema": SCHEMA,
        "notes": {"few": "Only <three> trials.", "unused": "never"},
        "sources": [{"file": "a.json", "command": "make a", "date": "today", "machine": "2 cores"}],
        "rows": [row, second],
    }
    path = folder / "rows.json"
    path.write_text(json.dumps(record | changed), encoding="utf-8")
    return path


def test_result_rows_are_shown_with_their_notes(tmp_path: Path) -> None:
    rows_file(tmp_path)
    (tmp_path / "a.json").write_text('{"result": 1}')  # no schema: ignored
    results = read_results(tmp_path)
    first, second = (cells(row) for row in results.rows)
    assert first == ("<b>first</b>", "0.97", "0.981", "0.950 to 1.000", "0.990 (0.900 to 1.000) rocket", "0.500")
    assert second == ("second", "", "0.981", "", "", "")
    html = results_html(results)
    for part in ("&lt;b&gt;first", '<a href="#note-1">1</a>', '<li id="note-1">Only &lt;three&gt; trials.', "make a"):
        assert html.count(part) == 1
    assert "never" not in html
    assert html.count("<tr>") == 5  # two heads, two rows, one source


def test_the_committed_rows_can_be_read() -> None:
    results = read_results(RESULTS)
    assert {row.source for row in results.rows} <= {source.file for source in results.sources}
    assert sum(row.peer is not None for row in results.rows) >= 8


@pytest.mark.parametrize(
    "changed",
    [
        {"rows": [{}]}, {"rows": 1}, {"notes": {}}, {"notes": None}, {"sources": [{"file": "a.json"}]},
        *({"rows": [{"group": "g", "what": "w", "paper": "", "ours": 1, "interval": None, "flags": [], "peer": None,
                     "duration": None, "source": "a.json"} | wrong]}
          for wrong in ({"ours": "high"}, {"ours": "0.5"}, {"duration": "inf"}, {"interval": ["inf", 1]},
                        {"interval": [1]}, {"what": 5}, {"peer": {"name": "p", "mean": "inf", "interval": [0, 1]}})),
    ],
)  # fmt: skip
def test_rows_outside_the_schema_are_one_sentence(changed: dict[str, Any], tmp_path: Path) -> None:
    rows_file(tmp_path, **changed)
    with pytest.raises(InputError, match=f"rows.json does not follow the schema {SCHEMA}"):
        read_results(tmp_path)


@pytest.mark.parametrize(
    ("changed", "lacks"),
    [
        ({"notes": None}, "it has no object 'notes'"),
        ({"rows": {}}, "it has no list 'rows'"),
        ({"rows": [7]}, "row 1 is no object"),
        ({"rows": [{"group": "g", "what": "w"}]}, "row 1 has no 'paper'"),
        ({"notes": {"other": ""}}, "row 1 has the flag 'few', for which there is no note"),
        ({"sources": [{"file": "a.json"}]}, "source 1 has no 'command'"),
        ({"sources": [{"file": 1, "command": "", "date": "", "machine": ""}]}, "source 1: file is '1', which is not"),
    ],
)
def test_what_a_file_of_rows_lacks_is_said(changed: dict[str, Any], lacks: str, tmp_path: Path) -> None:
    rows_file(tmp_path, **changed)
    with pytest.raises(InputError) as raised:
        read_results(tmp_path)
    assert str(raised.value).partition(f"follow the schema {SCHEMA}: ")[2].startswith(lacks)
    assert "Error" not in str(raised.value)


def test_what_a_peer_lacks_is_said(tmp_path: Path) -> None:
    rows = json.loads(rows_file(tmp_path).read_text())["rows"]
    del rows[0]["peer"]["mean"]
    rows_file(tmp_path, rows=rows)
    with pytest.raises(InputError, match=r"schema .*: the peer of row 1 has no 'mean'\.$"):
        read_results(tmp_path)


def test_a_folder_without_rows_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[]")
    with pytest.raises(InputError, match='expected a JSON file with "schema"'):
        read_results(tmp_path)
    (tmp_path / "a.json").unlink()
    rows_file(tmp_path, rows=[])
    with pytest.raises(InputError, match='expected a JSON file with "schema"'):
        read_results(tmp_path)
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(InputError, match=r"a\.json is not JSON"):
        read_results(tmp_path)


def test_notes_belong_to_their_file(tmp_path: Path) -> None:
    rows_file(tmp_path).rename(tmp_path / "a.json")
    rows_file(tmp_path, notes={"few": "Only <three> trials.", "own": ""})
    assert len(read_results(tmp_path).rows) == 4
    rows_file(tmp_path, notes={"few": "Forty trials."})
    with pytest.raises(InputError, match=r"rows.json does not .*: another file has another note for the flag 'few'"):
        read_results(tmp_path)
    rows_file(tmp_path, notes={})
    with pytest.raises(InputError, match=r"rows.json does not .*: row 1 has the flag 'few', for which there is no"):
        read_results(tmp_path)
