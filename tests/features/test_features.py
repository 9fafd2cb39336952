"""Features of label tracks, against an oracle that paints every sample with a label."""

from __future__ import annotations

import itertools
import json
import tracemalloc
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcbht_jax.errors import InputError
from rcbht_jax.features import FAMILIES, FeatureSpec, Intervals, concatenate_arms, interval_features, longest
from rcbht_jax.features.word_families import compressed
from rcbht_jax.labels import AXES, LAYER_SIZES, LAYERS, PRIMITIVE_GROUP
from rcbht_jax.types import LabelTrack, LabelTracks, TrackInfo

ALL = FeatureSpec(families=FAMILIES, slots=(7, 5, 3))


def make_track(rng: np.random.Generator, recordings: int, size: int, samples: int, dense: bool) -> LabelTrack:
    """Random spans that tile each record but for a few gaps; padding anywhere if dense."""
    slots = 12
    fields = {k: np.zeros((recordings, 6, slots)) for k in ("vmax", "vmin", "avg", "grad")}
    label, t0, t1 = (np.zeros((recordings, 6, slots), np.int32) for _ in range(3))
    for lane in np.ndindex(recordings, 6):
        count = int(rng.integers(1, 9))
        place = np.sort(rng.permutation(slots)[:count]) if dense else np.arange(count)
        edges = np.concatenate([[0], np.sort(rng.integers(0, samples + 1, count - 1)), [samples]])
        label[*lane, place] = rng.integers(1, size + 1, count)
        t0[*lane, place], t1[*lane, place] = edges[:-1], edges[1:]
        for name in fields:
            fields[name][*lane, place] = rng.normal(size=count) * 5
        drop = place[rng.random(count) < 0.1]
        for x in (label, t0, t1, *fields.values()):
            x[*lane, drop] = 0
    emit = np.full(label.shape, -1, np.int32)
    return LabelTrack(label=label.astype(np.int8), t0=t0, t1=t1, emit=emit, **fields)


def make_tracks(seed: int, recordings: int = 2, samples: int = 40, dense: bool = True) -> LabelTracks:
    rng = np.random.default_rng(seed)
    return LabelTracks(*(make_track(rng, recordings, size, samples, dense) for size in LAYER_SIZES))


def intervals(*rows: tuple[int, int, int]) -> Intervals:
    recording, start, end = np.array(rows, np.int32).reshape(-1, 3).T
    return Intervals(recording=recording, start=start, end=end, dt=0.5)


def spans(track: LabelTrack, lane: tuple[int, int], start: int, end: int) -> list[dict[str, float]]:
    """The clipped spans of one lane as plain dictionaries, in order."""
    out = []
    for slot in range(track.label.shape[-1]):
        at = (*lane, slot)
        t0, t1 = max(int(track.t0[at]), start), min(int(track.t1[at]), end)
        if track.label[at] > 0 and t1 > t0:
            values = {k: float(getattr(track, k)[at]) for k in ("vmax", "vmin", "avg", "grad")}
            middle = (int(track.t0[at]) + int(track.t1[at])) / 2 - start
            values |= {"middle": middle, "whole": int(track.t1[at]) - int(track.t0[at])}
            out.append({"label": int(track.label[at]), "t0": t0 - start, "t1": t1 - start, **values})
    return out


def painted(words: list[dict[str, float]], length: int, fine: int) -> list[int]:
    """One label per 1/fine sample."""
    paint = [0] * (length * fine)
    for w in words:
        for i in range(int(w["t0"]) * fine, int(w["t1"]) * fine):
            paint[i] = int(w["label"])
    return paint


def oracle_sentence(words: list[dict[str, float]], length: int, slots: int) -> list[int]:
    paint = painted(words, length, slots)  # slots * length ticks: a slot is `length` ticks
    out = []
    for k in range(slots):
        part = [x for x in paint[k * length : (k + 1) * length] if x > 0]
        out.append(min(set(part), key=lambda x: (-part.count(x), x)) if part else 0)
    return out


def column(made, name: str) -> np.ndarray:
    return made.values[:, made.names.index(name)]


def family_of(made, prefix: str) -> np.ndarray:
    keep = [i for i, n in enumerate(made.names) if n.startswith(prefix)]
    return made.values[:, keep]


sentences = st.tuples(st.integers(0, 1), st.integers(0, 39), st.integers(1, 40)).map(
    lambda x: (x[0], x[1], min(40, x[1] + x[2]))
)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.lists(sentences, min_size=1, max_size=4), st.booleans())
def test_sentence_histogram_and_bigrams_equal_painting(seed, rows, dense):
    tracks = make_tracks(seed, dense=dense)
    made = interval_features(tracks, intervals(*rows), ALL)
    for number, (recording, start, end) in enumerate(rows):
        for layer, size, slots in zip(LAYERS, LAYER_SIZES, ALL.slots, strict=True):
            words = spans(getattr(tracks, layer), (recording, 2), start, end)
            said = family_of(made, f"sentence.{layer}.Fz.")[number]
            assert said.tolist() == oracle_sentence(words, end - start, slots)
            paint = [x for x in painted(words, end - start, 1) if x > 0]
            time = [paint.count(c) / max(len(paint), 1) for c in range(1, size + 1)]
            np.testing.assert_allclose(family_of(made, f"histogram.{layer}.Fz.time")[number], time, atol=1e-6)
            codes = [int(w["label"]) for w in words]
            count = [codes.count(c) / max(len(codes), 1) for c in range(1, size + 1)]
            np.testing.assert_allclose(family_of(made, f"histogram.{layer}.Fz.count")[number], count, atol=1e-6)
            pairs = np.zeros((size, size))
            for a, b in itertools.pairwise(codes):
                pairs[a - 1, b - 1] += 1 / (len(codes) - 1)
            np.testing.assert_allclose(family_of(made, f"ngram.{layer}.Fz.")[number], pairs.ravel(), atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), sentences)
def test_durations_attributes_and_offsets_equal_plain_sums(seed, row):
    tracks = make_tracks(seed)
    made = interval_features(tracks, intervals(row), ALL)
    words = spans(tracks.primitive, (row[0], 4), row[1], row[2])

    def log(x):  # My: unit 0.01 Nm
        return np.sign(x) * np.log1p(abs(x) / 0.01)

    def mean(items, value):
        time = sum(w["t1"] - w["t0"] for w in items)
        return sum((w["t1"] - w["t0"]) * value(w) for w in items) / time if items else 0.0

    level = mean(words, lambda w: w["avg"])
    assert column(made, "offset.primitive.My.avg")[0] == pytest.approx(log(level), rel=1e-5, abs=1e-5)
    for group, name in enumerate(("p", "n", "k", "pimp", "nimp")):
        items = [w for w in words if PRIMITIVE_GROUP[int(w["label"])] == group]
        for what, value in {
            "attributes.primitive.My.amp": mean(items, lambda w: w["vmax"] - w["vmin"]),
            "attributes.primitive.My.grad": mean(items, lambda w: w["grad"]),
            "attributes.primitive.My.level": mean(items, lambda w: w["avg"] - level),
            "offset.primitive.My.avg": mean(items, lambda w: w["avg"]),
        }.items():
            # A difference of equal numbers may round to 1e-15, which the logarithm keeps small.
            assert column(made, f"{what}.{name}")[0] == pytest.approx(log(value), rel=1e-5, abs=1e-5)
    top = max((w["vmax"] for w in words), default=0) - min((w["vmin"] for w in words), default=0)
    assert column(made, "attributes.primitive.My.range")[0] == pytest.approx(log(top), rel=1e-5)
    bpos = [(w["t1"] - w["t0"]) * 0.5 for w in words if w["label"] == 1]
    assert column(made, "duration.primitive.My.mean.bpos")[0] == pytest.approx(np.mean(bpos) if bpos else 0)
    assert column(made, "duration.primitive.My.max.bpos")[0] == pytest.approx(max(bpos, default=0))
    assert column(made, "duration.total")[0] == pytest.approx((row[2] - row[1]) * 0.5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), sentences)
def test_weighed_words_and_runs_equal_plain_sums(seed, row):
    made_up = make_tracks(seed).mc
    track = replace(made_up, vmax=made_up.vmin + abs(made_up.vmax))
    weighing = ("change", "count", "time")
    spec = FeatureSpec(families=("histogram", "ngram"), layers=("mc",), weighing=weighing)
    made = interval_features(LabelTracks(track, track, track), intervals(row), spec)
    words, size = spans(track, (row[0], 1), row[1], row[2]), LAYER_SIZES[1]
    last = 0
    for kind in weighing:
        weight = {
            "count": lambda w: 1.0,
            "time": lambda w: w["t1"] - w["t0"],
            "change": lambda w: (w["vmax"] - w["vmin"]) * (w["t1"] - w["t0"]) / w["whole"],
        }[kind]
        shares, runs = np.zeros(size), np.zeros((size, size))
        for w in words:
            shares[w["label"] - 1] += weight(w)
        for a, b in itertools.pairwise(words):
            runs[a["label"] - 1, b["label"] - 1] += 1 if kind == "count" else weight(a) + weight(b)
        said = family_of(made, f"histogram.mc.Fy.{kind}.")[0]
        np.testing.assert_allclose(said, shares / max(shares.sum(), 1e-300), atol=1e-6)
        first = next(i for i, name in enumerate(made.names) if name.startswith("ngram.mc.Fy.")) + last
        assert ("." + kind in made.names[first]) == (kind != "count")
        np.testing.assert_allclose(
            made.values[0, first : first + size**2], runs.ravel() / max(runs.sum(), 1e-300), atol=1e-6
        )
        last += size**2


def test_weighings_of_the_default_and_those_that_make_no_sense():
    tracks, rows = make_tracks(4), intervals((0, 3, 31), (1, 0, 40))
    plain = interval_features(tracks, rows, FeatureSpec(families=("histogram", "ngram")))
    of_runs = interval_features(tracks, rows, FeatureSpec(families=("ngram",), weighing=("count",)))
    of_words = interval_features(tracks, rows, FeatureSpec(families=("histogram",), weighing=("time", "count")))
    for alone in (of_runs, of_words):
        columns = np.isin(plain.families, alone.families)
        assert tuple(np.array(plain.names)[columns]) == alone.names
        np.testing.assert_array_equal(plain.values[:, columns], alone.values)
    assert FeatureSpec.from_dict(json.loads(json.dumps(asdict(FeatureSpec(weighing=("time",)))))).weighing == ("time",)
    for options in ({"weighing": ("length",)}, {"weighing": ("time", "time")},
                    {"weighing": ("time",), "families": ("attributes",)}):  # fmt: skip
        with pytest.raises(InputError, match="weigh"):
            FeatureSpec(**options)


def one_lane(*words: tuple[int, int, int]) -> LabelTracks:
    """The same spans (label, t0, t1) on every axis and layer of one recording."""
    label, t0, t1 = (np.tile(np.array(x, np.int32), (1, 6, 1)) for x in zip(*words, strict=True))
    zero = np.zeros(label.shape)
    track = LabelTrack(label=label.astype(np.int8), t0=t0, t1=t1, emit=t1, vmax=zero, vmin=zero, avg=zero, grad=zero)
    return LabelTracks(track, track, track)


def test_a_tie_goes_to_the_smaller_code_and_a_gap_to_nobody():
    tracks = one_lane((5, 0, 2), (3, 2, 4), (7, 9, 10))
    spec = FeatureSpec(families=("sentence",), layers=("mc",), slots=(1, 5, 1))
    said = interval_features(tracks, intervals((0, 0, 4)), replace(spec, slots=(1, 1, 1)))
    assert said.values[0].tolist() == [3.0] * 6
    said = interval_features(tracks, intervals((0, 0, 10)), spec)
    assert said.values[0, :5].tolist() == [5, 3, 0, 0, 7]


def test_a_span_is_clipped_at_the_boundary():
    tracks = one_lane((1, 0, 10), (2, 10, 40))
    spec = FeatureSpec(families=("histogram",), layers=("llb",))
    made = interval_features(tracks, intervals((0, 8, 16)), spec)
    assert column(made, "histogram.llb.Fx.time.FX")[0] == 0.25
    assert column(made, "histogram.llb.Fx.time.CT")[0] == 0.75


def test_one_hot_says_the_same_as_codes():
    tracks = make_tracks(3)
    rows = intervals((0, 0, 40), (1, 5, 21))
    code = interval_features(tracks, rows, replace(ALL, families=("sentence",)))
    hot = interval_features(tracks, rows, replace(ALL, families=("sentence",), one_hot=True))
    at = 0
    for layer, size, slots in zip(LAYERS, LAYER_SIZES, ALL.slots, strict=True):
        block = hot.values[:, at : at + 6 * slots * size].reshape(2, 6 * slots, size)
        back = (block * np.arange(1, size + 1)).sum(-1)
        np.testing.assert_array_equal(back, family_of(code, f"sentence.{layer}."))
        at += 6 * slots * size
    assert at == hot.values.shape[1]


def test_chunks_of_sentences_do_not_change_the_features():
    tracks = make_tracks(5, recordings=3)
    rows = [(i % 3, i % 20, 20 + i % 17) for i in range(150)]
    together = interval_features(tracks, intervals(*rows), ALL).values
    alone = np.concatenate([interval_features(tracks, intervals(r), ALL).values for r in rows[::10]])
    np.testing.assert_array_equal(together[::10], alone)


def test_an_interval_costs_the_labels_that_it_holds():
    """Not those of its recording: memory, and so time, of 64 minutes of labels for every sentence."""
    rng, shape = np.random.default_rng(0), (1, 6, 20_000)
    length = rng.integers(0, 20, shape)  # some slots are empty
    t1 = length.cumsum(-1).astype(np.int32)
    label = np.where(length > 0, rng.integers(1, 7, shape), 0).astype(np.int8)
    fields = [*(rng.normal(size=shape).astype(np.float32) for _ in range(4))]
    track = LabelTrack(label, (t1 - length).astype(np.int32), t1, t1, *fields)
    rows = [(0, start, start + 400) for start in range(0, 64 * 2_000, 2_000)]
    spec = FeatureSpec(("histogram", "attributes"), ("primitive",))
    tracemalloc.start()
    found = interval_features(LabelTracks(track, track, track), intervals(*rows), spec).values
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6
    for row in (0, 30, 63):  # labels that overlap the interval, and no others
        near = (t1 > rows[row][1] - 50) & (t1 - length < rows[row][2] + 50)
        few = np.flatnonzero(near.any((0, 1)))
        cut = LabelTrack(*(getattr(track, name)[..., few] for name in track.__dataclass_fields__))
        alone = interval_features(LabelTracks(cut, cut, cut), intervals(rows[row]), spec).values
        np.testing.assert_array_equal(found[row], alone[0])


def test_dense_and_compact_tracks_give_the_same_features():
    tracks = make_tracks(8)

    def compact(track: LabelTrack) -> LabelTrack:
        order = np.argsort(track.label == 0, axis=-1, kind="stable")
        fields = ("label", "t0", "t1", "emit", "vmax", "vmin", "avg", "grad")
        return LabelTrack(**{k: np.take_along_axis(getattr(track, k), order, -1) for k in fields})

    packed = LabelTracks(*(compact(getattr(tracks, layer)) for layer in LAYERS))
    rows = intervals((0, 3, 30), (1, 0, 40))
    np.testing.assert_array_equal(
        interval_features(tracks, rows, ALL).values, interval_features(packed, rows, ALL).values
    )


def test_every_column_has_a_unique_name_a_family_and_a_meaning():
    made = interval_features(make_tracks(1), intervals((0, 0, 40)), ALL)
    assert len(set(made.names)) == made.values.shape[1] == len(made.families) == len(made.meanings)
    assert set(made.families) == set(FAMILIES)
    assert made.meanings[made.names.index("histogram.mc.Fz.time.pc")] == "Fz mc: share of the labelled time spent in pc"
    assert made.values.dtype == np.float32
    np.testing.assert_array_equal(made.values[0, made.names.index("duration.total")], 20.0)


def test_without_offset_and_duration_a_constant_bias_changes_nothing():
    tracks = make_tracks(4)

    def biased(track: LabelTrack) -> LabelTrack:
        return replace(track, avg=track.avg + 3, vmax=track.vmax + 3, vmin=track.vmin + 3)

    moved = LabelTracks(*(biased(getattr(tracks, layer)) for layer in LAYERS))
    rows = intervals((0, 0, 40), (1, 4, 22))
    spec = replace(ALL, families=("sentence", "histogram", "ngram", "attributes"))
    np.testing.assert_allclose(
        interval_features(tracks, rows, spec).values, interval_features(moved, rows, spec).values, atol=1e-5
    )
    spec = replace(ALL, families=("offset",))
    assert not np.allclose(
        interval_features(tracks, rows, spec).values, interval_features(moved, rows, spec).values, atol=1e-2
    )


def test_two_arms_stand_side_by_side():
    tracks = make_tracks(2)
    spec = FeatureSpec(families=("histogram",))
    right, left = (interval_features(tracks, intervals((arm, 0, 40)), spec) for arm in (0, 1))
    both = concatenate_arms({"R": right, "L": left})
    np.testing.assert_array_equal(both.values, np.concatenate([right.values, left.values], 1))
    assert both.names[0] == "R." + right.names[0]
    assert both.meanings[len(right.names)] == "left arm, " + left.meanings[0]
    with pytest.raises(InputError, match="one per trial"):
        concatenate_arms({"R": right, "L": interval_features(tracks, intervals((0, 0, 40), (1, 0, 40)), spec)})


def test_longest_counts_labels_inside_the_sentences_only():
    tracks = one_lane((1, 0, 10), (2, 10, 20), (3, 20, 30))
    assert longest(tracks, intervals((0, 0, 30))) == (3, 3, 3)
    assert longest(tracks, intervals((0, 10, 20), (0, 5, 15))) == (2, 2, 2)


def test_a_specification_survives_json():
    spec = FeatureSpec(families=("sentence", "ngram"), layers=("mc",), slots=(1, 2, 3), one_hot=True, ngram=3)
    assert FeatureSpec.from_dict(json.loads(json.dumps(asdict(spec)))) == spec


@pytest.mark.parametrize("row", [(0, 5, 5), (0, 6, 5), (0, -1, 5), (2, 0, 5), (-1, 0, 5)])
def test_bad_intervals_are_refused(row):
    with pytest.raises(InputError, match="interval"):
        interval_features(make_tracks(1), intervals(row), ALL)


def test_labels_of_another_rate_are_refused():
    tracks, row = make_tracks(1), intervals((0, 0, 40))
    rated = [replace(tracks, info=TrackInfo(rate, AXES)) for rate in (1 / row.dt, 1.005 / row.dt, 1.02 / row.dt)]
    for same in rated[:2]:
        np.testing.assert_array_equal(
            interval_features(same, row, ALL).values, interval_features(tracks, row, ALL).values
        )
    with pytest.raises(InputError, match=f"the intervals are of {1 / row.dt:g} Hz; encode with rate={1 / row.dt:g}"):
        interval_features(rated[2], row, ALL)


@pytest.mark.parametrize(
    "bad",
    [{"families": ("words",)}, {"layers": ()}, {"layers": ("llb", "mc", "llb")}, {"slots": (0, 1, 1)}, {"ngram": 4}],
)
def test_bad_specifications_are_refused(bad):
    with pytest.raises(InputError):
        FeatureSpec(**bad)


@pytest.mark.parametrize(("axes", "units"), [(6, [0.1] * 3 + [0.01] * 3), (1, [0.1]), (3, [0.1] * 3), (12, [0.1] * 12)])
def test_forces_and_moments_are_compressed_in_their_own_units_and_other_axes_as_forces(axes, units):
    x = np.random.default_rng(0).normal(size=(2, axes, 4)) * 10
    expected = [[np.sign(x[i, k]) * np.log(1 + abs(x[i, k]) / units[k]) for k in range(axes)] for i in range(2)]
    np.testing.assert_allclose(compressed(x), expected, rtol=1e-12)
