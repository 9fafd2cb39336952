"""The commands that learn from a store, end to end on a small synthetic one, and their answers to bad input."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rcbht_jax.cli.encode import Encode
from rcbht_jax.cli.main import all_commands, main
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import write_recordings
from rcbht_jax.learning.model_io import load
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings
from tests.support.command_line import CommandLine
from tests.support.store_cases import encoded_store

TRIALS, SAMPLES = 12, 400


def synthetic() -> Recordings:
    """Trials whose four states differ in slope and noise, in two sessions."""
    rng = np.random.default_rng(0)
    slopes = np.repeat([0.0, 3.0, -6.0, 30.0], SAMPLES // 4) * 0.005
    noise = np.repeat([0.001, 0.01, 0.05, 0.2], SAMPLES // 4)[:, None]
    wrench = np.cumsum(slopes)[None, :, None] + rng.normal(size=(TRIALS, SAMPLES, 6)) * noise
    onset = np.tile([0.0, 0.5, 1.0, 1.5], (TRIALS, 1))
    words = np.full(TRIALS, "R")
    return snap_recordings(
        wrench=wrench.astype(np.float32), length=np.full(TRIALS, SAMPLES, np.int32), dt=0.005, onset=onset,
        onset_harmonised=onset, trial=np.array([f"trial-{i:02d}" for i in range(TRIALS)]), arm=words,
        source=np.full(TRIALS, "SET"), session=np.array(["A", "B"] * (TRIALS // 2)),
        outcome=np.full(TRIALS, "success"), failure_type=np.full(TRIALS, ""),
        deviation=np.full((TRIALS, 3), np.nan), note=np.full(TRIALS, ""),
    )  # fmt: skip


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encoded_store(tmp_path_factory.mktemp("commands") / "set.zarr", synthetic())


def test_encode_keeps_labels_and_says_how(store: Path, rcbht: CommandLine) -> None:
    result = rcbht.json("encode", store, "--window", 20, "--no-gate")
    assert result["name"] == "online-W20-ungated"
    tracks, attrs = read_tracks(store, result["name"])
    assert np.count_nonzero(tracks.llb.label) == result["labels"]["llb"] > 0
    assert attrs["config"]["gate"] is False
    fitted = rcbht.json("encode", store, "--rule", "fit", "--tolerance", 0.5)
    assert fitted["name"] == "online-W5-fit-tol0.5"
    tracks, attrs = read_tracks(store, fitted["name"])
    assert np.count_nonzero(tracks.primitive.label) == fitted["labels"]["primitive"] > 0
    assert (attrs["config"]["rule"], attrs["config"]["tolerance"]) == ("fit", [0.5] * 6)
    offline = rcbht.json("encode", store, "--mode", "offline", "--clean")
    assert offline["name"] == "offline-clean"
    tracks, _ = read_tracks(store, "offline-clean")
    assert (tracks.primitive.emit == np.where(tracks.primitive.label > 0, -1, 0)).all()


def test_evaluate_beats_chance_and_reports_baselines(store: Path, rcbht: CommandLine) -> None:
    quick = ("--kernels", "linear", "--costs", 0.1, 1, "--tracks", "online-W5")
    result = rcbht.json("evaluate", store, "--folds", 3, "--repeats", 2, *quick)
    assert result["score"]["accuracy"]["mean"] > 0.9
    assert result["majority_baseline"]["accuracy"] == {"mean": 0.25}
    crossed = rcbht.json("evaluate", store, "--train-on", "A", "--test-on", "B", *quick)
    assert np.sum(crossed["confusion"]) == 4 * TRIALS // 2
    assert (crossed["protocol"]["folds"], crossed["protocol"]["repeats"]) == (None, None)
    for unused in ("--folds", "--repeats"):
        error = rcbht.refused("evaluate", store, "--train-on", "A", "--test-on", "B", unused, "10")
        assert "--folds and --repeats are for cross-validation" in error
    assert "duration alone" in rcbht("evaluate", store, "--folds", "3", "--repeats", "1", *quick)


def test_train_writes_a_model_that_loads(store: Path, tmp_path: Path, rcbht: CommandLine) -> None:
    out = tmp_path / "states.model"
    result = rcbht.json("train", store, "--tracks", "online-W5", "--kernels", "linear", "--costs", 0.1, 1, "--out", out)
    model = load(out)
    assert list(model.svm.classes) == result["classes"] == ["approach", "rotation", "insertion", "mating"]
    assert model.encoder["config"]["window"] == 5


def test_a_model_of_fitted_words_refuses_labels_of_another_tolerance(
    store: Path, tmp_path: Path, rcbht: CommandLine
) -> None:
    for name, options in (("fine", ("--tolerance", 0.3)), ("coarse", ()), ("broad", ("--window", 8))):
        rcbht.json("encode", store, "--rule", "fit", "--name", name, *options)
    out, quick = tmp_path / "fitted.model", ("--kernels", "linear", "--costs", 1, "--weighing", "time", "change")
    rcbht.json("train", store, "--tracks", "fine", *quick, "--out", out)
    model = load(out)
    assert (model.encoder["config"]["rule"], model.encoder["config"]["tolerance"]) == ("fit", [0.3] * 6)
    assert model.feature_spec.weighing == ("time", "change")
    classify = ("classify", str(store), "--model", str(out), "-o", str(tmp_path / "c.csv"), "--tracks")
    rcbht(*classify, "fine")
    for tracks, part in (("coarse", "tolerance [0.3"), ("broad", "window 5, here 8"), ("online-W5", "made otherwise")):
        error = rcbht.refused(*classify, tracks)
        assert part in error
        assert "--rule fit --window 5 --tolerance 0.3 0.3 0.3 0.3 0.3 0.3" in error


def test_other_recordings_get_the_thresholds_of_a_model(tmp_path: Path, rcbht: CommandLine) -> None:
    """Those of --robot auto are of each store, so no way of encoding another one gave labels that the model reads."""
    rng = np.random.default_rng(0)
    for name in ("one", "two"):
        wrench = 0.05 * rng.normal(size=(8, 300, 2))
        wrench[:, 100:, 0] += np.repeat([5.0, 9.0], 4)[:, None]
        outcome = ["success"] * 4 + ["failure"] * 4
        data = Recordings.from_arrays(wrench, 100, axes=["a", "b"], outcome=outcome)
        write_recordings(tmp_path / f"{name}.zarr", data, {})
        rcbht.json("encode", tmp_path / f"{name}.zarr", "--rule", "fit", "--name", "mine")
    model, two = tmp_path / "m", tmp_path / "two.zarr"
    quick = ("--kernels", "linear", "--costs", 1, "--task", "outcome")
    rcbht.json("train", tmp_path / "one.zarr", "--tracks", "mine", *quick, "-o", model)
    classify = ["classify", str(two), "-m", str(model), "-o", str(tmp_path / "c.csv")]
    assert "--thresholds MODEL" in rcbht.refused(*classify)
    rcbht.json("encode", two, "--rule", "fit", "--thresholds", model, "--name", "its")
    rcbht(*classify, "--tracks", "its")
    assert "no online labels of window 8" in rcbht.refused("encode", two, "--window", "8", "--thresholds", model)


def test_every_label_track_of_a_model_can_be_made_again(tmp_path: Path, rcbht: CommandLine) -> None:
    """Of two tracks of one window, a model gave the limits of the first, whatever was asked for."""
    wrench = 0.05 * np.random.default_rng(0).normal(size=(8, 300, 2))
    wrench[:, 100:, 0] += np.repeat([5.0, 9.0], 4)[:, None]
    one, two, model = (tmp_path / name for name in ("one.zarr", "two.zarr", "m"))
    for store in (one, two):
        data = Recordings.from_arrays(wrench, 100, axes=["a", "b"], outcome=["success"] * 4 + ["failure"] * 4)
        write_recordings(store, data, {})
        rcbht.json("encode", store, "--name", "usual")
    rcbht.json("encode", one, "--scale", 0.3, "--name", "fine")
    rcbht.json("encode", two, "--name", "fine")
    quick = ("--kernels", "linear", "--costs", 1, "--task", "outcome")
    rcbht.json("train", one, "--tracks", "usual+fine", *quick, "-o", model)
    classify = ["classify", str(two), "-m", str(model), "-o", str(tmp_path / "c.csv")]
    advice = re.search(r'"rcbht encode(.* --name fine-model)"', rcbht.refused(*classify))
    assert advice
    error = rcbht.refused("encode", two, "--thresholds", model, "--name", "mine")
    assert "labels usual, fine of window 5, whose limits differ" in error
    rcbht.json("encode", two, *advice[1].replace("MODEL", str(model)).split())
    rcbht(*classify, "--tracks", "usual+fine-model")


@pytest.mark.parametrize(
    "options",
    [
        ("--robot", "auto", "--window", "20"),
        ("--robot", "hiro"),
        ("--mode", "offline", "--version", "wip", "--robot", "pa10"),
        ("--robot", "hiro", "--scale", "2", "--rule", "similar", "--no-gate", "--contact-first", "--latency-cap", "1"),
    ],
)
def test_the_advice_for_other_labels_can_be_followed(
    options: tuple[str, ...], tmp_path: Path, rcbht: CommandLine
) -> None:
    one, two, model = tmp_path / "one.zarr", tmp_path / "two.zarr", str(tmp_path / "m")
    for path, factor in ((one, 1), (two, 2)):
        write_recordings(path, replace(synthetic(), wrench=synthetic().wrench * factor), {})
    rcbht.json("encode", one, "--name", "mine", *options)
    rcbht.json("encode", two, "--name", "mine")
    rcbht.json("train", one, "--tracks", "mine", "--kernels", "linear", "--costs", 1, "-o", model)
    classify = ["classify", str(two), "-m", model, "-o", str(tmp_path / "c.csv"), "--tracks"]
    advice = re.search(r'such labels with "rcbht encode ([^"]*)" first', rcbht.refused(*classify, "mine"))
    assert advice is not None
    rcbht.json("encode", two, "--name", "its", *advice[1].replace("MODEL", model).split())
    rcbht(*classify, "its")


def test_grammars_stand_side_by_side_or_are_chosen_from(store: Path, tmp_path: Path, rcbht: CommandLine) -> None:
    made = rcbht.json("encode", store, "--window", 20, "--robot", "hiro", "--scale", 0.0625)
    assert made["name"] == "online-W20-x0.0625"
    assert made["thresholds"][0][3] == 0.0625
    quick = ("--kernels", "linear", "--costs", 1, "--features", "parts", "levels", "--ranks", "--balance")
    both = f"online-W5+{made['name']}"
    folds = ("--folds", 2, "--repeats", 1)
    result = rcbht.json("evaluate", store, "--tracks", made["name"], both, *folds, *quick)
    assert result["tracks"] == f"{made['name']} {both}"
    assert all(line.split()[0] in (made["name"], both) and line.endswith("ranks") for line in result["chosen"])
    assert set(result["provenance"]["labels"]) == {"online-W5", made["name"]}
    trained = rcbht.json("train", store, "--tracks", both, *quick, "--out", tmp_path / "m")
    model = load(tmp_path / "m")
    assert trained["tracks"] == both
    assert set(model.encoder) == {"online-W5", made["name"]}
    twice = rcbht.json("train", store, "--tracks", "online-W5+online-W5", *quick, "--out", tmp_path / "twice")
    assert twice["tracks"] == "online-W5"
    assert model.feature_names[0].startswith("online-W5.parts.primitive.Fx.")
    assert model.feature_spec.balance
    assert model.svm.spec.ranks


@pytest.mark.parametrize(
    "words",
    [
        ("encode", "nowhere.zarr"), ("encode", "STORE"), ("encode", "STORE", "--window", "1"),
        ("encode", "STORE", "--window", "x"), ("encode", "STORE", "--latency-cap", "-1"),
        ("encode", "STORE", "--scale", "0", "--name", "none"), ("evaluate", "STORE", "--tracks", "online-W5+none"),
        ("encode", "STORE", "--scale", "2", "--mode", "offline"), ("encode", "STORE", "--tolerance", "1"),
        ("encode", "STORE", "--rule", "fit", "--tolerance", "1", "2"),
        ("encode", "STORE", "--rule", "fit", "--tolerance", "0"),
        ("encode", "STORE", "--rule", "fit", "--pipe", "one-slot"),
        ("encode", "STORE", "--rule", "fit", "--mode", "offline", "--name", "none"),
        ("train-online", "STORE", "--tolerance", "1"), ("segment", "STORE", "--tolerance", "1"),
        ("train-online", "STORE", "--rule", "fit", "--tolerance", "1", "2"),
        ("train-online", "STORE", "--task", "states", "--relative", "--families", "levels"),
        ("report", "STORE", "-o", "x.html", "--rule", "fit", "--tracks", "none"),
        ("export", "STORE", "-o", "x", "--tolerance", "1"),
        ("train", "STORE", "--features", "levels", "--weighing", "time"),
        ("evaluate", "STORE", "--session", "Z"), ("evaluate", "STORE", "--tracks", "none"),
        ("evaluate", "STORE", "--train-on", "A"), ("evaluate", "STORE", "--folds", "1"),
        ("evaluate", "STORE", "--task", "failure-type"), ("evaluate", "STORE", "--costs", "-1"),
        ("evaluate", "STORE", "--repeats", "0"), ("train", "STORE", "--out", "/nowhere/at/all/x.model"),
        ("demo", "--data", "nowhere"), ("bench", "--trials", "0"), ("bench", "--samples", "1"), ("fly",),
    ],
)  # fmt: skip
def test_wrong_input_ends_with_one_sentence(words: tuple[str, ...], store: Path, rcbht: CommandLine) -> None:
    out, err = rcbht.ended(2, *(store if word == "STORE" else word for word in words))
    assert out == ""
    assert len([line for line in err.splitlines() if line.strip()]) == 1 or "invalid" in err.lower(), err


NEED_NO_STORE = ("bench", "completion", "demo", "doctor", "simulate", "fidelity")
OPTIONS = "--window --tracks --seed --task --json --folds --robot --mode --costs --out -o --"
option = st.sampled_from(OPTIONS.split())
word = st.one_of(option, st.text(max_size=6), st.integers(-3, 3).map(str), st.floats().map(str))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    command=st.sampled_from([name for name in all_commands() if name not in NEED_NO_STORE]),
    rest=st.lists(word, max_size=5),
)
def test_any_words_give_a_sentence_or_help(
    command: str, rest: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # no store is here, so nothing can succeed but help
    status = main([*command.split(), *rest])
    out, err = capsys.readouterr()
    assert status in (0, 2)
    assert status == 2 or "usage" in out
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--clean"], "--clean is for --mode offline; leave it out"),
        (["--version", "wip"], "--version is for --mode offline"),
        (["--mode", "offline", "--window", "20"], "--window is for --mode online; leave it out"),
        (["--mode", "offline", "--no-gate"], "--no-gate is for --mode online"),
        (["--mode", "offline", "--latency-cap", "0.1"], "--latency-cap is for --mode online"),
        (["--robot", "pa10", "--thresholds", "limits.json"], "--robot and --thresholds both choose thresholds"),
    ],
)
def test_encode_refuses_what_it_would_ignore(
    words: list[str], said: str, store: Path, tmp_path: Path, rcbht: CommandLine, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("limits.json").touch()
    assert said in rcbht.refused("encode", store, *words, "--name", "ignored")


def test_a_default_name_is_one_that_the_store_takes() -> None:
    limits, tolerance = Path("my limits (2).json"), (2e6,)
    name = Encode(Path("x.zarr"), thresholds=limits, rule="fit", tolerance=tolerance)._default_name()
    assert name == "online-W5-fit-tol2e06-my-limits-2-"


@pytest.mark.parametrize(("version", "name"), [("master", "offline-clean"), ("wip", "offline-clean-wip")])
def test_clean_labels_of_two_versions_have_two_names(version: Any, name: str) -> None:
    """They differ, and all of them were called offline-clean."""
    assert Encode(Path("x.zarr"), mode="offline", clean=True, version=version)._default_name() == name
