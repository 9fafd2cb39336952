"""Classes of one or two trials: what cannot be cross-validated is left out and counted, and nothing else is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.cli.main import main
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.introspection.training import HeadSpec, train_head
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.learning.class_groups import learnable
from rcbht_jax.learning.evaluation import EvaluationProtocol, evaluate
from rcbht_jax.learning.fitting import train
from rcbht_jax.learning.svm import Grid, select
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.types import LabelTracks, Recordings
from tests.support.snaps import with_columns

SPEC = FeatureSpec(("histogram",))
GRID = Grid(("linear",), (0.1, 1.0))
ASKED = ("--task", "phase", "--kernels", "linear", "--costs", "1")
PARTS = ["peg"] * 6 + ["clip"] * 6 + ["plug"] * 2 + ["ring"]


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    """Pushes whose axis tells the part."""
    wrench = np.random.default_rng(0).normal(size=(len(PARTS), 200, 6)) * 0.01
    for row, part in enumerate(PARTS):
        wrench[row, 80:120, ("peg", "clip", "plug", "ring").index(part)] += np.linspace(0, 20, 40)
    days = ["monday", "tuesday"] * 6 + ["monday"] * 3
    return Recordings.from_arrays(wrench, 200, part=PARTS, session=days)


@pytest.fixture(scope="module")
def tracks(recordings: Recordings) -> LabelTracks:
    return rj.encode(recordings.wrench, rate=200)


def test_a_class_of_one_trial_is_left_out_of_an_evaluation(recordings: Recordings, tracks: LabelTracks) -> None:
    result = evaluate(recordings, tracks, TaskSpec("part"), SPEC, EvaluationProtocol(repeats=1, grid=GRID))
    assert result.items == {"clip": 6, "peg": 6, "plug": 2}
    assert result.dropped == {"class in one trial only: ring": 1}
    assert (result.trials, result.tested) == (14, 14)
    assert result.protocol["folds"] == 2  # of the rarest class, where nobody asks for another number
    assert np.trace(np.array(result.confusion)) >= 12
    with pytest.raises(InputError, match="the rarest class has 2 trials, so choose 2 folds"):
        evaluate(recordings, tracks, TaskSpec("part"), SPEC, EvaluationProtocol(3, 1, grid=GRID))


def test_a_class_of_one_day_is_left_out_where_days_are_held_out(recordings: Recordings, tracks: LabelTracks) -> None:
    protocol = EvaluationProtocol(repeats=1, grid=GRID, group="session")
    result = evaluate(recordings, tracks, TaskSpec("part"), SPEC, protocol)
    assert result.dropped == {"class in one session only: plug, ring": 3}
    assert result.items == {"clip": 6, "peg": 6}


def test_a_class_of_one_trial_is_not_learned(recordings: Recordings, tracks: LabelTracks) -> None:
    model = train(recordings, tracks, TaskSpec("part"), SPEC, GRID)
    assert model.svm.classes == ("clip", "peg", "plug")
    assert model.extra["dropped"] == {"class in one trial only: ring": 1}
    head = train_head(recordings, HeadSpec(TaskSpec("part")), EncoderConfig(dt=recordings.dt), preset())
    assert head.classes == ("clip", "peg", "plug")


@pytest.fixture(scope="module")
def rare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four trials of two phases, the last with a third one of its own, and one trial of a fourth phase alone."""
    phases = [("free", 0.0, 0.4), ("push", 0.5, 0.9)]
    marks = [(row, "phase", *phase) for row in range(4) for phase in phases]
    marks += [(3, "phase", "odd", 0.9, 1.0), (4, "phase", "one", 0.0, 1.0)]
    wrench = np.random.default_rng(0).normal(size=(5, 200, 6))
    made, store = Recordings.from_arrays(wrench, 200, annotations=marks, outcome=["success"] * 5), "a.zarr"
    folder = tmp_path_factory.mktemp("rare")
    write_recordings(folder / store, made, {})
    assert main(["encode", str(folder / store)]) == 0
    return folder


def test_an_interval_of_a_rare_class_is_no_trial_left_out(rare: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The trial is used, since its other intervals remain; it was counted as left out."""
    items, kept = learnable(labelled_intervals(read_recordings(rare / "a.zarr"), TaskSpec("phase")))
    reason = "class in one trial only: one, odd"
    assert (len(np.unique(items.trial)), int(kept.sum())) == (4, 8)
    assert items.dropped == {reason: 1, f"intervals, {reason}": 1}
    commands = {
        "info": ("{} left out: {}.", ()),
        "train": ("left out: {}, {}\n", (*ASKED, "-o", str(rare / "a.model"))),
    }
    for command, (sentence, options) in commands.items():
        capsys.readouterr()
        assert main([command, str(rare / "a.zarr"), *options]) == 0
        shown = capsys.readouterr().out + "\n"
        assert all(sentence.format(what, reason) in shown for what in ("1 trial", "1 interval"))


def test_accuracy_on_training_data_counts_what_it_is_of(rare: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The interval of the class that the model does not know was counted with those of the same trial."""
    store, model = str(rare / "a.zarr"), str(rare / "b.model")
    assert main(["train", store, *ASKED, "-o", model]) == 0
    capsys.readouterr()
    assert main(["classify", store, "--model", model, "-o", str(rare / "classes.csv"), "--json"]) == 0
    done = json.loads(capsys.readouterr().out)
    assert (done["sentences"], done["trained_on"], done["known"]) == (10, 8, 0)


def test_info_calls_no_column_a_task_whose_values_hardly_repeat(
    recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    onset = [f"{row / 7:.3f}" for row in range(len(PARTS) - 1)] + ["0.000"]
    texts = {"began": np.array(onset), "onset": np.char.add("after ", onset)}
    write_recordings(tmp_path / "a.zarr", with_columns(recordings, **texts), {})
    assert main(["info", str(tmp_path / "a.zarr"), "--json"]) == 0
    tasks = json.loads(capsys.readouterr().out)["tasks"]
    assert tasks["part"]["classes"] == {"clip": 6, "peg": 6, "plug": 2}
    assert "1 trial left out: class in one trial only: ring." in tasks["part"]["sentences"]
    sentence = "to train and to test, two classes must occur in two trials or more; at most one of its 14 classes does."
    assert "began" not in tasks  # measured values, no names
    assert tasks["onset"] == {"classes": {}, "sentences": [sentence]}


def test_two_classes_must_remain(recordings: Recordings, tracks: LabelTracks) -> None:
    task = TaskSpec("part", classes=("peg", "ring"))
    with pytest.raises(InputError, match="The rarest class has 1 trial; cross-validation needs two of every class"):
        evaluate(recordings, tracks, task, SPEC, EvaluationProtocol(grid=GRID))


def test_what_is_left_out_is_named_where_too_few_trials_remain(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of three annotated trials one succeeded: the others are missing, and nothing said so."""
    rows = [(row, "phase", label, at, at + 1.0) for row in range(3) for at, label in ((0.0, "reach"), (1.0, "push"))]
    wrench = np.random.default_rng(0).normal(size=(3, 400, 6))
    made = Recordings.from_arrays(wrench, 200, outcome=["success", "failure", "failure"], annotations=rows)
    write_recordings(tmp_path / "a.zarr", made, {})
    store, left = str(tmp_path / "a.zarr"), "2 trials left out: outcome not success."
    assert main(["info", store]) == 0
    assert left in capsys.readouterr().out
    assert main(["encode", store]) == 0
    for options in (["evaluate"], ["train", "-o", str(tmp_path / "a.model")]):
        assert main([options[0], store, "--task", "phase", *options[1:]]) == 2
        assert capsys.readouterr().err.endswith(" Left out: 2 trials (outcome not success).\n")


def test_two_trials_per_class_leave_nothing_to_choose_on() -> None:
    """A training half then has one of each, which the error must not say of the data."""
    made = Recordings.example().take(np.array([0, 1, 4, 5]))
    labels, task = rj.encode(made.wrench, rate=200), TaskSpec("outcome")
    with pytest.raises(InputError, match="the training part, where no class has two trials"):
        evaluate(made, labels, task, SPEC, EvaluationProtocol(repeats=1))
    one = Grid(kernels=("linear",), costs=(1.0,), scalings=(True,))
    assert evaluate(made, labels, task, SPEC, EvaluationProtocol(repeats=1, grid=one)).tested == 4


def test_a_class_of_one_trial_has_no_part_in_the_choice_of_parameters() -> None:
    """As in the training half of two folds, where a class has two trials."""
    x, y = np.random.default_rng(0).normal(size=(21, 2)), np.array([0] * 10 + [1] + [2] * 10)
    x[:, 0] += 5 * y
    rare = select({"noise": x[:, 1:], "signal": x[:, :1]}, y, np.arange(21), GRID, 0)
    assert rare.features == "signal"
    with pytest.raises(InputError, match=r"1 class has two trials; it takes two such classes, or .* cost, scaling and"):
        select({"": x[:11]}, y[:11], np.arange(11), GRID, 0)
