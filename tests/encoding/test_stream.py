"""What a stream promises beside its labels: what it counts, keeps, refuses, and how a new one begins."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.encoding import stream
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.errors import InputError
from tests.encoding.test_fit import LIMITS, wrench_of
from tests.support.tracks import FIELDS, layers
from tests.support.trees import assert_trees_equal

THREE = wrench_of(0, "noise").astype(np.float32)
SIX = np.concatenate([THREE, -THREE], axis=1)


def fit_stream() -> Encoder:
    return Encoder(FitConfig(), LIMITS)


def paper_stream() -> Encoder:
    return Encoder(rj.EncoderConfig(), rj.preset())


def lines_of(encoder: Encoder, samples: np.ndarray) -> list[Any]:
    return list(encoder.lines(samples))


def labels_of(encoder: Encoder, wrench: np.ndarray) -> list[Any]:
    return [*encoder.push(wrench), encoder.flush()]


@pytest.mark.parametrize(("begun", "wrench"), [(paper_stream, SIX), (fit_stream, THREE)], ids=["paper", "fit"])
@pytest.mark.parametrize("end", [Encoder.flush, Encoder.restart])
def test_a_new_stream_knows_nothing_of_the_last(
    begun: Callable[[], Encoder], wrench: np.ndarray, end: Callable[[Encoder], Any]
) -> None:
    encoder = begun()
    encoder.push(100 - wrench)
    end(encoder)
    assert encoder.received == 0
    assert_trees_equal(labels_of(encoder, wrench), labels_of(begun(), wrench))


@pytest.mark.parametrize("take", [Encoder.push, lines_of])
def test_samples_are_taken_up_to_the_last_that_can_be_counted(
    take: Callable[[Encoder, np.ndarray], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "MOST_SAMPLES", 23)
    encoder = fit_stream()
    take(encoder, THREE[:13])
    with pytest.raises(InputError, match="More than 23 samples of one stream cannot be counted"):
        take(encoder, THREE[13:24])
    assert encoder.received == 13
    take(encoder, THREE[13:23])
    assert encoder.received == 23
    encoder.restart()
    take(encoder, THREE[:23])


@pytest.mark.parametrize("bad", [np.full((4, 3), np.nan), np.full((4, 3), 1e31), THREE[:4, :1], THREE[0]])
def test_bad_samples_change_nothing(bad: np.ndarray) -> None:
    encoder, other = fit_stream(), fit_stream()
    for one in (encoder, other):
        one.push(THREE[:13])
    for take in (Encoder.push, lines_of):
        with pytest.raises(InputError, match=r"Samples h(old a value that is not|ave shape)"):
            take(encoder, bad)
    assert encoder.received == 13
    assert_trees_equal(labels_of(encoder, THREE), labels_of(other, THREE))


@pytest.mark.parametrize(("first", "second"), [(13, 13), (13, 58), (15, 16), (3, len(THREE))])
def test_lines_and_windows_may_take_turns(first: int, second: int) -> None:
    encoder = fit_stream()
    before = encoder.push(THREE[:first])
    lines = sum(len(words[0]) for words, _ in encoder.lines(THREE[first:second]))
    assert encoder.received == second
    after, whole = labels_of(encoder, THREE[second:]), labels_of(fit_stream(), THREE)
    assert len(before) + lines + len(after) == len(whole)
    assert_trees_equal(after, whole[-len(after) :])


def test_between_windows_the_stream_is_at_their_end() -> None:
    encoder = paper_stream()
    encoder.push(SIX[:3])
    assert [encoder.received for _ in encoder.windows(SIX[3:83])] == list(range(5, 81, 5))
    assert encoder.received == 83


def test_a_slot_without_a_word_is_empty() -> None:
    encoder = paper_stream()
    for tracks in labels_of(encoder, SIX):
        for track in layers(tracks):
            for values in (getattr(track, name) for name in FIELDS):
                assert not values[track.label == 0].any()


def test_limits_are_those_of_the_beginning() -> None:
    memory = np.zeros(6 * 4 * 4 + 64, np.uint8)
    limits = memory[-memory.ctypes.data % 64 :][: 6 * 4 * 4].view(np.float32).reshape(6, 4)
    limits[:] = rj.preset().limits  # so aligned, JAX uses an array where it lies
    encoder = Encoder(rj.EncoderConfig(), limits)
    limits *= 100
    assert_trees_equal(labels_of(encoder, SIX), labels_of(paper_stream(), SIX))


def test_limits_of_several_streams_are_refused() -> None:
    with pytest.raises(InputError, match=r"shape \(2, 6, 4\); a stream expects \[axis, 4\]"):
        Encoder(rj.EncoderConfig(), np.stack([rj.preset().limits] * 2))
