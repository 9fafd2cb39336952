"""``rcbht classify``: a trained model says of new trials what its machine says, and refuses what does not fit."""

from __future__ import annotations

import csv
import inspect
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.cli.learning import Classify
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.learning.evaluation import candidates
from rcbht_jax.learning.model_io import load, save
from rcbht_jax.learning.predict import classify, task_of
from rcbht_jax.learning.svm import Grid
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals, unlabelled_intervals
from rcbht_jax.types import Recordings
from tests.cli.test_commands import synthetic
from tests.support.snaps import marked, with_columns

RICH = ("--features", "histogram", "parts", "levels", "--ranks", "--balance", "--kernels", "linear", "--costs", "1")
STATES = ["approach", "rotation", "insertion", "mating"]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sessions in one store, half of the trials of unknown outcome, and models of the states of session A."""
    folder = tmp_path_factory.mktemp("predict")
    store = folder / "set.zarr"
    outcome = np.where(np.arange(12) % 4 < 2, "success", "unknown")
    write_recordings(store, replace(synthetic(), outcome=outcome), {})
    assert main(["encode", str(store)]) == 0
    assert main(["encode", str(store), "--name", "mine"]) == 0
    assert main(["encode", str(store), "--window", "20", "--scale", "0.0625", "--name", "fine"]) == 0
    for name, tracks in (("one", "online-W5"), ("two", "online-W5+fine")):
        words = ["train", str(store), "--session", "A", "--tracks", tracks, *RICH, "-o", str(folder / f"{name}.model")]
        assert main(words) == 0
    return folder


def run(capsys: pytest.CaptureFixture[str], *words: object) -> dict:
    capsys.readouterr()
    assert main(["classify", *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_path_of_a_model_is_no_model() -> None:
    unchecked = inspect.unwrap(classify)  # the annotations of the tests' run refuse it first
    with pytest.raises(InputError, match=r"The model is 'one\.model', str; expected TrainedModel"):
        unchecked("one.model", Recordings.example(), {}, TaskSpec("outcome"))


@pytest.mark.parametrize("name", ["one", "two"])
def test_it_says_what_the_machine_says(
    name: str, place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "classes.csv"
    result = run(capsys, place / "set.zarr", "--session", "B", "--model", place / f"{name}.model", "-o", out)
    model, recordings = load(place / f"{name}.model"), read_recordings(place / "set.zarr")
    items = labelled_intervals(recordings, TaskSpec(sessions=("B",), outcomes=()))
    grammar = {track: read_tracks(place / "set.zarr", track)[0] for track in model.svm.spec.features.split("+")}
    features = FeatureSpec(families=("histogram", "parts", "levels"), balance=True)
    ((made, _),) = candidates({"": grammar}, items, features).values()
    with out.open(newline="") as stream:
        table = list(csv.DictReader(stream))
    assert list(table[0])[:6] == ["source", "trial", "arm", "session", "start", "end"]
    assert "sentence: source, trial, arm, session, start and end in" in " ".join((Classify.__doc__ or "").split())
    assert [row["class"] for row in table] == model.svm.predict(made.values).tolist()
    assert [row["truth"] for row in table] == [items.classes[k] for k in items.y]
    assert [row["trial"] for row in table] == items.trial.tolist()
    assert [float(row["end"]) - float(row["start"]) for row in table] == pytest.approx(items.seconds[:, 0].tolist())
    decision = np.array([[float(row[pair]) for pair in ("approach/rotation", "insertion/mating")] for row in table])
    np.testing.assert_array_equal(decision, model.svm.decision(made.values)[:, [0, 5]])
    assert result["accuracy"] == np.mean([row["class"] == row["truth"] for row in table]) > 0.8
    assert result["sentences"] == result["known"] == len(table) == 24
    assert result["trained_on"] == 0


def test_sentences_of_a_class_that_the_model_has_not_learned_are_counted_apart(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All of them are wrong, and the accuracy was printed as if there were none."""
    words, model = ("classify", str(place / "set.zarr"), "--out", str(tmp_path / "c.csv")), tmp_path / "three.model"
    learned = load(place / "one.model")
    others = replace(learned, svm=replace(learned.svm, classes=("approach", "rotation", "insertion", "other")))
    save(model, others)
    result = run(capsys, *words[1:], "--model", model)
    assert result["not_learned"] == {"mating": 12}
    assert result["known"] + result["trained_on"] == result["sentences"] - 12
    assert main([*words, "--model", str(model)]) == 0
    assert "not counted: 12 sentences of 'mating', which the model has not learned" in capsys.readouterr().out
    assert run(capsys, *words[1:], "--model", place / "one.model")["not_learned"] == {}


def test_trials_trained_on_are_told_apart(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = (place / "set.zarr", "--model", place / "one.model", "-o", tmp_path / "classes.jsonl")
    result = run(capsys, *words)
    lines = [json.loads(line) for line in (tmp_path / "classes.jsonl").read_text().splitlines()]
    taught = {"trial-00", "trial-04", "trial-08"}  # of session A the successes; nobody judged the others
    right = [[line["class"] == line["truth"] for line in lines if (line["trial"] in taught) == seen] for seen in (0, 1)]
    assert result["trained_on"] == len(right[1]) == 12
    assert result["accuracy_of_those"] == np.mean(right[1])
    assert result["accuracy"] == np.mean(right[0])
    assert list(lines[0]["decision"])[:2] == ["approach/rotation", "approach/insertion"]
    assert main(["classify", *map(str, words)]) == 0
    assert "does not apply to new trials" in capsys.readouterr().out


def test_what_taught_is_known_again_in_another_data_set() -> None:
    """A trial that taught is no new one because others are beside it, and one that was left out is."""
    recordings = replace(synthetic(), outcome=np.array(["success", "success", "failure"] * 4))
    tracks, grid = rj.encode(recordings.wrench, rate=200), Grid(("linear",), (1.0,), inner=2)
    model = rj.train(recordings, tracks, TaskSpec(), FeatureSpec(("histogram",)), grid)  # of the successes
    spec = replace(task_of(model), outcomes=("success", "failure"))
    found = classify(model, recordings, {"": tracks}, spec)
    np.testing.assert_array_equal(found.seen, recordings.outcome[found.items.row] == "success")
    rows = np.array([5, 3, 2])
    some = recordings.take(rows)
    found = classify(model, some, {"": rj.encode(some.wrench, rate=200)}, spec)
    np.testing.assert_array_equal(found.seen, some.outcome[found.items.row] == "success")
    old = classify(replace(model, digests=model.digests[:0]), recordings, {"": tracks}, spec)
    assert old.seen.all()  # older models know the data set only


def test_other_names_of_the_same_labels(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = (place / "set.zarr", "--model", place / "one.model")
    plain = run(capsys, *words, "-o", tmp_path / "a.csv")
    named = run(capsys, *words, "--tracks", "mine", "-o", tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert plain | {"out": ""} == named | {"out": ""}


def test_spans_are_the_sentences_where_all_is_known() -> None:
    recordings = synthetic()
    items, found = labelled_intervals(recordings, TaskSpec()), unlabelled_intervals(recordings, TaskSpec())
    assert found.name.tolist() == [items.classes[k] for k in items.y]
    np.testing.assert_array_equal(found.intervals[0].start, items.intervals[0].start)
    np.testing.assert_array_equal(recordings.trial[found.row], items.trial)


def test_whole_trials_need_no_class() -> None:
    outcome = np.array(["success", "failure", "unknown"] * 4)
    kind = np.array(["", "+x", ""] * 4)
    note = np.where(np.arange(12) == 1, "contradictory-duplicate", "")
    recordings = replace(with_columns(synthetic(), failure_type=kind), outcome=outcome, note=note)
    found = unlabelled_intervals(recordings, TaskSpec("outcome"))
    assert found.name.tolist() == ["success", "failure", ""] * 4
    assert (found.intervals[0].end == recordings.length).all()
    found = unlabelled_intervals(recordings, TaskSpec("failure-type"))
    assert found.row.tolist() == [1, 2, 4, 5, 7, 8, 10, 11]  # failures, and what nobody judged
    assert found.name.tolist() == ["", "", "+x", "", "+x", "", "+x", ""]


def test_new_data_need_not_have_the_column_of_the_task() -> None:
    """Nobody knows the classes of new data; a task that is a track is asked for as before."""
    recorded = replace(synthetic(), outcome=np.array(["success", "failure"] * 6))
    parts = with_columns(recorded, part=np.array(["peg", "hole"] * 6))
    tracks = rj.encode(parts.wrench, rate=200)
    grid = Grid(("linear",), (1.0,), inner=2)
    named = TaskSpec("part", outcomes=("success", "failure"))
    model = rj.train(parts, tracks, named, FeatureSpec(("histogram",)), grid)
    unnamed = replace(recorded, outcome=np.full(12, "unknown"))
    found = classify(model, unnamed, {"": tracks}, task_of(model))
    assert found.items.name.tolist() == [""] * 12
    assert found.predicted.tolist() == classify(model, parts, {"": tracks}, task_of(model)).predicted.tolist()
    for task in (model.task | {"whole": False}, {k: v for k, v in model.task.items() if k != "whole"}):
        with pytest.raises(InputError, match="no track or column of text 'part'"):
            classify(replace(model, task=task), unnamed, {"": tracks}, task_of(model))


def test_a_model_of_both_arms_asks_for_both() -> None:
    """A new model would not help."""
    arms = {"trial": np.arange(12) // 2, "arm": ["R", "L"] * 6, "outcome": np.repeat(["success", "failure"], 6)}
    recordings = Recordings.from_arrays(np.zeros((12, 400, 6)), **arms)
    tracks, right = rj.encode(recordings.wrench, rate=200), recordings.arm == "R"
    one = Grid(("linear",), (1.0,), (True,))
    model = rj.train(recordings, tracks, TaskSpec("outcome", arms="both"), FeatureSpec(("histogram",)), one)
    with pytest.raises(InputError, match="reads 600 others; it learned other arms than the right arm"):
        classify(model, recordings.take(right), {"": tracks.take(right)}, task_of(model))


def test_trials_of_another_outcome_are_counted() -> None:
    recordings = replace(synthetic(), outcome=np.array(["success", "failure", "unknown"] * 4))
    assert unlabelled_intervals(recordings, TaskSpec()).dropped == {"outcome not success or unknown": 4}
    named = unlabelled_intervals(recordings, TaskSpec(outcomes=("failure",)))
    assert named.dropped == {"outcome not failure": 4, "outcome unknown": 4}
    assert unlabelled_intervals(recordings, TaskSpec(outcomes=())).dropped == {}


def test_outcomes_to_learn_from_can_be_named(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["train", str(place / "set.zarr"), "--tracks", "online-W5", *RICH, "-o", str(tmp_path / "m.model")]
    assert main(words) == 0
    assert "left out: 6 trials, outcome unknown" in capsys.readouterr().out
    assert main([*words, "--outcome", "success", "unknown", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["trials"], said["dropped"]) == (12, {})


def test_without_any_sentence(place: Path) -> None:
    missing = np.full((12, 4), np.nan)
    unmarked = marked(synthetic(), missing, missing)
    model = load(place / "one.model")
    with pytest.raises(InputError, match="12 trials: no annotation of the track states"):
        classify(model, unmarked, {}, task_of(model))


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("set.zarr", "--model", "none.model"), "rcbht train STORE.zarr"),
        (("none.zarr", "--model", "one.model"), "none.zarr"),
        (("set.zarr", "--model", "one.model", "-o", "classes.txt"), ".csv or .jsonl"),
        (("set.zarr", "--model", "one.model", "--tracks", "none"), "no label tracks none"),
        (("set.zarr", "--model", "one.model", "--tracks", "fine"), "window 5, here 20"),
        (("set.zarr", "--model", "two.model", "--tracks", "fine"), "2 label tracks"),
        (("set.zarr", "--model", "one.model", "--session", "C"), "no recording has the session C"),
        (("set.zarr", "--model", "one.model", "--outcome", "failure"), "no recording has the outcome failure"),
        (("set.zarr", "--model", "old.model"), "train it anew"),
        (("set.zarr", "--model", "other.model"), "outcomes"),
        (("bare.zarr", "--model", "one.model"), "rcbht encode"),
    ],
)
def test_what_does_not_fit_is_one_sentence(
    words: tuple[str, ...], why: str, place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = load(place / "one.model")
    save(tmp_path / "old.model", replace(model, feature_names=model.feature_names[::-1]))
    save(tmp_path / "other.model", replace(model, task={"task": "states"}))
    write_recordings(tmp_path / "bare.zarr", synthetic(), {})
    paths = {name: str(folder / name) for folder in (place, tmp_path) for name in words if (folder / name).exists()}
    inside = [paths.get(word, str(tmp_path / word) if "." in word else word) for word in words]
    capsys.readouterr()
    assert main(["classify", *inside, *(() if "-o" in words else ("-o", str(tmp_path / "classes.csv")))]) == 2
    said = capsys.readouterr().err.strip()
    assert why in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "classes.csv").exists()


RATE = ({"dt": 0.0025}, "has 400 samples per second, the model 200; import again with --rate 200.")
OTHERS = [  # recordings, and what is said of them
    ({"units": ("N",) * 3 + ("Nmm",) * 3}, "has Mx in Nmm; the model learned it in Nm."),
    ({"axes": tuple("abcdef"), "units": ("A",) * 6}, "has the axes a, b, c, d, e, f; the model learned Fx, Fy, Fz,"),
    ({"axes": ("Mz", "My", "Mx", "Fz", "Fy", "Fx")}, "has the axes Mz, My, Mx, Fz, Fy, Fx; the model learned Fx, Fy,"),
]


@pytest.mark.parametrize(("changes", "why"), [RATE, *OTHERS])
def test_another_rate_other_axes_and_units_are_refused(
    changes: dict[str, Any], why: str, place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Moments in Nmm were classified by a model of moments in Nm; of another rate, "encode" was advised in vain."""
    store, model = tmp_path / "other.zarr", place / "one.model"
    other = replace(synthetic(), **changes)
    write_recordings(store, other, {})
    assert main(["encode", str(store), "--robot", "auto"]) == 0
    out = tmp_path / "classes.csv"
    for words in (
        ["classify", str(store), "-m", str(model), "-o", str(out)],
        ["encode", str(store), "--thresholds", str(model)],
    ):
        capsys.readouterr()
        assert main(words) == 2
        assert f"rcbht: {store} {why}" in capsys.readouterr().err
    assert not out.exists()
    trained = load(model)
    with pytest.raises(InputError, match=f"The data set {why}"):
        classify(trained, other, {}, task_of(trained))


def test_an_older_model_is_read_with_one_warning(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, old = load(place / "one.model"), tmp_path / "old.model"
    assert (model.axes, model.units) == (synthetic().axes, synthetic().units)
    save(old, replace(model, axes=(), units=()))
    with pytest.warns(UserWarning, match=r"old\.model, of an older version, does not state its axes") as said:
        result = run(capsys, place / "set.zarr", "--model", old, "-o", tmp_path / "classes.csv")
    assert len(said) == 1
    assert result == run(capsys, place / "set.zarr", "-m", place / "one.model", "-o", tmp_path / "classes.csv")


def test_two_recordings_of_one_name_are_refused() -> None:
    """The second one would take the place of the first."""
    days = [Recordings.from_arrays(np.zeros((2, 300, 6)), outcome=["success", "failure"], session=s) for s in "AB"]
    with pytest.raises(InputError, match="a name must be unique"):
        labelled_intervals(Recordings.join(days), TaskSpec("outcome"))


def test_a_model_of_first_seconds_sees_no_more_of_others(place: Path) -> None:
    model = load(place / "one.model")
    assert task_of(model).seconds == 0.0
    assert task_of(replace(model, task=model.task | {"seconds": 0.5})).seconds == 0.5


def test_a_model_of_version_0_1_names_no_arm(place: Path) -> None:
    """Its task names R, whatever the arm of the recordings is called."""
    model = load(place / "one.model")
    named = replace(model, task=model.task | {"arms": "R"})
    assert (task_of(named).arms, task_of(replace(named, axes=(), units=())).arms) == ("R", "")
