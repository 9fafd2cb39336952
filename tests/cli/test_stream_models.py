"""Streams that differ from what a model was trained on (rate, axes, unit), and streams that begin anew."""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import rcbht_jax as rj
from rcbht_jax.cli.stream import Serve
from rcbht_jax.introspection import model as model_files
from rcbht_jax.introspection import nominal_file, session
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.introspection.opening import read_opening
from rcbht_jax.io.messages import Sample
from rcbht_jax.io.rosbags import McapWriter, read_bag
from rcbht_jax.io.store import write_recordings
from rcbht_jax.report.pack import infer_beliefs
from tests.support.command_line import json_lines
from tests.support.introspection_models import model, trial


@pytest.mark.parametrize(("axes", "rate"), [("Fx Fy Fz Mx My Mz", 125), ("a b c d e f", 500), ("a b c d e f", None)])
def test_the_page_shows_words_beside_a_model_of_another_rate_or_of_other_names(tmp_path, axes, rate, rcbht):
    """They are encoded at the model's rate, with its names; the page refused what "rcbht stream" reads."""
    named = replace(model(), extra={"axes": axes.split(), "units": [""] * 6})
    model_files.save(tmp_path / "m", named)
    stamps = [{}] * 200 if rate is None else [{"time": k / rate} for k in range(200)]
    rcbht.feed({"wrench": [0.1 * k] * 6, **stamp} for k, stamp in enumerate(stamps))
    opened, _ = Serve(source="-", model=tmp_path / "m", lead=0.5).opened(words=True)
    assert opened.introspector.axes == named.axes
    assert opened.introspector.config.dt == pytest.approx(named.encoder.dt)
    assert opened.introspector.config != named.encoder


@pytest.mark.parametrize(("speed", "live", "recorded"), [(None, 0.0, 1.0), (2.0, 2.0, 2.0)])
def test_a_live_source_is_not_played_at_a_pace(model_path, tmp_path, monkeypatch, speed, live, recorded, rcbht):
    """By its stamps the page stayed as late as it was at the start, where the encoder compiles."""
    speeds = []
    monkeypatch.setattr(session, "paced", lambda messages, pace: [speeds.append(pace), messages][1])
    rcbht.feed(b"")
    write_recordings(tmp_path / "s.zarr", rj.Recordings.from_arrays([trial(1, 3)], rate=200), {})
    for source in ("-", str(tmp_path / "s.zarr")):
        Serve(source=source, model=model_path, speed=speed, rule="paper").opened(words=True)
    assert speeds == [live, recorded]


def test_the_beginning_is_read_at_the_rate_of_the_encoder():
    """Half as many samples a second of a ramp are twice as steep; the thresholds were those of all readings."""
    opening = read_opening(iter([Sample((0.5 * k,), 0.005 * k) for k in range(200)]))
    ramp = opening.recordings(100.0, opening.axes).wrench[0, :, 0]
    np.testing.assert_array_equal(ramp, np.arange(len(ramp)))


def pushes() -> np.ndarray:
    """A noisy force at 600 Hz with a slow push, which is within the noise of its single samples."""
    time = np.arange(1800) / 600
    force = np.interp(time, [0, 1, 1.5, 2, 2.5], [0, 0, 10, 10, 0]) + 0.3 * np.random.default_rng(2).normal(size=1800)
    return force.astype(np.float32).astype(float)


@pytest.mark.parametrize(("rule", "reads"), [("fit", "--sampling-rate"), ("paper", "--monitor")])
def test_a_store_at_another_rate_gives_the_words_of_a_pipe(tmp_path, rcbht, rule, reads):
    """Limits and tolerances were those of the store's own rate, and its noise hid the push."""
    write_recordings(tmp_path / "s.zarr", rj.Recordings.from_arrays([pushes()[:, None]], 600, axes=["Fz"]), {})
    monitor = NominalMonitor(rate=100.0).fit(0.1 * np.random.default_rng(0).normal(size=(20, 100, 1)))
    nominal_file.save(tmp_path / "m", nominal_file.MonitorFile(monitor, ("Fz",), (), ("N",)))
    rcbht.feed({"time": k / 600, "wrench": [v]} for k, v in enumerate(pushes().tolist()))
    options = ["--robot", "auto", "--rule", rule, reads, "100" if reads == "--sampling-rate" else str(tmp_path / "m")]
    words = []
    for source in ([str(tmp_path / "s.zarr")], ["-", "--axes", "Fz"]):
        events = rcbht.events("stream", *source, *options)
        words.append([(e["label"], e["begin"], e["end"]) for e in events if e["event"] == "Word"])
    assert words[0] == words[1]
    assert len(words[0]) > 6


@pytest.mark.parametrize("command", ["stream", "serve", "plot beliefs", "report"])
def test_a_store_that_a_model_would_misread_is_refused(model_path, tmp_path, rcbht, command):
    """Beliefs about forces in another order, or a thousand times as large, looked like any others."""
    right = rj.Recordings.from_arrays([trial(1, 3)], rate=200, trial=["one"])
    turned = replace(right, wrench=right.wrench[..., ::-1], axes=right.axes[::-1], units=right.units[::-1])
    milli = replace(right, wrench=1000 * right.wrench, units=("mN",) * 3 + ("Nm",) * 3)
    for store, said in ((turned, "has the axes Mz, My, Mx, Fz, Fy, Fx; the model learned Fx"), (milli, "has Fx in mN")):
        write_recordings(tmp_path / "s.zarr", store, {}, overwrite=True)
        trials = ["one"] if command == "plot beliefs" else []
        out = ["-o", str(tmp_path / "x.html")] if command == "report" else ["-o", str(tmp_path / "x.png")]
        port = ["--port", "0", "--no-stay"] if command == "serve" else out
        words = [*command.split(), str(tmp_path / "s.zarr"), *trials, "-m", str(model_path), *port]
        assert said in rcbht.refused(*words)


@pytest.mark.parametrize("command", ["stream", "serve"])
def test_a_bag_that_a_model_would_misread_is_refused(tmp_path, rcbht, command):
    """A wrench of ROS is Fx ... Mz in N and Nm; a model of moments first, or of mN, took it for its own."""
    with McapWriter(tmp_path / "run.mcap") as bag:
        for k in range(60):
            bag.wrench(0.005 * k, (0.1 * k,) * 6)
    names = rj.labels.AXES
    for axes, units, said in (
        (names[3:] + names[:3], ("Nm",) * 3 + ("N",) * 3, "has the axes Fx, Fy, Fz, Mx, My, Mz; the model learned Mx"),
        (names, ("mN",) * 3 + ("Nm",) * 3, "has Fx in N; the model learned it in mN"),
        (tuple("abcdef"), ("Nm",) * 3 + ("N",) * 3, "has a in N; the model learned it in Nm"),
    ):
        model_files.save(tmp_path / "m", replace(model(), extra={"axes": list(axes), "units": list(units)}))
        out = ["--port", "0", "--no-stay"] if command == "serve" else ["-o", str(tmp_path / "x.jsonl")]
        assert said in rcbht.refused(command, tmp_path / "run.mcap", "-m", tmp_path / "m", *out)
    replace(model(), extra={"axes": list("abcdef"), "units": [""] * 6}).check_wrench("it")  # names of its own


def a_monitor(path: Path, axes: Sequence[str], units: Sequence[str]) -> Path:
    """A monitor of a signal whose axes differ, at 20 Hz; the first rises."""
    push = np.interp(np.arange(60), [0, 20, 40, 60], [0, 0, 6, 6])[:, None] * np.arange(6, 0, -1)
    fitted = NominalMonitor(rate=20).fit([push + 0.1 * np.sin(k + np.arange(60))[:, None] for k in range(12)])
    nominal_file.save(path, nominal_file.MonitorFile(fitted, tuple(axes), (), tuple(units)))
    return path


@pytest.mark.parametrize("command", ["stream", "serve"])
def test_a_bag_that_a_monitor_would_misread_is_refused(tmp_path, rcbht, command):
    """Any six values passed for those that it learned: in another unit, or of the joints, they were scored."""
    with McapWriter(tmp_path / "run.mcap") as bag:
        for k in range(60):
            bag.wrench(0.05 * k, (0.1 * k,) * 6)
    for axes, units, said in (
        (rj.labels.AXES, ("mN",) * 3 + ("Nm",) * 3, "The stream has Fx in N; the model learned it in mN."),
        (tuple("abcdef"), ("Nm",) * 6, "The stream has a in N; the model learned it in Nm."),
    ):
        monitor = a_monitor(tmp_path / "m", axes, units)
        out = ["--port", "0", "--no-stay"] if command == "serve" else ["-o", str(tmp_path / "x.jsonl")]
        error = rcbht.refused(command, tmp_path / "run.mcap", "--monitor", monitor, "--false-alarms", "0.1", *out)
        assert said in error


@pytest.mark.parametrize("units", [("N",) * 3 + ("Nm",) * 3, ("",) * 6, ()])
def test_a_monitor_reads_the_axes_of_a_bag_by_their_names(tmp_path, rcbht, units):
    """Those of a monitor that learned them in another order took each other's place."""
    turned, wrench = rj.labels.AXES[::-1], np.cumsum(np.ones((60, 6)), 0) * np.arange(6)
    with McapWriter(tmp_path / "run.mcap") as bag:
        for k, row in enumerate(wrench.tolist()):
            bag.wrench(0.05 * k, tuple(row))
    rcbht.feed({"time": 0.05 * k, "wrench": row[::-1]} for k, row in enumerate(wrench.tolist()))
    options = ["--monitor", str(a_monitor(tmp_path / "m", turned, units and units[::-1])), "--false-alarms", "0.1"]
    scores = []
    for source in (str(tmp_path / "run.mcap"), "-"):  # lines have no names: they are in the order of the monitor
        events = rcbht.events("stream", source, *options)
        scores.append([event["score"] for event in events if event["event"] == "AnomalyScore"])
    assert len(scores[0]) == 60
    assert scores[0] == scores[1]


def test_a_stream_that_is_interrupted_in_its_lead_keeps_its_recording(tmp_path, monkeypatch, rcbht):
    """Nothing was written where Ctrl-C came within the ten seconds that give the thresholds."""

    class Interrupted(io.BytesIO):
        def readline(self, size: int | None = -1) -> bytes:
            if line := super().readline(size):
                return line
            time.sleep(1)  # until what came before has been read
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(60)
            return b""

    data = json_lines({"time": 0.01 * k, "wrench": [0.1 * k] * 6} for k in range(200))
    monkeypatch.setattr(sys, "stdin", type("Stdin", (), {"buffer": Interrupted(data)}))
    out, events = tmp_path / "o.mcap", tmp_path / "e.jsonl"
    rcbht.ended(130, "stream", "-", "--mcap", out, "-o", events, "--timeout", 100)
    assert len(list(read_bag(out))) == 200
    words = map(json.loads, events.read_text().splitlines())
    assert max(word["end"] for word in words if word["event"] == "Word") == 200


def test_an_event_before_the_first_reading_is_no_message_of_1970(model_path, tmp_path, rcbht):
    """A line that could not be read made a file of 54 years."""
    rows = [{"wrench": [0.0] * 6, "time": 1.7e9 + 0.005 * k} for k in range(40)]
    rcbht.feed([b"garbage\n", {"begin": True}, *rows])
    words = ["stream", "-", "-m", str(model_path), "--mcap", str(tmp_path / "o.mcap")]
    rcbht(*words, "-o", tmp_path / "o.jsonl")
    with AnyReader([tmp_path / "o.mcap"]) as reader:
        told = [(time * 1e-9, connection.topic) for connection, time, _ in reader.messages()]
    assert min(told)[0] == pytest.approx(1.7e9)
    assert [topic for _, topic in told].count("/events") == 2


def test_trials_follow_each_other_in_a_file(model_path, tmp_path, rcbht):
    """The stamps of each trial begin at zero: in Foxglove and PlotJuggler all trials lay on top of each other."""
    rows = [{"wrench": [float(n)] * 6, "time": 0.005 * k} for n in range(3) for k in range(40 + n)]
    ends = [40, 40 + 41]
    rcbht.feed(row | ({"reset": True} if n in ends else {}) for n, row in enumerate(rows))
    words = ["stream", "-", "-m", str(model_path), "--words", "--mcap", str(tmp_path / "o.mcap")]
    rcbht(*words, "-o", tmp_path / "o.jsonl")
    begins = np.cumsum([0, 39 * 0.005 + 1, 40 * 0.005 + 1])
    expected = [(row["wrench"][0], begins[int(row["wrench"][0])] + row["time"]) for row in rows]
    found = [(sample.wrench[0], sample.time) for sample in read_bag(tmp_path / "o.mcap")]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    with AnyReader([tmp_path / "o.mcap"]) as reader:
        told = [time * 1e-9 for connection, time, _ in reader.messages() if connection.topic == "/words"]
    assert min(time for time in told if time > 1.1) >= 1.195
    assert max(told) == pytest.approx(expected[-1][1])


def test_a_clock_that_goes_back_goes_on_in_a_file(tmp_path, rcbht):
    rows = [{"wrench": [start + k], "time": start + 0.005 * k} for start in (90.0, 50.0) for k in range(40)]
    rcbht.feed(rows)
    words = ["stream", "-", "--axes", "Fz", "--robot", "hiro", "--mcap", str(tmp_path / "o.mcap")]
    rcbht(*words, "-o", tmp_path / "o.jsonl")
    found: dict[str, list[float]] = {}
    with AnyReader([tmp_path / "o.mcap"]) as reader:
        for connection, time, _ in sorted(reader.messages(), key=lambda message: message[1]):
            found.setdefault(connection.topic, []).append(time * 1e-9)
    ends = [90.195, 90.195 + 1 + 0.195]
    np.testing.assert_allclose(found["/signal"], np.r_[rows[0]["time"] : ends[0] : 40j, ends[0] + 1 : ends[1] : 40j])
    events = map(json.loads, (tmp_path / "o.jsonl").read_text().splitlines())
    told = np.array([event["time"] for event in events if event["event"] == "Word"])
    np.testing.assert_allclose(found["/words"], np.where(told < 60, told - 50 + ends[0] + 1, told))


def test_a_signal_in_nmm_is_recorded_as_no_wrench(tmp_path, rcbht):
    """It was one of ROS, which is in Nm, and came back a thousand times too large."""
    axes, units = rj.labels.AXES, ("N",) * 3 + ("Nmm",) * 3
    recordings = rj.Recordings.from_arrays([trial(1, 3)], rate=200, axes=axes, units=units)
    write_recordings(tmp_path / "s.zarr", recordings, {})
    named = replace(model(), extra={"axes": list(axes), "units": list(units)})
    model_files.save(tmp_path / "m", named)
    words = ["stream", str(tmp_path / "s.zarr"), "-m", str(tmp_path / "m"), "--mcap", str(tmp_path / "o.mcap")]
    rcbht(*words, "-o", tmp_path / "o.jsonl")
    with AnyReader([tmp_path / "o.mcap"]) as reader:
        topics = {connection.topic for connection in reader.connections}
    assert topics & {"/signal", "/wrench"} == {"/signal"}


@pytest.mark.parametrize("rule", ["paper", "fit"])
def test_provisional_words_after_a_gap_are_new_ones(rcbht, rule):
    """Words that began at the same sample as one before the gap were not reported, or as its revisions."""
    rcbht.feed({"wrench": [0.0], "time": start + 0.005 * k} for start in (0.0, 2.0) for k in range(60))
    own = ["--tolerance", "0.5"] if rule == "fit" else []
    events = rcbht.events("stream", "-", "--axes", "Fz", "--robot", "hiro", "--rule", rule, "--provisional", *own)
    shown = [
        [(one["sample"], one["layer"], one["label"], one["revision"]) for one in events
         if one["event"] == "ProvisionalWord" and (one["time"] < 1) == first]
        for first in (True, False)
    ]  # fmt: skip
    assert len(shown[0]) >= 4
    assert shown[0] == shown[1]


@pytest.mark.parametrize("starts", [(), ("--starts", "recorded"), ("--starts", "tool")])
def test_sub_tasks_begin_by_the_track_that_the_model_has_learned(model_path, tmp_path, rcbht, starts):
    """By the first track, as before, its beliefs were about stretches that are none of its sub-tasks."""
    marks = [(0, "tool", "light", 0.0, 0.3), (0, "tool", "camera", 0.3, 1.5)]
    marks += [(0, "states", "push", 0.0, 0.75), (0, "states", "mate", 0.75, 1.5)]
    recordings = rj.Recordings.from_arrays([trial(1, 4, 300)], rate=200, annotations=marks)
    write_recordings(tmp_path / "s.zarr", recordings, {})
    events = rcbht.events("stream", tmp_path / "s.zarr", "--model", model_path, *starts)
    began = [(event["begin"], event["label"]) for event in events if event["event"] == "SubtaskStarted"]
    assert began == ([(60, "camera")] if "tool" in starts else [(150, "mate")])


def test_beliefs_of_the_report_are_about_the_sub_tasks_of_the_model():
    marks = [(0, "tool", "light", 0.0, 0.3), (0, "tool", "camera", 0.3, 1.5), (0, "states", "mate", 0.75, 1.5)]
    recordings = rj.Recordings.from_arrays([trial(1, 4, 300)], rate=200, annotations=marks)
    introspector = Introspector(model())
    introspector.push(recordings.wrench[0, :150])
    introspector.begin()
    introspector.push(recordings.wrench[0, 150:])
    states = next(b for b in infer_beliefs(Introspector(model()), recordings, 0) if b.head == "states")
    np.testing.assert_allclose(states.probability[-1], introspector.latest["states"].probabilities, rtol=1e-6)


@pytest.mark.parametrize(
    ("words", "named"),
    [((), "right arm"), (("--arm", "L\x1b"), r"arm L\x1b"), (("--trial", "a"), "right arm"), (("--trial", "b"), "")],
)
@pytest.mark.parametrize("command", ["stream", "serve"])
def test_the_arm_that_is_played_is_named(tmp_path, rcbht, command, words, named):
    """Trials of another arm were skipped without a remark."""
    store = tmp_path / "s.zarr"
    wrench = [trial(1, seed, 40) for seed in range(4)]
    two = rj.Recordings.from_arrays(wrench, rate=200, arm=["R", "L\x1b"] * 2, trial=["a", "a", "b", "c"])
    rj.write_recordings(store, two, {})
    port = ["--port", "0", "--no-stay", "--speed", "0", "--rule", "paper"] if command == "serve" else []
    printed = rcbht.ended(0, command, store, "--robot", "hiro", *words, *port).err
    remarks = [line for line in printed.splitlines() if line.startswith("Only the")]
    assert remarks == [f"Only the {named} is used."] * bool(named)


def test_the_arm_that_a_model_learned_is_played(tmp_path, rcbht):
    """The model of a left arm read the wrench of the right one, without a remark."""
    two = rj.Recordings.from_arrays([trial(1, 3), trial(0, 4)], rate=200, trial=["one"] * 2, arm=["L", "R"])
    write_recordings(tmp_path / "two.zarr", two, {})
    model_files.save(tmp_path / "left", replace(model(), extra={"arm": "L"}))
    model_files.save(tmp_path / "unnamed", model())

    def said(name: str, *words: str) -> str:
        return rcbht("stream", tmp_path / "two.zarr", "--model", tmp_path / name, *words)

    left, right = (said("unnamed", "--arm", arm) for arm in "LR")
    assert (said("left"), said("unnamed"), said("left", "--arm", "R")) == (left, right, right)
    drawn = ["plot", "beliefs", tmp_path / "two.zarr", "one", "--model", tmp_path / "left", "-o", tmp_path / "b.png"]
    assert "left arm" in rcbht(*drawn)
