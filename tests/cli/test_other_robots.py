"""Another robot from recordings to words, pictures, model, stream and report, by commands alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.cli.main import main
from rcbht_jax.encoding.thresholds import write_thresholds
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.types import Recordings
from tests.support.command_line import CommandLine

RATE = 50.0


def grasps() -> Recordings:
    """Two axes at 50 Hz in three phases; every second grasp slips, which the grip force shows."""
    rng, count = np.random.default_rng(0), 12
    wrenches, rows, tools = [], [], []
    for number in range(count):
        lengths = rng.integers(60, 90, 3)
        edges = np.cumsum([0, *lengths])
        wrench = rng.normal(size=(edges[-1], 2)) * [0.02, 0.002]
        wrench[edges[1] : edges[2]] += np.linspace(0, 1, lengths[1])[:, None] * [10, 1]
        wrench[edges[2] :] += np.array([10, 1]) + np.sin(np.arange(lengths[2]) * (number % 2))[:, None] * [1, 0.1]
        wrenches.append(wrench)
        tools.append(("wide", "narrow")[number % 2])
        names = ("reach", "grasp", "hold")
        marks = zip(names, edges[:-1] / RATE, edges[1:] / RATE, strict=True)
        rows += [(number, "phase", name, float(start), float(end)) for name, start, end in marks]
    rows = [row for row in rows if row[:3] != (0, "phase", "hold")]  # a mark that nobody made
    return Recordings.from_arrays(
        wrenches, RATE, axes=("grip", "twist"), units=("N", "Nm"), arm="left", annotations=rows, tool=tools,
        outcome=["success"] * count, session=[f"day {number % 3}" for number in range(count)],
    )  # fmt: skip


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robot") / "grasps.zarr"
    write_recordings(path, grasps(), {"importer": "csv"})
    assert main(["encode", str(path)]) == 0
    return path


def test_a_wrench_of_an_unknown_robot_is_not_taken_for_hiros(tmp_path: Path, rcbht: CommandLine) -> None:
    wrench = np.random.default_rng(0).normal(size=(2, 400, 6))
    wrench[:, 200:] += 5
    mine = Recordings.from_arrays(wrench * 1000, 200, units=("mN",) * 3 + ("mNm",) * 3)
    for attrs, method in (({"robot": "mine"}, "auto"), ({"simulated": {}}, "preset"), ({"importer": "hiro"}, "preset")):
        write_recordings(tmp_path / "s.zarr", mine, attrs, overwrite=True)
        assert rcbht.json("encode", tmp_path / "s.zarr")["thresholds_from"]["method"] == method


def test_info_lists_what_the_store_can_answer(store: Path, rcbht: CommandLine) -> None:
    info = rcbht.json("info", store)
    assert info["axes"] == {"grip": "N", "twist": "Nm"}
    assert info["annotations"]["phase"] == {"reach": [12, 12], "grasp": [12, 12], "hold": [11, 11]}
    assert info["tasks"]["phase"]["classes"] == {"reach": 12, "grasp": 12, "hold": 11}
    assert info["tasks"]["tool"]["classes"] == {"narrow": 6, "wide": 6}
    assert info["tasks"]["outcome"]["classes"] == {}  # a single class is no task


def test_thresholds_come_from_the_recordings(store: Path, tmp_path: Path, rcbht: CommandLine) -> None:
    _, how = read_tracks(store, "online-W5")
    assert how["thresholds_from"] == {"method": "auto"}
    made = rcbht.json("calibrate", store, "-o", tmp_path / "rest.json", "--method", "rest")
    assert made["axes"] == ["grip", "twist"]
    assert made["limits"] == how["thresholds"]
    again = rcbht.json("encode", store, "--thresholds", tmp_path / "rest.json", "--name", "from-file")
    assert again["rest_not_constant"]["grip"] < 0.2
    printed = rcbht("encode", store, "--robot", "hiro", "--scale", "0.001", "--name", "too-low")
    assert "the thresholds do not fit these recordings; try --robot auto." in printed
    printed = rcbht("encode", store, "--scale", "0.001", "--name", "too-low-by-auto")
    assert "the thresholds do not fit these recordings." in printed


def test_limits_of_windows_at_rest_are_for_the_papers_rule(store: Path, tmp_path: Path, rcbht: CommandLine) -> None:
    """Noise tilts windows more than runs: by the fit rule they hid pushes, without a word."""
    file, fit = tmp_path / "rest.json", ("--rule", "fit")
    limits = rcbht.json("calibrate", store, "-o", file, "--method", "rest")["limits"]
    for command in ("encode", "stream"):
        error = rcbht.refused(command, store, *fit, "--thresholds", file)
        assert "are for --rule paper; choose that, or make the file with --rule fit." in error
    by_hand = rj.GradientThresholds(np.array(limits))
    write_thresholds(file, by_hand, {"method": "search"}, ("grip", "twist"))  # other limits may be for either rule
    write_recordings(tmp_path / "own.zarr", grasps(), {})  # the pictures of other tests show words of the fit rule
    assert rcbht.json("encode", tmp_path / "own.zarr", *fit, "--thresholds", file)["thresholds"] == limits


def test_thresholds_mean_the_same_in_other_units(store: Path, tmp_path: Path, rcbht: CommandLine) -> None:
    """A file of a store in Nmm was applied to one in Nm as it is, and all words of the moments were lost."""
    one, file, small = grasps(), tmp_path / "rest.json", tmp_path / "small.zarr"
    write_recordings(small, replace(one, wrench=one.wrench * np.float32([1, 1000]), units=("N", "Nmm")), {})
    made = rcbht.json("calibrate", small, "-o", file, "--method", "rest")
    found = rcbht.json("encode", store, "--thresholds", file, "--name", "converted")
    np.testing.assert_allclose(found["thresholds"], np.array([[1], [0.001]]) * made["limits"], rtol=1e-6)
    said = said_by(rcbht, small, "--axes", "Fz", "Mz", "--robot", "hiro")  # the store's units are known
    assert said == said_by(rcbht, store, "--axes", "Fz", "Mz", "--robot", "hiro")
    write_recordings(tmp_path / "other.zarr", replace(one, units=("N", "A")), {})
    error = rcbht.refused("encode", tmp_path / "other.zarr", "--thresholds", file)
    assert "has thresholds for twist in Nmm; it is in A here, and no factor is known." in error


@pytest.mark.parametrize("options", [[], ["--axes", "Fz", "My"]])
def test_lines_have_the_units_of_the_file_of_thresholds(options: list[str], tmp_path: Path, rcbht: CommandLine) -> None:
    """They were taken for N and Nm, so that a file for Nmm was converted: all its limits were a thousandth."""
    wrench = np.interp(np.arange(200), [0, 80, 120], [0.0, 0.0, 200.0])[:, None] * [0.001, 1.0]
    found = []
    for axis, unit in (("My", "Nmm"), ("twist", "")):
        limits = rj.GradientThresholds(np.array([[70.0, 46.0, 23.0, 1.0], [70e3, 46e3, 23e3, 2e3]]))
        write_thresholds(tmp_path / "t.json", limits, {}, ("Fz", axis), ("N", unit))
        rcbht.feed(wrench)
        chosen = [axis if word == "My" else word for word in options]
        events = said_by(rcbht, Path("-"), "--thresholds", str(tmp_path / "t.json"), *chosen)
        found.append([(label, begin) for name, label, begin in events if name == axis])
    assert found[0] == found[1]


def test_a_preset_is_converted_to_the_units_of_a_store(store: Path, tmp_path: Path, rcbht: CommandLine) -> None:
    write_recordings(tmp_path / "s.zarr", replace(grasps(), units=("kN", "Nmm")), {})
    found = rcbht.json("encode", tmp_path / "s.zarr", "--robot", "hiro")
    np.testing.assert_allclose(found["thresholds"], [[0.07, 0.046, 0.023, 0.001], [7000, 4600, 2300, 100]])
    write_recordings(tmp_path / "s.zarr", replace(grasps(), units=("N", "A")), {}, overwrite=True)
    error = rcbht.refused("encode", tmp_path / "s.zarr", "--robot", "hiro")
    assert "are for forces and moments, and twist is in A; choose thresholds from" in error


def said_by(rcbht: CommandLine, store: Path | str, *words: str) -> list[tuple[str, str, int]]:
    """Axis, label and first sample of each word of a stream."""
    events = rcbht.events("stream", store, *words)
    return [(event["axis"], event["label"], event["begin"]) for event in events if event["event"] == "Word"]


def test_the_rule_of_merging_changes_no_thresholds(store: Path, rcbht: CommandLine) -> None:
    """--rule similar was refused for every robot without a preset, with a list of rules that lacks it."""
    made = rcbht.json("encode", store, "--rule", "similar")
    assert made["thresholds"] == read_tracks(store, "online-W5")[1]["thresholds"]
    assert made["rest_not_constant"].keys() == {"grip", "twist"}


def test_encode_says_where_noise_hides_all_changes(tmp_path: Path, rcbht: CommandLine) -> None:
    rng, push = np.random.default_rng(0), np.interp(np.arange(4000) / 4000, [0.3, 0.6, 0.7], [0, 4, 0])
    noisy = np.stack([push, np.zeros(4000)], 1) + 0.02 * rng.normal(size=(4, 4000, 2))
    noisy[3, 3900:3950, 0] += np.linspace(0, 4, 50)  # so steep that it shows
    path = tmp_path / "fast.zarr"
    write_recordings(path, Recordings.from_arrays(noisy, 4000, axes=("torque", "rest"), units=("Nm", "")), {})
    assert rcbht.json("encode", path, "--rule", "fit")["changes_all_constant"] == []  # its lines are longer
    said = rcbht("encode", path)
    assert "In most recordings, everything on torque is labelled constant, although the values change: within" in said
    assert "(1.25 ms)" in said
    assert "try a longer one (--window 100, 25 ms), or the fit rule, whose lines are longer (--rule fit)." in said
    assert rcbht.json("encode", path, "--window", "100")["changes_all_constant"] == []


def test_phases_and_columns_are_classified(store: Path, tmp_path: Path, rcbht: CommandLine) -> None:
    options = ("--tracks", "online-W5", "--kernels", "linear", "--costs", "1")
    made = rcbht.json("evaluate", store, "--folds", 3, "--repeats", 1, *options)
    assert made["task"]["task"] == "phase"  # the only track, which nobody has to name
    assert made["score"]["accuracy"]["mean"] > 0.9
    assert made["items"] == {"reach": 12, "grasp": 12, "hold": 11}
    assert rcbht.json("train", store, "--task", "tool", "-o", tmp_path / "tool.model", *options)["classes"]
    files = ("--model", tmp_path / "tool.model", "-o", tmp_path / "tool.csv")
    done = rcbht.json("classify", store, *files, "--tracks", "online-W5")
    assert done["accuracy_of_those"] > 0.9
    error = rcbht.refused("evaluate", store, "--task", "states", "--tracks", "online-W5")
    assert "column of text 'states'; choose one of phase, outcome, tool (--task)." in error


def test_streams_pictures_reports_and_exports(store: Path, tmp_path: Path, rcbht: CommandLine) -> None:
    model = tmp_path / "phase.model"
    trained = rcbht.json("train-online", store, "-o", model)
    assert trained["heads"]["phase"]["classes"] == ["reach", "grasp", "hold"]
    recordings = read_recordings(store)
    name, out, log = str(recordings.trial[3]), tmp_path / "events.jsonl", tmp_path / "log.mcap"
    words = ("--model", str(model), "--trial", name, "-o", str(out), "--mcap", str(log))
    rcbht("stream", store, *words)
    events = [json.loads(line) for line in out.read_text().splitlines()]
    beliefs = [event for event in events if "probabilities" in event]
    last = {}
    marks = recordings.annotations.of_recording(3).of("phase")
    for belief in beliefs:
        at = np.flatnonzero(marks.start <= belief["time"])[-1]
        last[int(at)] = belief["label"]
    assert [last[place] for place in range(3)] == ["reach", "grasp", "hold"]
    assert log.stat().st_size > 1000
    track = ("--tracks", "online-W5")
    rcbht("plot", "trial", store, name, "-o", tmp_path / "trial.png", *track)
    rcbht("plot", "map", store, "--by", "state", "-o", tmp_path / "map.png", *track)
    printed = rcbht("plot", "map", store, "--by", "state", "-o", tmp_path / "map.png")
    assert "online-W5-fit of 12 recordings made now (--tracks shows those of the store: " in printed
    rcbht("plot", "beliefs", store, name, "--model", model, "-o", tmp_path / "b.png")
    page = tmp_path / "report.html"
    rcbht("report", store, "-o", page, "--model", model, *track)
    assert '"axes":["grip","twist"]' in page.read_text()
    for kind in ("csv", "parquet", "mcap", "lerobot"):
        rcbht("export", store, "-o", tmp_path / kind, "--format", kind, *track)
        card = (tmp_path / kind / "README.md").read_text()
        assert "grip (N), twist (Nm); times in s" in card
        assert "base frame" not in card
