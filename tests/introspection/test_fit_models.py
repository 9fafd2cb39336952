"""Models of words by the fit rule: files, beliefs and words as in the batch, and the exported chain."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import config_fields, config_from, limits_from
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, Event, Word
from rcbht_jax.introspection import model as model_files
from rcbht_jax.introspection.chain import online_features
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.stablehlo import write_chain
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.labels import AXES, LAYERS
from rcbht_jax.learning.model_io import write_archive
from tests.support.introspection_models import CONFIG, FIT, FIT_LIMITS, LIMITS, VIEW, archive_of, fit_model, trial

EXAMPLE = Path(__file__).resolve().parents[2] / "examples/run_chain.py"
WRENCH = np.concatenate([trial(0, 90, 61), trial(1, 91, 102), trial(2, 93, 91)])


def test_a_file_keeps_rule_window_limits_and_tolerance(tmp_path: Path) -> None:
    model_files.save(tmp_path / "m", fit_model())
    back = model_files.load(tmp_path / "m")
    assert back.encoder == FIT
    assert isinstance(back.limits, FitLimits)
    for field in fields(FitLimits):
        np.testing.assert_array_equal(getattr(back.limits, field.name), getattr(FIT_LIMITS, field.name))
    assert Introspector(back).push(WRENCH) == Introspector(fit_model()).push(WRENCH)


def test_files_whose_limits_are_of_the_other_rule(tmp_path: Path) -> None:
    path = tmp_path / "m"
    model_files.save(path, fit_model())
    members, meta = archive_of(path)
    for wrong_meta, wrong in (
        ({"encoder": asdict(CONFIG)}, {}),
        ({}, {"limits.tolerance": np.zeros(6)}),
        ({}, {"limits.gradients": np.zeros((5, 4))}),
        ({"encoder": {"rule": "fit", "pipe": "one-slot"}}, {}),
    ):
        write_archive(path, meta | wrong_meta, members | wrong)
        with pytest.raises(InputError):
            model_files.load(path)
    with pytest.raises(InputError, match="tolerance"):
        replace(fit_model(), limits=LIMITS)
    with pytest.raises(InputError, match="tolerance"):
        replace(fit_model(), encoder=CONFIG)
    with pytest.raises(KeyError):
        limits_from(FIT, {"limits": np.ones((6, 4))})
    assert config_from(config_fields(CONFIG)) == CONFIG


def events_of(stream: Introspector | WordIntrospector, cuts: list[int]) -> list[Event]:
    return [event for piece in np.split(WRENCH, cuts) for event in stream.push(piece)]


def test_beliefs_equal_the_batch_in_any_chunks() -> None:
    events = events_of(Introspector(fit_model(), rate=10.0), [])
    assert events_of(Introspector(fit_model(), rate=10.0), [1, 3, 50, 51, 200]) == events
    beliefs = [event for event in events if isinstance(event, Belief)]
    now = np.arange(20, len(WRENCH) + 1, 20)
    assert [belief.sample for belief in beliefs] == now.tolist()
    x = online_features(FIT, FIT_LIMITS, VIEW, WRENCH, np.zeros_like(now), now)
    expected = fit_model().heads[0].machine.probability(x)
    np.testing.assert_allclose([belief.probabilities for belief in beliefs], expected, atol=1e-4)
    other = online_features(CONFIG, LIMITS, VIEW, WRENCH, np.zeros_like(now), now)
    assert np.abs(fit_model().heads[0].machine.probability(other) - expected).max() > 0.01


@pytest.mark.parametrize("with_model", [True, False])
def test_words_are_those_of_the_batch_encoder(with_model: bool) -> None:
    tracks = encode_batch(FIT, FIT_LIMITS, WRENCH[None], np.array([len(WRENCH)], np.int32))
    expected = {
        (layer, AXES[a], *(int(getattr(track, leaf)[0, a, k]) for leaf in ("label", "t0", "t1", "emit")))
        for layer in LAYERS
        for track in [getattr(tracks, layer)]
        for a, k in zip(*np.nonzero(track.label[0]), strict=True)
    }
    stream = Introspector(fit_model(), words=True) if with_model else WordIntrospector(FIT, FIT_LIMITS)
    stream.warm_up()
    events = events_of(stream, [7, 100]) + stream.finish()
    words = [e for e in events if isinstance(e, Word)]
    assert {(e.layer, e.axis, e.code, e.begin, e.end, e.sample) for e in words} == expected
    assert len(words) == len(expected)
    with pytest.raises(InputError, match=r"expected \[2, 4\]"):
        WordIntrospector(FIT, FIT_LIMITS, ["a", "b"])


def test_the_exported_chain_says_the_same_without_this_package(tmp_path: Path) -> None:
    assert write_chain(tmp_path / "c", fit_model(), ("cpu",))["encoder"]["rule"] == "fit"
    with zipfile.ZipFile(tmp_path / "c") as archive:
        assert json.loads(archive.read("chain.json"))["window"] == FIT.window
    blocked = "import sys; sys.modules['rcbht_jax'] = None; import runpy; sys.argv = sys.argv[1:]; "
    done = subprocess.run(
        [sys.executable, "-c", blocked + "runpy.run_path(sys.argv[0], run_name='__main__')", str(EXAMPLE), "c"],
        input="\n".join(json.dumps({"wrench": row}) for row in WRENCH.astype(float).tolist()),
        capture_output=True, text=True, cwd=tmp_path, timeout=300, check=True,
    )  # fmt: skip
    said = [json.loads(line) for line in done.stdout.splitlines()]
    beliefs = [e for e in Introspector(fit_model(), rate=None).push(WRENCH) if isinstance(e, Belief)]
    assert len(said) == len(beliefs) == len(WRENCH) // FIT.window
    for row, belief in zip(said, beliefs, strict=True):
        assert row["sample"] == belief.sample
        np.testing.assert_allclose(list(row["states"].values()), belief.probabilities, atol=2e-4)


def test_training_takes_the_limits_that_it_is_given() -> None:
    from rcbht_jax.introspection.training import HeadSpec, train_model

    recordings = rj.Recordings.example()
    spec = HeadSpec(rj.TaskSpec("outcome"), families=("histogram",), weighing=("time", "change"), rate=2.0)
    model = train_model(recordings, (spec,), FIT, FIT_LIMITS)
    assert (model.encoder, model.limits) == (FIT, FIT_LIMITS)
    assert model.heads[0].view.spec.weighing == ("time", "change")
