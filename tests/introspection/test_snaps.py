"""Snaps on words: the step against brute force, chunks, what is no snap, and the commands that report them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import rcbht_jax as rj
from rcbht_jax.cli.main import main
from rcbht_jax.encoding.stream import Encoder
from rcbht_jax.errors import InputError
from rcbht_jax.events import Snap
from rcbht_jax.introspection.snap_rule import SnapConfig
from rcbht_jax.introspection.snaps import SnapDetector
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.types import Recordings
from tests.support.snap_oracle import Line, Said, snaps

RATE, AXES, LEAST = 200.0, ("a", "b", "c"), 3.0
SECONDS = np.arange(1000) / RATE


def detector(**options: object) -> SnapDetector:
    """The same axes everywhere, so that the encoder is compiled once."""
    return SnapDetector(RATE, AXES, LEAST, **options)  # type: ignore[arg-type]


def wide(force: NDArray[np.floating]) -> NDArray[np.floating]:
    """One force on the first axis; the others rest."""
    return np.stack([force, 0 * force, 0 * force], 1)


def released(fall: float = 6.0, seconds: float = 0.04) -> NDArray[np.floating]:
    """A load of 9 N that is built up in two seconds and falls at 4 s."""
    return np.interp(SECONDS, [1, 3, 4, 4 + seconds], [0, 9, 9, 9 - fall])


def rough(seed: int) -> NDArray[np.floating]:
    """Ramps, plateaus, falls and noise on three axes, either way from zero."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in AXES:
        steps = rng.choice([2, 5, 8, 12, 30, 80], 60)
        heights = np.cumsum(rng.choice([-7.0, -4.0, -1.0, 0.0, 0.0, 2.0, 5.0], 60))
        ends = np.concatenate([[0], np.cumsum(steps)])
        out.append(np.interp(np.arange(700), ends, np.concatenate([[0.0], heights - heights.mean()])))
    return np.stack(out, 1) + rng.normal(0, 0.05, (700, 3))


def by_brute_force(samples: NDArray[np.floating], config: SnapConfig, high: float) -> list[list[Said]]:
    """What the oracle says of each axis, from the words of the encoder."""
    subject = detector(load=(0.0, high), config=config)
    encoder = Encoder(subject._words, subject._limits)
    rows: list[list[tuple[Line | None, Line]]] = [[] for _ in AXES]
    for words, runs in encoder.lines(samples):
        for number in range(len(words[0])):
            for axis, row in enumerate(rows):
                word, run = (_line(*(field[number, axis].item() for field in lines)) for lines in (words, runs))
                row.append((word if word[1] else None, run))
    return [list(snaps(config, subject.dt, (LEAST, np.inf, 0.0, high), row)) for row in rows]


def _line(t0: int, t1: int, mean: float, slope: float) -> Line:
    half = slope * (t1 - t0 - 1) / 2
    return t0, t1, mean - half, mean + half


@pytest.mark.parametrize(("share", "high"), [(0.75, 10.0), (1.5, np.inf)])
def test_the_step_equals_brute_force_over_all_words(share: float, high: float) -> None:
    told = 0
    for seed in (0, 1):
        samples, config = rough(seed), SnapConfig(share=share)
        events = detector(load=(0.0, high), config=config).push(samples)
        for axis, said in zip(AXES, by_brute_force(samples, config, high), strict=True):
            mine = [
                (e.sample, e.begin, e.published is not None, round(e.seen * RATE)) for e in events if e.axis == axis
            ]
            assert mine == [(s.sample, s.begin, s.published, s.seen) for s in said]
        told += len(events)
    assert told > 4


def test_events_do_not_depend_on_how_samples_are_cut() -> None:
    samples, rng = rough(9), np.random.default_rng(0)
    whole = detector().push(samples)
    subject, cut = detector(), []
    begin = 0
    while begin < len(samples):
        end = begin + int(rng.integers(1, 40))
        cut += subject.push(samples[begin:end])
        begin = end
    assert cut == whole
    assert len(whole) > 3
    subject.reset()
    assert subject.push(samples) == whole


def test_a_release_is_seen_at_once_and_published_with_its_size() -> None:
    seen, published = detector().push(wide(released()))
    assert seen.axis == published.axis == "a"
    assert seen.start == pytest.approx(4.0, abs=0.01)
    assert seen.seen == seen.time <= 4.05
    assert seen.published is None
    assert published.published == published.time <= 4.1
    assert published.seen == seen.seen
    assert published.release == pytest.approx(9.0, abs=0.1)
    assert 5.0 <= published.fall <= 6.1


def test_a_small_fall_between_a_push_and_a_stop_is_a_snap() -> None:
    """The push rises by more than it falls, in many times the time, and the stop follows within 15 ms."""
    stopped = np.interp(SECONDS, [3.5, 4.0, 4.015, 4.03, 4.1], [0.0, 20.0, 16.5, 17.0, 35.0])
    assert detector().push(wide(stopped))[0].start == pytest.approx(4.0, abs=0.01)


def test_a_negative_load_and_stamps_of_the_source() -> None:
    first = detector().push(wide(-released()), time=1e6)[0]
    assert first.release == pytest.approx(-9.0, abs=0.1)
    assert first.start == pytest.approx(1e6 - 1.0, abs=0.01)


@pytest.mark.parametrize(
    "force",
    [
        released(fall=2.5),  # too small
        released(seconds=0.3),  # too slow
        9 - released(),  # builds up: nothing is released
        np.where(SECONDS > 2, 10 + 14 * np.exp(-SECONDS + 2) * np.sin(14.7 * (SECONDS - 2)), 0.0),  # a ringing
        np.interp(SECONDS, [2, 2.02, 2.04], [0, 9, 0]),  # an impact
        released(fall=6.0) + 20,  # beyond the load
    ],
)
def test_what_is_no_snap(force: NDArray[np.floating]) -> None:
    assert detector(load=(2.0, 15.0)).push(wide(force)) == []


def test_noise_alone_is_no_snap() -> None:
    rng = np.random.default_rng(1)
    loads = np.array([0.0, 8.0, -20.0])
    quiet = loads + rng.normal(0, LEAST / 10, (2000, 3))  # 10 s on three axes; as large as the tolerance
    assert detector().push(quiet) == []


def test_after_a_snap_the_axis_is_quiet_for_a_while() -> None:
    twice = released() - np.interp(SECONDS, [4.14, 4.18], [0, 6]) + np.interp(SECONDS, [4.06, 4.12], [0, 6])
    again = released() - np.interp(SECONDS, [4.85, 4.89], [0, 6]) + np.interp(SECONDS, [4.1, 4.6], [0, 6])
    for force, count in ((twice, 1), (again, 2)):
        assert len({event.seen for event in detector().push(wide(force))}) == count


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"rate": 0.0}, "rate"),
        ({"least": 0.0}, "least is 0.0"),
        ({"least": 3.0, "most": 2.0}, "expected 0 < least <= most"),
        ({"least": [1.0, 2.0]}, "one for each of 1 axes"),
        ({"load": (5.0, 2.0)}, "load 5.0 to 2.0"),
        ({"rate": 12.5}, "A snap falls within 40 ms, which is less than a sample at 12.5 Hz"),
    ],
)
def test_sizes_that_mean_nothing_are_refused(options: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        SnapDetector(**{"rate": RATE, "axes": ["Fz"], "least": 1.0, **options})  # type: ignore[arg-type]
    with pytest.raises(InputError, match="within"):
        SnapConfig(within=0.0)


def test_together_merges_events_by_sample_and_refuses_other_axes() -> None:
    words = WordIntrospector(rj.EncoderConfig(), rj.preset("hiro", AXES), AXES, ["N"] * 3)
    both = Together(words, readers=[detector()])
    events = both.push(wide(released()))
    assert [event.sample for event in events] == sorted(event.sample for event in events)
    assert sum(isinstance(event, Snap) for event in events) == 2
    assert both.received == 1000
    both.reset()
    assert both.received == 0
    with pytest.raises(InputError, match="The detector needs the axes Fy; the stream has a, b, c"):
        Together(words, readers=[SnapDetector(RATE, ["Fy"], LEAST)])
    slow = WordIntrospector(rj.EncoderConfig(dt=0.01), rj.preset("hiro", AXES), AXES, ["N"] * 3)
    with pytest.raises(InputError, match="100 Hz; the model reads"):
        Together(words, slow)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("snaps") / "grip.zarr"
    one = Recordings.from_arrays([wide(released())], RATE, axes=AXES, units=["N"] * 3)
    write_recordings(path, one, {})
    return path


def test_stream_reports_snaps_on_request(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    limits = ["--robot", "hiro", "--starts", "none"]
    assert main(["stream", str(store), "--snap", f"a={LEAST:g}", f"b={LEAST:g}", f"c={LEAST:g}", *limits]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    snapped = [event for event in events if event["event"] == "Snap"]
    assert [event["published"] is None for event in snapped] == [True, False]
    assert main(["stream", str(store), "--snap", "z=3", *limits]) == 2
    assert "The detector needs the axes z; the stream has a, b, c." in capsys.readouterr().err
    for wrong in ("a", "a=", "a=1,2,3", "=3", "a=much"):
        assert main(["stream", str(store), "--snap", wrong, *limits]) == 2
        assert "expected AXIS=LEAST" in capsys.readouterr().err


def test_describe_tells_of_snaps(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = str(read_recordings(store).trial[0])
    assert main(["describe", str(store), name]) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "snap" in line)
    assert "4.00 s  snap: a lets go" in line
    assert "seen at 4.0" in line
    assert "published at 4.0" in line
