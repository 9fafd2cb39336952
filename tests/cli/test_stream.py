"""The commands for streams, end to end."""

from __future__ import annotations

import io
import json
import sys
import threading
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax._util import compile_cache
from rcbht_jax.cli.main import main
from rcbht_jax.introspection import model as model_files
from rcbht_jax.io.store import read_recordings
from rcbht_jax.report import live_page
from tests.support.introspection_models import model, trial


@pytest.fixture(autouse=True)
def no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """The programs of these tests stay out of the user's cache."""
    monkeypatch.setattr(compile_cache, "use", lambda folder: None)


@pytest.fixture
def model_path(tmp_path: Path) -> Path:
    model_files.save(tmp_path / "m", model())
    return tmp_path / "m"


class Stdin:
    def __init__(self, data: bytes) -> None:
        self.buffer = io.BytesIO(data)


def lines(wrench: np.ndarray) -> bytes:
    return b"".join(
        json.dumps({"wrench": row, "time": 0.005 * k}).encode() + b"\n" for k, row in enumerate(wrench.tolist())
    )


def test_standard_input_to_json_lines(model_path, tmp_path, capsys, monkeypatch):
    data = lines(trial(1, 30, 200)) + b'garbage\n{"begin": true}\n'
    monkeypatch.setattr(sys, "stdin", Stdin(data))
    assert main(["stream", "-", "-m", str(model_path), "--mcap", str(tmp_path / "o.mcap")]) == 0
    said = capsys.readouterr()
    events = [json.loads(line) for line in said.out.splitlines()]
    assert [e["event"] for e in events if e["event"] != "Belief"][-2:] == ["Notice", "SubtaskStarted"]
    assert sum(e["event"] == "Belief" for e in events) == 30
    assert "200 sample" in said.err
    assert (tmp_path / "o.mcap").stat().st_size > 1000


def test_events_to_a_file_and_a_summary(model_path, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Stdin(lines(trial(0, 31, 100))))
    out = tmp_path / "e.jsonl"
    assert main(["stream", "-", "-m", str(model_path), "-o", str(out), "--rate", "0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["events"]["Belief"] == 60
    assert len(out.read_text().splitlines()) >= 60


def test_wrong_input(model_path, tmp_path, capsys):
    (tmp_path / "x").write_text("no bag")
    (tmp_path / "x.mcap").write_text("no bag")
    for words in (
        ["stream", "none", "-m", str(model_path)],
        ["stream", str(tmp_path / "x"), "-m", str(model_path)],
        ["stream", str(tmp_path / "x.mcap"), "-m", str(model_path)],
        ["stream", str(tmp_path), "-m", str(model_path)],
        ["stream", "-", "-m", str(tmp_path / "x")],
        ["stream", "-", "-m", str(model_path), "--speed", "-1"],
        ["serve", "none", "-m", str(model_path)],
        ["export-model", str(tmp_path / "x")],
    ):
        assert main(words) == 2
        error = capsys.readouterr().err
        assert error.startswith("rcbht: ")
        assert "Traceback" not in error


def test_serve_shows_a_source_to_its_end(model_path, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Stdin(lines(trial(2, 32, 300))))
    frames: list[bytes] = []
    looking: list[threading.Thread] = []
    enter = live_page.PageServer.__enter__

    def watched(server: live_page.PageServer) -> live_page.PageServer:
        enter(server)
        answer = urllib.request.urlopen(server.url + "frames", timeout=60)
        looking.append(threading.Thread(target=lambda: frames.append(answer.read())))
        looking[0].start()
        return server

    monkeypatch.setattr(live_page.PageServer, "__enter__", watched)
    assert main(["serve", "-", "-m", str(model_path), "--port", "0", "--no-stay", "--speed", "0"]) == 0
    looking[0].join(30)
    assert b"event: end" in frames[0]
    last = json.loads([line for line in frames[0].splitlines() if line.startswith(b"data: {")][-1][6:])
    assert last["sample"] == 300


def test_train_then_stream_a_recorded_trial(hiro_store, tmp_path, capsys):
    path = tmp_path / "m"
    words = ["train-online", str(hiro_store), "--source", "SIM_HIRO_TWO_SA_SUCCESS", "-o", str(path), "--json"]
    assert main(words) == 0
    head = json.loads(capsys.readouterr().out)["heads"]["states"]
    assert head["classes"] == ["approach", "rotation", "insertion", "mating"]
    assert "differ in length" in head["confounds"]
    assert main(["stream", str(hiro_store), "-m", str(path), "--trial", *_first_trial(hiro_store)]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    starts = [e["begin"] for e in events if e["event"] == "SubtaskStarted"]
    beliefs = [e for e in events if e["event"] == "Belief"]
    assert len(starts) == 3
    truth = np.searchsorted(starts, [e["sample"] for e in beliefs])
    right = [e["label"] == head["classes"][k] for e, k in zip(beliefs, truth, strict=True)]
    assert np.mean(right) > 0.9


def _first_trial(store: Path) -> list[str]:
    recordings = read_recordings(store)
    return [str(recordings.trial[recordings.source == "SIM_HIRO_TWO_SA_SUCCESS"][0])]
