"""Files as tools export messages and arrays: the wrench, its time, and how many recordings there are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.io.importing.importer import read_source

N = 40
TIME = np.arange(N) * 0.01
WRENCH = np.random.default_rng(0).normal(size=(N, 6)).round(3)
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def message(topic: str, number: int, data: dict[str, object]) -> str:
    stamp = {"sec": 1650000000, "nsec": number * 10_000_000}
    return json.dumps({"topic": topic, "sequence": number, "data": {"header": {"stamp": stamp}, **data}})


def test_messages_of_mcap_as_json_are_one_recording(tmp_path: Path) -> None:
    lines = []
    for number, row in enumerate(WRENCH.tolist()):
        force, torque = (dict(zip("xyz", part, strict=True)) for part in (row[:3], row[3:]))
        lines += [message("/ft", number, {"wrench": {"force": force, "torque": torque}})]
        lines += [message("/joints", number, {"position": [0.1, 0.2]})] if number % 2 else []
    (tmp_path / "run.jsonl").write_text("\n".join(lines))
    imported = read_source(tmp_path)
    assert (imported.recordings.axes, imported.recordings.note.tolist()) == (AXES, [f"padded:1;between:{N // 2 - 1}"])
    np.testing.assert_allclose(imported.recordings.wrench[0], WRENCH, rtol=1e-6)
    assert {row["role"] for row in imported.report.understood if row["column"] == "topic"} == {"left out"}


@pytest.mark.parametrize("lengths", [(N, N, N), (N, N - 3, N - 1)])
@pytest.mark.parametrize("form", ["run{}_{}", "logs/run{}/{}", "trial_{}_{}", "demo-{}-{}"])
def test_arrays_that_begin_with_the_number_of_a_recording(form: str, lengths: tuple[int, ...], tmp_path: Path) -> None:
    arrays = {}
    for number, length in enumerate(lengths):
        arrays |= {form.format(number, "time"): TIME[:length], form.format(number, "wrench"): number + WRENCH[:length]}
    np.savez(tmp_path / "all.npz", **arrays)  # type: ignore[arg-type]  # its stub takes no names
    recordings = read_source(tmp_path).recordings
    assert (recordings.axes, tuple(recordings.length.tolist())) == (AXES, lengths)
    np.testing.assert_allclose(recordings.wrench[2, : lengths[2]], 2 + WRENCH[: lengths[2]], rtol=1e-5)


def test_an_empty_column_that_is_called_like_a_time_is_none(tmp_path: Path) -> None:
    rows = [f",{k},,1650000000,{10_000_000 * k},{row[0]},{row[2]}" for k, row in enumerate(WRENCH)]
    (tmp_path / "run.csv").write_text("\n".join(["header,seq,stamp,secs,nsecs,fx,fz", *rows]))
    imported = read_source(tmp_path)
    assert (imported.mapping.time, imported.recordings.dt) == ("secs", 0.01)
