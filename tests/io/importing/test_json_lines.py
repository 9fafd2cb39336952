"""JSON lines: the readings of a stream, and objects with other fields."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.messages import Sample, read_lines


def write(folder: Path, *lines: object) -> Path:
    path = folder / "run.jsonl"
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    return path


def readings(count: int, start: float = 0.0) -> list[dict[str, object]]:
    wrench = np.random.default_rng(0).normal(size=(count, 6)).round(4).tolist()
    return [{"time": round(start + 0.005 * i, 4), "wrench": row} for i, row in enumerate(wrench)]


def test_a_recorded_stream_is_a_recording_for_each_reset(tmp_path: Path) -> None:
    first, second = readings(40), readings(30, 100.0)
    begin = {"begin": True}
    marked = [*first[:10], begin, *first[10:25], begin, *first[25:]]
    path = write(tmp_path, {"reset": True}, *marked, {"reset": True}, *second)
    recordings = read_source(tmp_path).recordings
    assert recordings.length.tolist() == [40, 30]
    assert recordings.axes == ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    assert recordings.units == ("N", "N", "N", "Nm", "Nm", "Nm")
    with path.open("rb") as file:
        streamed = [message.wrench for message in read_lines(file) if isinstance(message, Sample)]
    np.testing.assert_array_equal(
        np.concatenate([recordings.wrench[0], recordings.wrench[1, :30]]), np.float32(streamed)
    )
    marks = recordings.annotations
    assert marks.labels == {"phase": ("1", "2")}
    assert (marks.recording.tolist(), marks.code.tolist()) == ([0, 0], [0, 1])
    np.testing.assert_allclose(marks.start, [0.05, 0.125])


def test_objects_within_objects_are_columns(tmp_path: Path) -> None:
    lines = [
        {
            "header": {"stamp": {"sec": 1_700_000_000 + i // 100, "nanosec": i % 100 * 10_000_000}, "frame_id": "tool"},
            "wrench": {
                "force": {"x": i, "y": 0, "z": 2.5},
                "torque": {"x": 0, "y": None if 50 < i < 53 else 1.0, "z": i / 10},
            },
            "success": True,
            "parts": [{"id": 1}],
        }
        for i in range(1, 200)
    ]
    imported = read_source(write(tmp_path, *lines), "jsonl")
    assert imported.recordings.wrench.shape == (1, 199, 6)
    assert imported.recordings.dt == 0.01
    assert (imported.recordings.wrench[0, :, 4] == 1).all()  # null is a missing value, between its neighbours
    assert imported.recordings.outcome.tolist() == ["success"]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ({"time": 0.05, "wrench": ["a", 1]}, None),
        ([1, 2], r"line 11: it is no object; expected"),
        ({"time": 10**400}, r"line 11: int too large to convert to float\.$"),
        ({"time": "soon"}, r"line 11: time is a text; before, it was a number\.$"),
        ({"time": 1, "who": 3}, r"line 11: who is a number; before, it was a text\.$"),
        ({"event": "LabelPublished", "time": 1}, r"line 11: it is an event that rcbht stream wrote; the readings"),
        ({f"c{i}": 1 for i in range(5000)}, r"line 11: there are more than 4096 columns\.$"),
    ],
)
def test_what_is_no_reading_is_refused_by_its_line(tmp_path: Path, line: object, reason: str | None) -> None:
    before = [{**row, "who": "ann"} for row in readings(10)]
    path = write(tmp_path, *before, line, *[{**row, "who": "ann"} for row in readings(10, 0.055)])
    if reason is None:  # a list of other things is no column
        assert read_source(path, "jsonl").recordings.wrench.shape == (1, 21, 6)
    else:
        with pytest.raises(InputError, match=reason):
            read_source(path, "jsonl")


@pytest.mark.parametrize("suffix", ["csv", "jsonl"])
def test_a_text_that_would_widen_a_column_beyond_memory_is_refused(tmp_path: Path, suffix: str) -> None:
    path, long = tmp_path / f"a.{suffix}", "x" * 100_000
    if suffix == "csv":
        path.write_text("t,Fz,who\n" + "".join(f"{k / 100},1,ann\n" for k in range(3000)) + f"30,1,{long}\n")
    else:
        rows = [{"t": k / 100, "Fz": 1, "who": "ann" if k < 3000 else long} for k in range(3001)]
        path.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    with pytest.raises(InputError, match=r"column who has a text of 100000 letters among 3001; labels are shorter\.$"):
        read_source(path, suffix)
