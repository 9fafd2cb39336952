"""A segmenter in a stream: the same beliefs as about whole recordings, from a file, by the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.annotations import Annotations
from rcbht_jax.cli.main import main
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.segmenter import WrenchSegmenter
from rcbht_jax.introspection.segmenter_file import SegmenterFile, load, save
from rcbht_jax.introspection.segmenter_stream import SegmenterStream
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.learning.segment_metrics import UNKNOWN
from rcbht_jax.types import Recordings

RATE = 100


def recordings(count: int) -> tuple[Recordings, list[np.ndarray]]:
    """Rest, a contact at different times, a push."""
    rng = np.random.default_rng(count)
    parts, labels = [], []
    for _ in range(count):
        begin = int(rng.integers(100, 200))
        time = np.arange(400)
        force = 3.0 * (time >= begin) + 0.05 * np.maximum(time - begin - 100, 0)
        parts.append(np.stack([0.2 * force, force, 0.01 * force], 1) + 0.05 * rng.normal(size=(400, 3)))
        labels.append((time >= begin).astype(int) + (time >= begin + 100))
    return Recordings.from_arrays(parts, RATE, axes=("Fx", "Fz", "My"), units=("N", "N", "Nm")), labels


@pytest.mark.parametrize("options", [{}, {"rule": "fit"}, {"words": False}])
def test_a_stream_in_any_pieces_gives_the_beliefs_of_the_whole(options, tmp_path: Path) -> None:
    data, labels = recordings(5)
    segmenter = WrenchSegmenter(trees=10, **options).fit(data.take(np.arange(4)), labels[:4])
    save(tmp_path / "s", SegmenterFile.of(segmenter, "phase", ("rest", "contact", "push")))
    stream, signal = SegmenterStream(load(tmp_path / "s")), data.wrench[4]
    whole = stream.push(signal, 10 + 3.99)
    (expected,) = segmenter.predict_proba(data.take(np.array([4])))
    every = 2  # 0.02 s, nearest to 0.025 s in samples
    assert [event.sample for event in whole] == list(range(1, 401, every))
    found = np.array([event.probabilities for event in whole])
    np.testing.assert_allclose(found[:-1], expected[::every][:-1], atol=1e-12)  # then it ends, and all is published
    assert {event.label for event in whole} == {"rest", "contact", "push"}
    for event in whole:
        assert event.time == pytest.approx(10 + (event.sample - 1) / RATE)
        assert event.probability == max(event.probabilities)
        assert event.label == event.classes[int(np.argmax(event.probabilities))]
    for pieces in (400, 57):
        stream.reset()
        parts = np.array_split(np.arange(400), pieces)
        assert [
            event for part in parts for event in stream.push(signal[part], round(10 + float(part[-1]) / RATE, 6))
        ] == whole


def test_a_class_between_two_decisions_is_kept_in_the_file_and_never_believed(tmp_path: Path) -> None:
    """A snap of 10 ms, where a decision comes every 25 ms."""
    rng, time = np.random.default_rng(0), np.arange(2000)
    force = rng.normal(size=(9, 2000, 1)) * 0.1 + 5 * (time >= 1000)[:, None]
    data = Recordings.from_arrays(force, rate=1000, axes=["grip"], units=["N"])
    y = np.where(time < 1001, 0, 2)
    y[1001:1011] = 1
    segmenter = WrenchSegmenter(trees=5, words=False).fit(data, [y] * 9)
    save(tmp_path / "s", SegmenterFile.of(segmenter, "phase", ("free", "snap", "contact")))
    events = SegmenterStream(load(tmp_path / "s")).push(force[0])
    expected = segmenter.predict_proba(data.take(np.array([0])))[0][::25]
    assert expected.shape == (80, 3)
    assert not expected[:, 1].any()
    np.testing.assert_allclose([event.probabilities for event in events], expected, atol=1e-12)
    y = np.where(time == 25, 1, UNKNOWN)
    y[1010:1020] = 0
    with pytest.raises(InputError, match="decisions, one in 25 samples, the labels have 1 class; two are needed"):
        segmenter.fit(data, [y] * 9)


def test_what_cannot_be_streamed_is_refused(tmp_path: Path) -> None:
    data, labels = recordings(3)
    offline = WrenchSegmenter(trees=5, offline=True).fit(data, labels)
    with pytest.raises(InputError, match="cannot follow a stream"):
        SegmenterFile.of(offline, "phase", ("rest", "contact", "push"))
    file = SegmenterFile.of(WrenchSegmenter(trees=5).fit(data, labels), "phase", ("rest", "contact", "push"))
    stream = SegmenterStream(file)
    assert stream.columns(("My", "Fx", "Fy", "Fz"), 0.01) == [1, 3, 0]
    with pytest.raises(InputError, match="The segmenter needs the axes Fx, Fz, My; the stream has Fx, Fz"):
        stream.columns(("Fx", "Fz"), 0.01)
    with pytest.raises(InputError, match="The segmenter needs samples at 100 Hz; the stream has 200 Hz"):
        stream.columns(file.axes, 0.005)
    words = WordIntrospector(EncoderConfig(dt=1 / RATE), preset(axes=file.axes), file.axes, ("N", "N", "Nmm"))
    with pytest.raises(InputError, match="The stream has My in Nmm; the model learned it in Nm"):
        Together(words, readers=[stream])
    for samples in (np.zeros((4, 2)), np.full((4, 3), np.nan)):
        with pytest.raises(InputError, match="expected finite"):
            stream.push(samples)
    save(tmp_path / "s", file)
    (tmp_path / "s").write_bytes((tmp_path / "s").read_bytes()[:-200])
    with pytest.raises(InputError, match="not a readable model file"):
        load(tmp_path / "s")


def test_from_a_store_to_labels_of_a_stream_by_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, labels = recordings(4)
    names = ("rest", "contact", "push")
    starts = [[0.0, *(np.flatnonzero(np.diff(part)) + 1) / RATE] for part in labels]
    marks = Annotations.from_starts("phase", names, starts, np.full(4, 4.0))
    write_recordings(tmp_path / "runs.zarr", replace(data, annotations=marks), {})
    model, table = tmp_path / "phase.segmenter", tmp_path / "s.csv"
    words = ["segment", tmp_path / "runs.zarr", "-o", table, "--folds", "2", "--write-model", model]
    assert main([*map(str, words)]) == 0
    assert f"{model}: trained on all annotated recordings" in capsys.readouterr().out
    assert main(["stream", str(tmp_path / "runs.zarr"), "--segmenter", str(model)]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    beliefs = [event for event in events if event["event"] == "Belief"]
    right = [
        event["label"] == names[labels[number // 200][event["sample"] - 1]] for number, event in enumerate(beliefs)
    ]
    assert len(right) == 4 * 200
    assert np.mean(right) > 0.95
    assert {event["head"] for event in beliefs} == {"phase"}
    assert "Word" in {event["event"] for event in events}
    assert main([*map(str, words), "--offline"]) == 2
    assert "cannot follow a stream" in capsys.readouterr().err
    assert read_recordings(tmp_path / "runs.zarr").axes == load(model).axes
