"""The commands for streams, end to end."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import urllib.request
from pathlib import Path

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.thresholds import write_thresholds
from rcbht_jax.encoding.tolerance import auto_tolerance
from rcbht_jax.introspection import model as model_files
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.rosbags import McapWriter, read_bag
from rcbht_jax.io.store import read_recordings
from rcbht_jax.labels import LAYERS
from rcbht_jax.report import live_page
from tests.support.command_line import json_lines
from tests.support.introspection_models import trial


def test_standard_input_to_json_lines(model_path, tmp_path, rcbht):
    rcbht.feed(json_lines(trial(1, 30, 200)) + b'garbage\n{"begin": true}\n')
    said = rcbht.ended(0, "stream", "-", "-m", model_path, "--mcap", tmp_path / "o.mcap")
    events = [json.loads(line) for line in said.out.splitlines()]
    assert [e["event"] for e in events if e["event"] != "Belief"][-2:] == ["Notice", "SubtaskStarted"]
    assert sum(e["event"] == "Belief" for e in events) == 30
    assert re.search(r": messages read: .*sample 200.*; events: .*Belief 30", said.err)
    assert (tmp_path / "o.mcap").stat().st_size > 1000


def test_events_to_a_file_and_a_summary(model_path, tmp_path, rcbht):
    rcbht.feed(trial(0, 31, 100))
    out = tmp_path / "e.jsonl"
    assert rcbht.json("stream", "-", "-m", model_path, "-o", out, "--rate", "0")["events"]["Belief"] == 60
    assert len(out.read_text().splitlines()) >= 60


def test_wrong_input(model_path, tmp_path, rcbht):
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
        assert rcbht.refused(*words).startswith("rcbht: ")


def test_wrong_sources_leave_old_outputs_alone(model_path, tmp_path, rcbht):
    """Neither what a wrong source would have replaced, nor a file that is read and named as an output."""
    bag, events, mcap = tmp_path / "x.mcap", tmp_path / "e.jsonl", tmp_path / "o.mcap"
    with McapWriter(bag) as out:
        for k in range(20):
            out.wrench(0.005 * k, (0.0,) * 6)
    before = {path: path.read_bytes() for path in (bag, model_path)}
    events.write_text("an hour")
    mcap.write_text("another hour")
    outputs = ["-o", str(events), "--mcap", str(mcap)]
    for words, sentence in (
        (["stream", str(bag), "--topic", "/typo", *outputs], "no wrenches on /typo"),
        (["stream", str(bag), "-o", str(bag)], "is used as source"),
        (["stream", str(bag), "--mcap", str(bag)], "is used as source"),
        (["stream", str(bag), "-m", str(model_path), "-o", str(model_path)], "is used as model"),
        (["export-model", str(model_path), "-o", str(model_path)], "is used as model"),
    ):
        error = rcbht.refused(*words, *(["-m", str(model_path)] if "-m" not in words and words[0] == "stream" else []))
        assert sentence in error
    assert (events.read_text(), mcap.read_text()) == ("an hour", "another hour")
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.parametrize(("name", "kind"), [("run.csv", "csv"), ("run.NPZ", "npz"), ("run.txt", "csv")])
def test_a_file_to_import_first_gets_the_command_that_does(model_path, tmp_path, rcbht, name, kind):
    (tmp_path / name).write_text("time,Fz\n0,1\n")
    error = rcbht.refused("stream", tmp_path / name, "-m", model_path)
    assert f"rcbht import {kind} {tmp_path / name} run.zarr" in error


def test_a_terminated_stream_keeps_its_recording(model_path, tmp_path, monkeypatch, rcbht):
    out, write, written = tmp_path / "o.mcap", McapWriter.wrench, []

    def terminates(mcap: McapWriter, time: float, values: tuple[float, ...]) -> None:
        write(mcap, time, values)
        written.append(time)
        if len(written) == 50:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(McapWriter, "wrench", terminates)
    rcbht.feed(trial(1, 30, 100))
    assert "what a stream had recorded is kept" in rcbht.ended(143, "stream", "-", "-m", model_path, "--mcap", out).err
    assert [sample.time for sample in read_bag(out, "/wrench")] == pytest.approx([0.005 * k for k in range(50)])


def test_a_reader_of_standard_input_does_not_crash_the_end():
    """Python's own buffer cannot be closed at exit while a thread waits in it."""
    script = (
        "import sys; from rcbht_jax.cli.source import _standard_input; from rcbht_jax.io.messages import read_live\n"
        "print(next(read_live(_standard_input(), 5))); sys.exit(3)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdin is not None
    process.stdin.write(b'{"begin": true}\n')
    process.stdin.flush()
    assert process.wait(60) == 3
    process.communicate()


def test_serve_shows_a_source_to_its_end(model_path, monkeypatch, rcbht):
    rcbht.feed(trial(2, 32, 300))
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
    rcbht("serve", "-", "-m", model_path, "--port", "0", "--no-stay", "--speed", "0")
    looking[0].join(30)
    assert b"event: end" in frames[0]
    last = json.loads([line for line in frames[0].splitlines() if line.startswith(b"data: {")][-1][6:])
    assert last["sample"] == 300


def test_words_without_a_model(tmp_path, rcbht):
    """Any number of axes; thresholds of a preset, of a file, and of the stream itself."""
    wrench = np.random.default_rng(0).normal(size=(400, 2)) * 0.5
    wrench[200:] += 40
    write_thresholds(tmp_path / "t.json", rj.GradientThresholds(np.full((2, 4), 1e6)), {}, ("grip", "Mz"))
    found = {}
    for name, options in (
        ("preset", ["--robot", "pa10"]),
        ("file", ["--thresholds", str(tmp_path / "t.json")]),
        ("auto", ["--lead", "1.5"]),
    ):
        rcbht.feed(wrench)
        found[name] = rcbht.events("stream", "-", "--axes", "grip", "Mz", *options)
        assert {event["event"] for event in found[name]} == {"Word"}
        assert {(event["layer"], event["axis"]) for event in found[name]} >= {("llb", "grip"), ("llb", "Mz")}
        assert max(event["stop"] for event in found[name]) == pytest.approx(2.0)
    counts = {name: sum(event["layer"] == "primitive" for event in found[name]) for name in found}
    assert counts["file"] == 2  # nothing is steeper than that
    assert counts["file"] <= counts["auto"] < counts["preset"] / 2


def test_a_file_of_thresholds_names_the_axes_of_a_stream_that_does_not(tmp_path, rcbht):
    wrench = np.repeat([0.0, 5.0], [80, 120])[:, None] * [1.0, 2.0]
    write_thresholds(tmp_path / "t.json", rj.GradientThresholds(np.full((2, 4), 1e6)), {}, ("force", "torque"))
    rcbht.feed(wrench)
    events = rcbht.events("stream", "-", "--thresholds", str(tmp_path / "t.json"))
    assert {event["axis"] for event in events} == {"force", "torque"}
    rcbht.feed(wrench[:, :1])
    error = rcbht.refused("stream", "-", "--thresholds", tmp_path / "t.json")
    assert "thresholds for force, torque, and the stream has 1 axis; name it with --axes." in error


def test_provisional_words_are_events_of_their_own(rcbht):
    rcbht.feed(np.repeat([0.0, 5.0], [80, 120])[:, None])
    events = rcbht.events("stream", "-", "--axes", "grip", "--robot", "hiro", "--provisional")
    first = next(event for event in events if event["event"] == "ProvisionalWord")
    assert (first["axis"], first["begin"], first["sample"], first["revision"]) == ("grip", 0, 10, 0)
    assert any(event["event"] == "Word" for event in events)


def test_words_of_a_store_are_those_that_encode_writes(tmp_path, rcbht):
    store = tmp_path / "s.zarr"
    recordings = rj.Recordings.from_arrays([trial(1, 3, 300), trial(2, 4, 250)], rate=200)
    rj.write_recordings(store, recordings, {"importer": "csv"})  # not HIRO's: thresholds from the recordings
    rcbht("encode", store, "--name", "w")
    tracks, _ = read_tracks(store, "w")
    events = rcbht.events("stream", str(store))
    for layer in LAYERS:
        assert sum(e.get("layer") == layer for e in events) == np.count_nonzero(getattr(tracks, layer).label)


def test_words_by_the_fit_rule(tmp_path, rcbht):
    """Of a store, those that encode writes; of a live stream, with tolerances of its beginning or stated ones."""
    store = tmp_path / "s.zarr"
    rj.write_recordings(store, rj.Recordings.from_arrays([trial(1, 3, 300), trial(2, 4, 250)], rate=200), {})
    rcbht("encode", store, "--name", "w", "--rule", "fit")
    tracks, _ = read_tracks(store, "w")
    events = rcbht.events("stream", str(store), "--rule", "fit")
    for layer in LAYERS:
        assert sum(e.get("layer") == layer for e in events) == np.count_nonzero(getattr(tracks, layer).label)
    counts = []
    for options in ([], ["--tolerance", "1e-3"], ["--tolerance", "9", "--robot", "hiro"]):
        rcbht.feed(trial(2, 4, 250))
        words = rcbht.events("stream", "-", "--rule", "fit", "--lead", "0.6", *options)
        counts.append(sum(word["layer"] == "primitive" for word in words))
    assert counts[1] > counts[0] > counts[2] == 6


def test_a_model_remembers_the_rule(tmp_path, rcbht):
    store, out = tmp_path / "s.zarr", tmp_path / "m"
    rj.write_recordings(store, rj.Recordings.example(), {})
    learn = ["train-online", str(store), "--task", "outcome", "-o", str(out), "--rule", "fit", "--window", "4"]
    assert "words by the fit rule" in rcbht(*learn, "--weighing", "time", "change")
    model, recordings = model_files.load(out), read_recordings(store)
    assert model.encoder == FitConfig(4, 0.005)
    np.testing.assert_array_equal(model.limits.tolerance, auto_tolerance(recordings.wrench, recordings.length, 5))
    name = str(recordings.trial[0])
    words = [e for e in rcbht.events("stream", str(store), "--trial", name, "-m", str(out), "--words")
             if e["event"] == "Word"]  # fmt: skip
    plain = rcbht.events("stream", str(store), "--trial", name, "--rule", "fit", "--window", "4")
    assert words == [e for e in plain if e["event"] == "Word"]


def test_an_outcome_from_the_same_seconds_of_every_record(tmp_path, rcbht):
    store, out = tmp_path / "s.zarr", tmp_path / "m"
    rj.write_recordings(store, rj.Recordings.example(), {})
    learn = ["train-online", store, "--task", "outcome", "-o", out, "--families", "edges", "offset", "--ranks"]
    rcbht(*learn, "--first-seconds", "1")
    head = model_files.load(out).heads[0]
    assert head.view.spec.families == ("edges", "offset")
    assert head.machine.svm.spec.ranks
    assert head.progress is not None
    assert head.progress.planned == 1.0
    for seconds, part in (("2", "8 trials (shorter than 2 s)"), ("-1", "expected a sample or more")):
        assert part in rcbht.refused(*learn, "--first-seconds", seconds)


def test_options_that_contradict_each_other(model_path, rcbht):
    for words, part in (
        (["-m", str(model_path), "--robot", "hiro"], "--robot has no effect with --model"),
        (["-m", str(model_path), "--window", "7"], "--window has no effect with --model"),
        (["-m", str(model_path), "--rule", "fit"], "--rule has no effect with --model"),
        (["-m", str(model_path), "--tolerance", "1"], "--tolerance has no effect with --model"),
        (["--tolerance", "1"], "--tolerance is for --rule fit"),
        (["--rule", "fit", "--tolerance", "1", "2", "--robot", "hiro"], "expected one, or 6"),
        (["--starts", "detected"], "Only a model detects"),
        (["--sampling-rate", "0"], "--sampling-rate is 0"),
        (["--sampling-rate", "1e300"], "--sampling-rate is 1e+300; expected 0.001 to"),
        (["--lead", "-1"], "--lead is -1"),
        (["-m", str(model_path), "--certainty", "0.5"], "--certainty is 0.5; expected 0.55 to less than 1."),
        (["--robot", "hiro", "--axes", "a"], "names 1 axis; the stream has 6"),
        (["--robot", "hiro", "--axes", *"abadef"], "2 axes are called a"),
        (
            ["--robot", "hiro", "--snap", "Fz=-3"],
            "least is [-3.], most [inf] and load [0.] to [inf]; expected 0 < least",
        ),
    ):
        rcbht.feed(trial(0, 1, 60))
        assert part in rcbht.refused("stream", "-", *words)
    rcbht.feed(b'{"wrench": [1, 2]}\n' * 60)
    assert "--sampling-rate" in rcbht.refused("stream", "-", "--robot", "hiro")


@pytest.mark.parametrize(
    ("source", "option", "what"),
    [
        ("-", "--false-alarms 7", "--monitor"),
        ("-", "--certainty 9", "--model or --segmenter"),
        ("-", "--rate -4", "--model"),
        ("-", "--trial t01", "a store"),
        ("-", "--arm L", "a store or the folder of a trial"),
        ("-", "--starts phase", "a store or the folder of a trial"),
        ("s.zarr", "--lead 5", "lines, a bag or the folder of a trial"),
        ("-", "--topic /wrench", "a bag or MCAP file"),
        ("s.zarr", "--topic /wrench", "a bag or MCAP file"),
        ("s.zarr", "--timeout -1", "lines on standard input"),
    ],
)
@pytest.mark.parametrize("command", ["stream", "serve"])
def test_options_without_effect_are_refused(tmp_path, rcbht, monkeypatch, command, source, option, what):
    """They were accepted with any value, and nobody learned that no alarm, no topic and no trial was chosen."""
    monkeypatch.chdir(tmp_path)
    rj.write_recordings(tmp_path / "s.zarr", rj.Recordings.from_arrays([trial(1, 3)], rate=200), {})
    port = ["--port", "0", "--no-stay", "--speed", "0"] if command == "serve" else []
    rcbht.feed(trial(0, 1, 60))
    error = rcbht.refused(command, source, "--robot", "hiro", *option.split(), *port)
    assert f"{option.split()[0]} has no effect without {what}; leave it out." in error


@pytest.mark.parametrize("with_model", [False, True])
def test_serve_opens_the_page_before_the_first_reading(with_model, model_path, monkeypatch, rcbht):
    """Also where words of another rule than the model's are shown, which needs the beginning of the stream."""
    axes, words = (6, ["-m", str(model_path)]) if with_model else (1, [])
    rcbht.feed(trial(2, 32, 300)[:, :axes])
    announced: list[tuple[str, object]] = []
    announce = live_page.Broadcast.announce
    monkeypatch.setattr(
        live_page.Broadcast, "announce", lambda b, k, v: (announced.append((k, v)), announce(b, k, v))[1]
    )
    rcbht("serve", "-", *words, "--port", "0", "--no-stay", "--speed", "0", "--lead", "1")
    assert [value for kind, value in announced if kind == "status"] == [
        "waiting for the first readings", "taking the thresholds and tolerances from the first 1 s",
        "compiling the encoder, a few seconds", "",
    ]  # fmt: skip
    [about] = [value for kind, value in announced if kind == "about"]
    assert len(about["axes"]) == axes


def test_a_folder_of_hiro_has_its_preset(hiro_dir, rcbht):
    folder = str(hiro_dir / "SIM_HIRO_ONE_SA_SUCCESS" / "20120426-1732-SideApproach-S")  # the shortest
    events = rcbht.events("stream", folder)
    assert events == rcbht.events("stream", folder, "--robot", "hiro")
    assert events != rcbht.events("stream", folder, "--robot", "auto")
    assert sum(event["event"] == "SubtaskStarted" for event in events) == 3


def test_a_bag_of_another_robot(external_dir, rcbht):
    bag = next(iter(sorted((external_dir / "bags").glob("*_05.bag"))))
    events = rcbht.events("stream", str(bag), "--topic", "/wrench/filtered/right")
    assert {event["layer"] for event in events if event["event"] == "Word"} == set(LAYERS)


def test_train_then_stream_a_recorded_trial(hiro_store, tmp_path, rcbht):
    path = tmp_path / "m"
    words = ["train-online", str(hiro_store), "--source", "SIM_HIRO_TWO_SA_SUCCESS", "-o", str(path), "--json"]
    head = json.loads(rcbht(*words))["heads"]["states"]
    assert head["classes"] == ["approach", "rotation", "insertion", "mating"]
    assert "differ in length" in head["confounds"]
    events = rcbht.events("stream", hiro_store, "-m", path, "--trial", *_first_trial(hiro_store))
    starts = [e["begin"] for e in events if e["event"] == "SubtaskStarted"]
    beliefs = [e for e in events if e["event"] == "Belief"]
    assert len(starts) == 3
    truth = np.searchsorted(starts, [e["sample"] for e in beliefs])
    right = [e["label"] == head["classes"][k] for e, k in zip(beliefs, truth, strict=True)]
    assert np.mean(right) > 0.9


def _first_trial(store: Path) -> list[str]:
    recordings = read_recordings(store)
    return [str(recordings.trial[recordings.source == "SIM_HIRO_TWO_SA_SUCCESS"][0])]
