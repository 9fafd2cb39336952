"""Model files: what is written is what is read, and nothing else gets in."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.introspection import model as introspection
from rcbht_jax.learning.model_io import FORMAT, TrainedModel, load, reading, save, write_archive
from rcbht_jax.learning.predict import check_encoders, task_of
from rcbht_jax.learning.svm import SvmSpec, fit
from rcbht_jax.learning.tasks import TaskSpec


@pytest.fixture
def model() -> TrainedModel:
    rng = np.random.default_rng(0)
    y = np.arange(30) % 3
    x = rng.normal(size=(30, 4)) + y[:, None]
    svm = fit(x, y, ("up", "down", "Größe"), SvmSpec("rbf", 10.0, True))
    return TrainedModel(
        svm=svm,
        feature_spec=FeatureSpec(families=("histogram", "ngram"), slots=(3, 2, 1)),
        feature_names=("a", "b", "c", "d"),
        task={"task": "states", "sources": ["x"]},
        encoder={"window": 5, "thresholds": [[1.0, 2.0]]},
        data_hash="abc",
        extra={"items": 30},
        digests=np.arange(64, dtype=np.uint8).reshape(2, 32),
        axes=("grip", "twist"),
        units=("N", ""),
    )


def test_round_trip_keeps_everything(model, tmp_path):
    path = str(tmp_path / "states.model")
    save(path, model)
    back = load(path)
    x = np.random.default_rng(1).normal(size=(50, 4))
    np.testing.assert_array_equal(back.svm.decision(x), model.svm.decision(x))
    np.testing.assert_array_equal(back.svm.predict(x), model.svm.predict(x))
    np.testing.assert_array_equal(back.digests, model.digests)
    assert back.svm.spec == model.svm.spec
    for name in ("feature_spec", "feature_names", "task", "encoder", "data_hash", "version", "extra", "axes", "units"):
        assert getattr(back, name) == getattr(model, name)


@pytest.fixture
def path(model, tmp_path):
    """A file of the model."""
    path = tmp_path / "m"
    save(path, model)
    return path


def rewritten(path, **changes):
    """The same file with some members replaced."""
    with np.load(path) as archive:
        members = {k: archive[k] for k in archive.files}
    with path.open("wb") as out:
        np.savez(out, **{**members, **changes})


def test_arrays_that_do_not_fit_are_refused(model, path):
    rewritten(path, intercept=np.zeros(1))
    with pytest.raises(InputError, match=r"intercept has the shape \(1,\)"):
        load(path)
    save(path, model)
    rewritten(path, digests=np.zeros((2, 3), np.uint8))
    with pytest.raises(InputError, match=r"digests have the shape \(2, 3\)"):
        load(path)


def test_a_model_of_another_command_is_named(path):
    with pytest.raises(InputError, match='made by "rcbht train"; this needs a file of "rcbht train-online"'):
        introspection.load(path)
    with reading(path, FORMAT) as (meta, arrays):
        write_archive(path, meta | {"format": introspection.FORMAT}, arrays)
    with pytest.raises(InputError, match='made by "rcbht train-online"; this needs a file of "rcbht train"'):
        load(path)


def test_a_file_of_another_command_is_not_called_damaged(path):
    """A monitor's file may have gaps (NaN), which the others may not."""
    with reading(path, FORMAT) as (meta, arrays):
        write_archive(path, meta | {"format": "rcbht-monitor-1"}, {**arrays, "described": np.full(3, np.nan)})
    with pytest.raises(InputError, match='made by "rcbht monitor fit"; this needs a file of "rcbht train"'):
        load(path)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["center", "width", "support", "dual", "intercept"])
def test_arrays_that_are_not_finite_are_refused(model, name, value, path):
    values = getattr(model.svm, name).copy()
    values.flat[0] = value
    rewritten(path, **{name: values})
    with pytest.raises(InputError, match=f"{name} is not finite"):
        load(path)


@pytest.mark.parametrize("gamma", [-1.0, 0.0, 1e999])
def test_a_width_of_the_kernel_that_is_none_is_refused(gamma, path, monkeypatch):
    with np.load(path) as archive:
        meta = json.loads(str(archive["meta"]))
    rewritten(path, meta=np.array(json.dumps(meta | {"gamma": gamma})))
    monkeypatch.chdir(path.parent)
    with pytest.raises(InputError, match=r"^m is (damaged: gamma is|not a readable).*\.$"):  # "gamma" has an m
        load(path.name)


def test_code_in_a_file_is_refused(path):
    rewritten(path, dual=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="Python objects"):
        load(path)


def test_other_formats_and_damage_are_refused(model, tmp_path, path):
    whole = path.read_bytes()
    for content in (b"", b"hello", whole[: len(whole) // 2], whole[:200] + b"\0" * 60 + whole[260:]):
        path.write_bytes(content)
        with pytest.raises(InputError, match="is empty" if not content else "not a readable model"):
            load(path)
    with path.open("wb") as out:
        np.save(out, np.zeros(3))
    with pytest.raises(InputError, match="not a readable model"):
        load(path)
    with pytest.raises(InputError, match="missing cannot be read"):
        load(tmp_path / "missing")
    save(path, model)
    for flag in (6, 8, 10):  # version, encryption, method of the first entry of the zip archive's directory
        archive = bytearray(path.read_bytes())
        archive[archive.find(b"PK\x01\x02") + flag] ^= 0x61
        (tmp_path / "flag").write_bytes(archive)
        with pytest.raises(InputError, match="not a readable model"):
            load(tmp_path / "flag")
    rewritten(path, meta=np.array("[" * 100_000))
    with pytest.raises(InputError, match="not a readable model"):
        load(path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="not a regular file"):
        load(tmp_path / "pipe")
    save(path, model)
    rewritten(path, meta=np.array(json.dumps({"format": "rcbht-model-99"})))
    with pytest.raises(InputError, match="rcbht-model-99"):
        load(path)


def test_what_cannot_be_written_is_refused(model, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        save(tmp_path / "m", replace(model, encoder={"limits": np.zeros(3)}))
    with pytest.raises(InputError, match="cannot be written"):
        save(tmp_path / "m", replace(model, encoder={"limit": float("nan")}))
    assert not (tmp_path / "m").exists()
    with pytest.raises(InputError, match="cannot be written"):
        save(tmp_path / "none" / "m", model)
    if Path("/dev/full").exists():  # Linux
        with pytest.raises(OSError, match="No space"):  # for which the command line has a sentence and a status
            save(Path("/dev/full"), model)


@pytest.mark.parametrize(
    "change",
    [
        {"classes": ["a", "a", "b"]}, {"classes": [1, 2, 3]}, {"classes": [["a"], ["b"], ["c"]]}, {"classes": "abc"},
        {"classes": [None] * 3}, {"classes": ["a", "b", "\ud800"]}, {"classes": ["a", "b", "x" * 2000]},
        {"feature_names": [1, 2, 3, 4]}, {"gamma": "0.5"}, {"task": None}, {"encoder": []}, {"extra": "x"},
        {"version": 1.0}, {"axes": "ab"}, {"axes": ["a"]}, {"units": [1, 2]},
    ],
)  # fmt: skip
def test_names_in_a_model_are_texts(change, path):
    """They become labels of beliefs, cells of tables and parts of pages."""
    with np.load(path) as archive:
        meta = json.loads(str(archive["meta"]))
    rewritten(path, meta=np.array(json.dumps({**meta, **change})))
    with pytest.raises(InputError, match=r"m is (damaged|.* not valid Unicode)"):
        load(path)


@pytest.mark.parametrize("task", [{}, {"outcomes": 5}, {"task": 5}, {"boundaries": None}, {"arms": ["R"]}])
def test_a_task_that_is_none_is_one_sentence(task, model):
    whole = asdict(TaskSpec()) | task if task else {}
    with pytest.raises(InputError):
        task_of(replace(model, task=whole))


@pytest.mark.parametrize("name", ["config", "thresholds_from"])
@pytest.mark.parametrize("tracks", ["", "a+b"])
def test_an_encoder_that_is_no_object_is_one_sentence(name, tracks, model, tmp_path):
    made = {"window": 5, "thresholds": [[4.0, 3.0, 2.0, 1.0]], name: []}
    svm = replace(model.svm, spec=replace(model.svm.spec, features=tracks)) if tracks else model.svm
    for encoder in [{"a": made, "b": {}}, {"a": {}, "b": []}] if tracks else [made]:
        save(tmp_path / "m", replace(model, svm=svm, encoder=encoder))
        with pytest.raises(InputError, match=r"m is damaged: .* expected an object"):
            load(tmp_path / "m")


def test_damaged_options_of_an_encoder_are_one_sentence(model):
    for config in ([], {"rule": "fit"}, {"rule": "fit", "window": 5, "tolerance": 1.0}):
        with pytest.raises(InputError, match="made otherwise"):
            check_encoders(replace(model, encoder={"config": config, "window": 5}), {"": {}, "online-W5": {}})
