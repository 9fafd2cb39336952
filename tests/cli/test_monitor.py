"""``rcbht monitor``: from a store to alarms, by commands alone."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.introspection.nominal_file import load
from rcbht_jax.introspection.segmenter import WrenchSegmenter
from rcbht_jax.introspection.segmenter_file import SegmenterFile
from rcbht_jax.introspection.segmenter_file import save as save_segmenter
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.types import Recordings
from tests.support.command_line import CommandLine, json_lines

ONSET = 1.5  # s


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """18 successes and 6 failures of three days at 20 Hz, and a recording of another skill."""
    rng = np.random.default_rng(0)
    wrenches, failed = [], np.arange(25) % 4 == 3
    for number in range(25):
        wrench = (number % 3) * 4.0 + np.clip(np.arange(50) - 10, 0, 20)[:, None] * [0.5, 0.1]
        wrench = wrench + 0.2 * rng.normal(size=wrench.shape)
        wrench[int(ONSET * 20) :] += 5.0 * failed[number]
        wrenches.append(wrench)
    recordings = Recordings.from_arrays(
        wrenches, 20.0, axes=("Fz", "grip"), outcome=np.where(failed, "failure", "success"),
        day=[f"day {number % 3}" for number in range(25)], skill=["5"] * 24 + ["7"],
        tool=[1.0] * 24 + [2.0], began=np.where(failed, f"{ONSET:e}", "1-2"), units=("N", ""),
    )  # fmt: skip
    path = tmp_path_factory.mktemp("monitor") / "runs.zarr"
    write_recordings(path, recordings, {})
    return path


@pytest.fixture(scope="module")
def model(store: Path) -> Path:
    path = store.parent / "five.monitor"
    assert main(["monitor", "fit", str(store), "--where", "skill=5", "--group", "day", "-o", str(path)]) == 0
    return path


def test_alarms_are_those_of_the_monitor(store: Path, model: Path, rcbht: CommandLine) -> None:
    events = rcbht.events("monitor", "watch", store, "-m", model, "--where", "skill=5", "--false-alarms", 0.1)
    ends = {event["trial"]: event for event in events if event["event"] == "End"}
    alarms = {event["trial"]: event for event in events if event["event"] == "Alarm"}
    assert len(ends) == 24
    assert {name for name, end in ends.items() if end["outcome"] == "failure"} <= set(alarms)
    recordings, monitor = read_recordings(store), load(model).monitor
    for row, trial in enumerate(recordings.trial.tolist()[:24]):
        moment = monitor.detect(recordings.wrench[row], 0.1)
        assert (alarms[trial]["time"] if trial in alarms else np.inf) == pytest.approx(moment)


def test_an_evaluation_prints_intervals_and_early_alarms(store: Path, rcbht: CommandLine) -> None:
    """An alarm before the onset is neither false nor a detection, and must not vanish."""
    recordings = read_recordings(store)
    late = np.where(recordings.outcome == "failure", "2.3", "")
    path = store.parent / "late.zarr"
    write_recordings(path, replace(recordings, columns={**recordings.columns, "began": late}), {})
    words = ["monitor", "evaluate", str(path), "--where", "skill=5", "--group", "day", "--false-alarms", "0.1"]
    said = rcbht(*words, "--onset", "began")
    assert "6 alarms of anomalous recordings came long before the onset: no detection." in said
    assert "of 18 nominal recordings; 95 % interval 0." in said
    assert "before the onset" not in rcbht(*words)


def test_a_column_of_texts_is_no_onset(store: Path, rcbht: CommandLine) -> None:
    """It was read as an onset that nobody knows, and no delay was printed."""
    error = rcbht.refused("monitor", "evaluate", store, "--where", "skill=5", "--group", "day", "--onset", "day")
    assert "--onset day: this column has no number; expected seconds." in error


def test_values_are_compared_of_axes_without_a_bias(store: Path, rcbht: CommandLine) -> None:
    recordings = read_recordings(store)
    wrench = recordings.wrench.copy()
    wrench[:, :, 1] -= 4.0 * (np.arange(len(wrench)) % 3)[:, None]  # of the grip, no day has a bias any more
    path = store.parent / "steady.zarr"
    write_recordings(path, replace(recordings, wrench=wrench), {})
    for levels, names in (((), ["grip"]), (("--levels", "none"), []), (("--levels", "Fz", "grip"), ["Fz", "grip"])):
        words = ["monitor", "fit", path, "--where", "skill=5", "--group", "day", *levels, "-o", store.parent / "levels"]
        found = rcbht.json(*words)
        assert (found["levels"], found["score_rate"]) == (names, 20.0)
        assert (
            f"it compares the changes of all axes and the values of {', '.join(names) or 'none'}, 20 times a second;"
            in rcbht(*words)
        )


def test_days_are_held_out(store: Path, rcbht: CommandLine) -> None:
    words = ["monitor", "evaluate", store, "--where", "skill=5", "--group", "day", "--onset", "began"]
    found = rcbht.json(*words, "--false-alarms", 0.1)
    assert (found["nominal"], found["anomalous"], set(found["groups"])) == (18, 6, {"day 0", "day 1", "day 2"})
    assert found["auroc"] == 1
    assert found["detected"] == 1
    assert 0 <= found["delay_median"] < 0.5
    table = rcbht(*words, "--false-alarms", "0.01").splitlines()
    assert table[1].split()[:6] == ["all", "18", "6", "1.000", "-", "-"]  # 12 recordings cannot promise 1 in 100
    assert (
        table[-1]
        == "No alarms of day 0, day 1, day 2: --false-alarms 0.01 takes 99 nominal recordings of the other groups."
    )


def test_groups_that_cannot_be_scored_are_named(store: Path, rcbht: CommandLine) -> None:
    recordings = read_recordings(store)
    day = np.array(["Mon", "Tue"])[np.arange(len(recordings)) % 2]
    day[:4] = "Wed"
    outcome = np.where(np.arange(len(recordings)) == 0, "success", recordings.outcome)
    outcome[1:4] = "failure"
    path = store.parent / "few.zarr"
    write_recordings(path, replace(recordings, columns={"day": day}, outcome=outcome), {})
    words = ["monitor", "evaluate", str(path), "--group", "day", "--false-alarms", "0.1"]
    found = rcbht.json(*words)
    assert found["not_scored"] == ["Mon", "Tue"]
    assert (found["nominal"], found["anomalous"]) == (1, 3)
    printed = rcbht(*words)
    assert "Not scored: Mon, Tue; the nominal recordings of the other groups are too few to learn from" in printed
    assert "No alarms of" not in printed


def test_trials_of_two_sources_are_different_groups(store: Path, rcbht: CommandLine) -> None:
    recordings = read_recordings(store).take(np.arange(16))
    path = store.parent / "sources.zarr"
    trial, source = [f"t{row % 8}" for row in range(16)], ["a"] * 8 + ["b"] * 8
    write_recordings(path, replace(recordings, trial=np.array(trial), source=np.array(source)), {})
    found = rcbht.json("monitor", "evaluate", path, "--group", "trial", "--false-alarms", 0.2)
    assert set(found["groups"]) == {f"{part}/{name}" for part, name in zip(source, trial, strict=True)}
    fitted = rcbht.json("monitor", "fit", path, "--group", "trial", "-o", store.parent / "sources")
    assert (fitted["recordings"], fitted["groups"]) == (12, 12)


def test_recordings_that_were_not_judged_are_no_anomalies(store: Path, rcbht: CommandLine) -> None:
    recordings = read_recordings(store)
    outcome = np.concatenate([["unknown", "unfinished"], recordings.outcome[2:]])
    path = store.parent / "unknown.zarr"
    write_recordings(path, replace(recordings, outcome=outcome), {})
    words = ["monitor", "evaluate", str(path), "--where", "skill=5", "--group", "day", "--false-alarms", "0.1"]
    found = rcbht.json(*words)
    assert (found["nominal"], found["anomalous"], found["unknown"]) == (16, 6, 2)
    assert "left out: 2 recordings, outcome unknown or unfinished" in rcbht(*words)


def test_another_unit_is_refused(store: Path, model: Path, rcbht: CommandLine) -> None:
    other = store.parent / "milli.zarr"
    write_recordings(other, replace(read_recordings(store), units=("mN", "m")), {})
    error = rcbht.refused("monitor", "watch", other, "-m", model, "--false-alarms", "0.1")
    assert f"{other} has Fz in mN; the model learned it in N." in error


def test_one_arm_is_monitored(store: Path, model: Path, rcbht: CommandLine) -> None:
    """An idle arm counted as a recording of the skill, so that twice as many were learned, and faults were missed."""
    right = read_recordings(store).take(np.arange(24))
    idle = replace(right, arm=np.full(24, "L"), wrench=right.wrench[::-1] * np.float32(0.01))
    two, left = store.parent / "two.zarr", store.parent / "left.monitor"
    write_recordings(two, Recordings.join([idle, right]), {})
    options = ("--group", "day", "--json")
    for command, counted in (("fit", ["-o", store.parent / "right.monitor"]), ("evaluate", ["--false-alarms", 0.1])):
        (alone,) = rcbht.events("monitor", command, store, "--where", "skill=5", *counted, *options)
        (found,) = rcbht.events("monitor", command, two, *counted, *options)
        assert found == alone | {"remarks": ["Only the right arm is used."]}
        (chosen,) = rcbht.events("monitor", command, two, "--where", "arm=R", *counted, *options)
        assert chosen == alone
    assert rcbht("monitor", "fit", two, "--arm", "L", "--group", "day", "-o", left).endswith(
        "\nOnly the left arm is used.\n"
    )
    assert "no arm 'X'" in rcbht.refused("monitor", "evaluate", two, "--arm", "X", "--group", "day")
    for watched, words, arm in ((model, (), "R"), (left, (), "L"), (left, ("--arm", "R"), "R")):
        events = rcbht.events("monitor", "watch", two, "-m", watched, "--false-alarms", 0.1, *words)
        assert [event["arm"] for event in events if event["event"] == "End"] == [arm] * 24


@pytest.mark.usefixtures("model")
def test_a_stream_plays_the_arm_that_was_learned(store: Path, rcbht: CommandLine) -> None:
    """The other arm was played to a monitor or a segmenter of the left one, and raised an alarm in every recording."""
    right = read_recordings(store).take(np.arange(24))
    left = replace(right, arm=np.full(24, "L"), wrench=-2 * right.wrench)
    two, monitor, segmenter = store.parent / "arms.zarr", store.parent / "l.monitor", store.parent / "l.segmenter"
    write_recordings(two, Recordings.join([left, right]), {})
    rcbht("monitor", "fit", two, "--where", "arm=L", "--group", "day", "-o", monitor)
    fitted = WrenchSegmenter(trees=3, words=False).fit(left.take(np.arange(3)), [np.arange(50) // 25] * 3)
    save_segmenter(segmenter, SegmenterFile.of(fitted, "phase", ("before", "after"), "L"))

    def said(*words: object) -> list[dict]:
        events = rcbht.events("stream", two, "--robot", "hiro", "--trial", right.trial[3], *words)
        return [event for event in events if event["event"] in ("AnomalyScore", "Belief")]

    for reader in (("--monitor", monitor, "--false-alarms", 0.1), ("--segmenter", segmenter)):
        own = said(*reader)
        assert own == said(*reader, "--arm", "L")
        assert own != said(*reader, "--arm", "R")
    unnamed = rcbht.events("monitor", "watch", store, "-m", monitor, "--where", "skill=5", "--false-alarms", 0.1)
    assert {event["arm"] for event in unnamed} == {"R"}, "the one arm of a store may be the one that was learned"
    both = ["--monitor", str(store.parent / "five.monitor"), "--segmenter", str(segmenter)]
    error = rcbht.refused("stream", two, "--false-alarms", "0.1", *both)
    assert "read different arms, R and L; use those of one arm, or name one with --arm" in error


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["fit", "--where", "skill"], "expected COLUMN=VALUE"),
        (["fit", "--where", "skill=9"], "no recording with skill=9"),
        (["fit", "--levels", "Mx"], "There is no axis Mx; there are Fz, grip"),
        (["fit", "--where", "skill=7"], "three or more"),
        (["fit", "--score-rate", "30"], "--score-rate is 30; the store has 20 samples per second"),
        (["fit", "--score-rate", "0"], "score_rate is 0"),
        (["fit", "--where", "tool=2"], "three or more"),  # a column of numbers
        (["fit", "--nominal", "good"], "outcome good, only failure, success; choose one with --nominal."),
    ],
)
def test_wrong_input_is_one_sentence(store: Path, words: list[str], sentence: str, rcbht: CommandLine) -> None:
    assert sentence in rcbht.refused("monitor", words[0], store, *words[1:], "-o", store.parent / "none")


def test_a_stream_is_watched_as_a_store_is(
    store: Path, model: Path, rcbht: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Words and scores of the same stream, from a store and from lines without names of the axes."""
    expected = rcbht.events("monitor", "watch", store, "-m", model, "--false-alarms", 0.1)
    alarms = {event["trial"]: event for event in expected if event["event"] == "Alarm"}
    options = ("--monitor", model, "--false-alarms", 0.1)
    trial, events = "", rcbht.events("stream", store, *options)
    raised: dict[str, float] = {}
    for event in events:
        trial = event["trial"] if event["event"] == "TrialStarted" else trial
        if event["event"] == "AnomalyRaised":
            raised.setdefault(trial, event["time"])
    assert {name: round(time + 0.05, 6) for name, time in raised.items()} == {
        name: alarm["time"] for name, alarm in alarms.items()
    }
    assert {"Word", "AnomalyScore"} <= {event["event"] for event in events}
    recordings = read_recordings(store)
    read = [{"time": 0.05 * k, "wrench": row.tolist()} for k, row in enumerate(recordings.wrench[3, :50].astype(float))]
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(json_lines(read))))
    live = rcbht.events("stream", "-", *options)
    name = str(recordings.trial[3])
    assert [event["time"] for event in live if event["event"] == "AnomalyRaised"] == [raised[name]]
    assert {event["axis"] for event in live if event["event"] == "Word"} == {"Fz", "grip"}


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--sampling-rate", "40"), "The monitor needs samples at 20 Hz; the stream has 40 Hz."),
        (("--axes", "Fz", "other"), "The monitor needs the axes Fz, grip; the stream has Fz, other."),
        (("--false-alarms", "0.001"), "cannot promise 0.001 false alarms"),
    ],
)
def test_a_stream_that_a_monitor_cannot_watch_is_refused(
    store: Path, model: Path, rcbht: CommandLine, options: tuple[str, ...], sentence: str
) -> None:
    assert sentence in rcbht.refused("stream", store, "--monitor", model, "--false-alarms", "0.1", *options)
