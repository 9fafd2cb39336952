"""Provisional labels of the fit rule: what they are, that no chunking changes them, and that nothing published does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rcbht_jax as rj
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.labels import Primitive
from rcbht_jax.types import LabelTrack
from tests.encoding.test_fit import AXES, LIMITS, TOLERANCE, layers, wrench_of
from tests.support.fit_oracle import FitOracle, least_squares, near
from tests.support.oracle import It
from tests.support.trees import assert_trees_equal

signals = st.tuples(st.integers(0, 2**32 - 1), st.sampled_from(["noise", "steps", "ramps"]), st.integers(1, 333))
CONFIGS = {"default": (FitConfig(), {}), "window 2": (FitConfig(window=2), {"window": 2, "kept": 8})}


@dataclass
class GoesOn(FitOracle):
    """The oracle whose last run goes on, as the line through its newest samples does, until evidence would suffice."""

    def primitive(self, y: np.ndarray, start: int, end: int) -> It:
        if end < len(y):
            return super().primitive(y, start, end)
        newest = y[max(start, end - min(self.needed, self.kept)) :]
        mean, slope, _ = least_squares(newest)
        ahead = mean + slope * ((len(newest) - 1) / 2 + np.arange(1, self.missing(y, start) + 1))
        return super().primitive(np.concatenate([y, ahead]), start, end + len(ahead))

    def missing(self, y: np.ndarray, start: int) -> int:
        return round(max(self.needed - self.saved(y, start), 0))

    def saved(self, y: np.ndarray, start: int) -> float:
        now, whole = len(y), len(y) // self.window * self.window
        places = range(max(start + 2, whole - self.kept), now - 1)
        if not places or any(end == start and when > whole for end, when in self.breaks()):
            return 0.0
        apart = min(least_squares(y[start:p])[2] + least_squares(y[p:])[2] for p in places)
        return (least_squares(y[start:])[2] - apart) / self.tolerance**2

    def breaks(self) -> list[tuple[int, int]]:
        return [(item.t1, when) for item, when in self.out[0]]


class LastsLonger(GoesOn):
    """As the oracle of compositions and behaviours, but a young run goes on to 0.11 s unless a break is in sight."""

    def missing(self, y: np.ndarray, start: int) -> int:
        age = len(y) - start
        if age >= 22:
            return super().missing(y, start)
        return round((22 - age) * max(1 - 4 * self.saved(y, start) / self.needed, 0))


def words(track: LabelTrack, axis: int) -> list[tuple[int, ...]]:
    used = track.label[axis] > 0
    return list(zip(*(values[axis][used].tolist() for values in (track.label, track.t0, track.t1)), strict=True))


def assert_words_are_of_a_run_that_goes_on(wrench: np.ndarray, pieces: list[Any], options: dict[str, int]) -> None:
    """The words published so far and the provisional ones, unless rounding decides what they are."""
    for axis in range(3):
        limits = tuple(LIMITS.gradients[axis].tolist()), float(TOLERANCE[axis])
        primitives, above = (oracle(*limits, **options) for oracle in (LastsLonger, GoesOn))
        for oracle in (primitives, above):
            oracle.encode(wrench[:, axis])
        if near(primitives) or near(above):
            continue
        for number, rows in enumerate([primitives.out[0], *above.out[1:]]):
            said = [word for piece in pieces for word in words(layers(piece)[number], axis)]
            assert said == [(item.label, item.t0, min(item.t1, len(wrench))) for item, _ in rows]


@pytest.mark.parametrize("name", CONFIGS)
@settings(max_examples=15)
@given(signal=signals)
def test_provisional_words_are_those_of_a_run_that_goes_on(name: str, signal: tuple[int, str, int]) -> None:
    config, options = CONFIGS[name]
    seed, style, length = signal
    wrench = wrench_of(seed, style)[:length]
    with jax.enable_x64(True):
        stream = Encoder(config, LIMITS, np.float64)
        pieces = [*stream.push(wrench), stream.peek()]
    assert_words_are_of_a_run_that_goes_on(wrench, pieces, options)


@pytest.mark.parametrize("style", ["ramps", "steps", "noise", "long evidence"])
def test_they_are_so_at_every_sample(style: str) -> None:
    """Also where more evidence is asked for than samples are kept."""
    config, options = (FitConfig(evidence=0.05), {"needed": 10}) if style == "long evidence" else (FitConfig(), {})
    wrench, published = wrench_of(1, style)[:60], []
    with jax.enable_x64(True):
        stream = Encoder(config, LIMITS, np.float64)
        for now in range(1, 61):
            published += stream.push(wrench[now - 1 : now])
            assert_words_are_of_a_run_that_goes_on(wrench[:now], [*published, stream.peek()], options)


@settings(max_examples=8)
@given(signal=signals)
def test_their_values_are_those_of_the_samples_received(signal: tuple[int, str, int]) -> None:
    seed, style, length = signal
    with jax.enable_x64(True):
        stream = Encoder(FitConfig(), LIMITS, np.float64)
        stream.push(wrench_of(seed, style)[:length])
        provisional, ended = stream.peek(), stream.ending()
    same = 0
    for one, other in zip(layers(provisional), layers(ended), strict=True):
        alike = (one.label > 0) & (other.label > 0) & (one.t0 == other.t0) & (one.t1 == other.t1)
        for field in ("vmax", "vmin", "avg", "grad"):
            np.testing.assert_allclose(getattr(one, field)[alike], getattr(other, field)[alike], atol=1e-9)
        same += alike.sum()
    assert same >= 3


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@settings(max_examples=8)
@given(signal=signals, cuts=st.lists(st.integers(0, 40), max_size=15))
def test_no_chunking_changes_them(dtype: type, signal: tuple[int, str, int], cuts: list[int]) -> None:
    seed, style, length = signal
    wrench = wrench_of(seed, style).astype(dtype)[:length]
    with jax.enable_x64(dtype == np.float64):
        stream, whole, start = Encoder(FitConfig(), LIMITS, dtype), Encoder(FitConfig(), LIMITS, dtype), 0
        for cut in [*cuts, length]:
            stream.push(wrench[start : start + cut])
            stream.peek()
            start = min(start + cut, length)
        whole.push(wrench)
        assert_trees_equal(stream.peek(), whole.peek())


def test_a_slope_is_told_before_it_leaves_the_tolerance_and_a_level_stays_level() -> None:
    for slope, label in ((5.0, "spos"), (0.0, "cons")):
        stream = WordIntrospector(FitConfig(), FitLimits(LIMITS.gradients[:1], np.array([0.1])), ["Fx"])
        stream.push(slope * 0.005 * np.arange(10)[:, None])
        assert [word.label for word in stream.provisional() if word.layer == "primitive"] == [label]
        assert [word.label for word in stream.finish() if word.layer == "primitive"] == ["cons"]  # level so far


def test_the_end_of_a_stream_publishes_what_has_come_not_what_may_come() -> None:
    stream = WordIntrospector(FitConfig(), LIMITS, AXES)
    wrench, different = wrench_of(2, "ramps"), 0
    for window in wrench[: 65 * 5].reshape(65, 5, 3):
        stream.push(window)
        shown, last = stream.provisional(), stream.finish()
        different += [word.code for word in shown] != [word.code for word in last]
    assert different > 5
    tracks = rj.encode(wrench[: 65 * 5], thresholds=LIMITS.gradients, rule="fit", tolerance=LIMITS.tolerance)
    for layer, track in zip(("primitive", "mc", "llb"), layers(tracks), strict=True):
        for axis, name in enumerate(AXES):
            said = [(word.code, word.begin, word.end) for word in last if (word.layer, word.axis) == (layer, name)]
            assert said == words(track, axis)[-len(said) :]


def test_a_run_is_named_at_0_11_s_and_when_older_after_the_evidence_that_is_missing() -> None:
    """Of a straight ramp that is level while it has less than 24 samples; nothing speaks for a break."""
    ramp = np.arange(40.0)[:, None] * TOLERANCE * np.sqrt(12 / (24**2 - 1))
    level, slope = Primitive.CONS, Primitive.SPOS
    for samples, label in ((1, level), (10, level), (21, level), (22, slope), (23, slope), (40, slope)):
        stream = Encoder(FitConfig(), LIMITS)
        stream.push(ramp[:samples])
        primitives = stream.peek().primitive
        assert [words(primitives, axis) for axis in range(3)] == [[(label, 0, samples)]] * 3


def test_a_stream_without_samples_has_no_provisional_words() -> None:
    stream = Encoder(FitConfig(), LIMITS)
    for _ in range(2):
        assert not any(track.label.any() for track in layers(stream.peek()))
        stream.push(np.ones((12, 3)))
        assert stream.peek().primitive.label.any()
        stream.flush()
