"""Search for thresholds: times per label against the encoder, scores against plain refits, resumption, leakage."""

from __future__ import annotations

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sklearn.metrics import mutual_info_score

from rcbht_jax._util import cma
from rcbht_jax.annotations import Annotations
from rcbht_jax.calibration import contextual, gradient
from rcbht_jax.calibration import search as searching
from rcbht_jax.calibration.dataset import CalibrationData, calibration_data, device_calibration_data
from rcbht_jax.calibration.gradient import GradientOptions
from rcbht_jax.calibration.label_durations import fit_windows, label_durations
from rcbht_jax.calibration.objective import RIDGE, SCORES, Objective, scores, shares
from rcbht_jax.calibration.rest import RestSlopes
from rcbht_jax.calibration.search import SearchOptions, SearchSpace, score_candidates, search
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import GradientThresholds, preset
from rcbht_jax.errors import InputError
from rcbht_jax.features.spans import Intervals, clip, weighted_counts
from rcbht_jax.labels import LAYER_SIZES, LAYERS
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings

CONFIG = EncoderConfig(window=5, dt=0.005)
LENGTHS = np.array([403, 250, 361, 402], np.int32)  # partial windows of 3, 0, 1 and 2 samples
ACCURACY = Objective(accuracy=1.0, fit=0.0)
SMALL = SearchOptions(candidates=6, generations=2, population=4, space=SearchSpace(groups=(0, 0, 0, 1, 1, 1)))


def random_limits() -> np.ndarray:
    rng = np.random.default_rng(0)
    limits = np.sort(np.exp(rng.uniform(np.log(0.5), np.log(150), (4, 6, 4))), -1)[..., ::-1]
    return limits * np.where(np.arange(6) < 3, 1, 0.1)[:, None]


@pytest.fixture(scope="module")
def wrench() -> np.ndarray:
    """Quiet and busy stretches, so that every layer has long and short labels."""
    rng = np.random.default_rng(3)
    busy = np.repeat(rng.choice([0.003, 0.05, 0.6], (4, 41, 6)), 10, axis=1)[:, :410]
    walk = np.cumsum(rng.normal(size=(4, 410, 6)) * busy, axis=1)
    return (walk * np.where(np.arange(6) < 3, 1, 0.1)).astype(np.float32)


@pytest.fixture(scope="module")
def made(wrench) -> CalibrationData:
    edges = np.array([[0, 100, 101, 300, n] for n in LENGTHS], np.int32)
    edges[1] = [5, 50, 60, 200, 245]  # does not cover its recording
    y = np.tile(np.arange(4, dtype=np.int32), (4, 1))
    return CalibrationData(
        wrench, fit_windows(CONFIG, wrench, LENGTHS), edges, y, tuple("abcd"), np.array(list("wxyz"))
    )


def times_by_grammar(wrench: np.ndarray, edges: np.ndarray, limits: np.ndarray) -> np.ndarray:
    tracks = encode_batch(CONFIG, GradientThresholds(limits.astype(np.float32)), wrench, LENGTHS)
    rows = np.repeat(np.arange(4), 4)
    spans = Intervals(rows, edges[:, :-1].ravel(), edges[:, 1:].ravel(), CONFIG.dt)
    parts = []
    for layer, size in zip(LAYERS, LAYER_SIZES, strict=True):
        (words,) = clip(getattr(tracks, layer), spans, layer, len(spans))
        parts.append(weighted_counts(words.code, words.duration, size))
    return np.concatenate(parts, -1).reshape(4, 4, 6, -1)


@pytest.mark.parametrize("group", [1, 3])
def test_times_per_label_are_those_of_the_published_tracks(wrench, made, group):
    limits = random_limits()
    times = label_durations(
        CONFIG, jnp.asarray(limits, jnp.float32), made.windows, jnp.asarray(made.edges), group=group
    )
    for candidate, one in enumerate(limits):
        np.testing.assert_array_equal(times[candidate], times_by_grammar(wrench, made.edges, one))


def test_left_out_accuracy_and_fit_equal_refits(made):
    rng = np.random.default_rng(0)
    times = jnp.asarray(rng.integers(0, 50, (1, 9, 3, 6, 25)), jnp.int32)
    y = rng.integers(0, 3, (9, 3))
    x = np.sqrt(np.asarray(shares(times[0].reshape(27, 6, 25)), np.float64))
    x = np.concatenate([x - x.mean(0), np.ones((27, 1))], 1)
    target = np.eye(3)[y.ravel()]
    penalty = RIDGE * 27 * np.diag([1.0] * 150 + [1e-3])
    error = np.zeros_like(target)
    for trial in range(9):
        out = np.arange(27) // 3 == trial
        weights = np.linalg.solve(x[~out].T @ x[~out] + penalty, x[~out].T @ target[~out])
        error[out] = target[out] - x[out] @ weights
    right = ((target - error).argmax(1) == y.ravel()).mean()
    fit = 1 - np.square(error).sum() / np.square(target - target.mean(0)).sum()
    np.testing.assert_allclose(scores(times, y, 3)[0, :2], [right, fit], atol=2e-4)


def test_scores_do_not_depend_on_the_other_candidates():
    rng = np.random.default_rng(1)
    times = jnp.asarray(rng.integers(0, 50, (70, 5, 2, 6, 25)), jnp.int32)
    y = np.tile(np.arange(2), (5, 1))
    together = scores(times, y, 2)
    alone = np.concatenate([scores(times[i : i + 1], y, 2) for i in (0, 3, 69)])
    np.testing.assert_array_equal(together[[0, 3, 69]], alone)


def test_scores_of_separation_are_those_of_their_definitions() -> None:
    rng = np.random.default_rng(2)
    times = rng.integers(1, 50, (9, 3, 6, 25)) * (rng.random((9, 3, 6, 25)) < 0.15)
    y = rng.integers(0, 3, (9, 3))
    layers = [part / np.maximum(part.sum(-1, keepdims=True), 1) for part in np.split(times, [9, 17], axis=-1)]
    x, label = np.concatenate(layers, -1).reshape(27, 150), y.ravel()
    means = np.stack([x[label == c].mean(0) for c in range(3)])[label]
    fisher = np.square(means - x.mean(0)).sum() / np.square(x - x.mean(0)).sum()
    entropy = mutual_info_score(label, label)
    levels = np.round(3 * x).astype(int).T
    information = np.mean([mutual_info_score(label, level) for level in levels]) / entropy
    agreement = np.minimum(x, means).sum() / x.sum()
    made = scores(jnp.asarray(times[None], jnp.int32), y, 3)[0]
    np.testing.assert_allclose(made[2:], [fisher, information, agreement], rtol=1e-4)


def test_cma_finds_the_maximum_of_a_tilted_bowl():
    target = np.array([0.3, 0.6, 0.45])
    state = cma.CubeCma(cma.start(np.full(3, 0.5), 0.2))
    for _ in range(60):
        points = state.sample(12, seed=4)
        off = points - target
        state = state.update(points, -np.square(off @ np.array([[1, 0.9, 0], [0, 1, 0], [0, 0, 10]])).sum(1))
    np.testing.assert_allclose(state.mean, target, atol=1e-3)


def test_space_keeps_limits_ordered_and_finds_the_way_back():
    space = SearchSpace(groups=(0, 0, 0, 1, 1, 1))
    limits = space.thresholds(np.random.default_rng(0).random((50, space.dimensions))).limits
    assert (np.diff(limits, axis=-1) <= 0).all()
    assert (limits >= space.base_limits[:, 3:] * space.low * (1 - 1e-9)).all()
    assert (limits <= space.base_limits[:, :1] * space.high * (1 + 1e-9)).all()
    base = space.thresholds(space.point(space.base)[None]).limits[0]
    np.testing.assert_allclose(base, space.base_limits, rtol=1e-9)


def test_search_does_not_depend_on_the_chunk_and_starts_with_the_base(made):
    whole = search(made, CONFIG, SMALL, chunk=8)
    pieces = search(made, CONFIG, SMALL, chunk=4)
    np.testing.assert_array_equal(whole.thresholds.limits, pieces.thresholds.limits)
    assert [h[2] for h in whole.history] == [h[2] for h in pieces.history]
    base = score_candidates(made, CONFIG, preset().limits[None], chunk=4)[0]
    assert whole.start_value == pytest.approx(float(base @ SMALL.objective.weights()), abs=1e-6)
    assert whole.value >= whole.start_value
    assert whole.evaluations == 6 + 2 * 4


def test_interrupted_search_resumes_to_the_same_result(made, tmp_path):
    whole = search(made, CONFIG, SMALL, chunk=4)
    checkpoint = tmp_path / "search.json"
    for limit in (4, 10):  # in the middle of the Sobol points, then of CMA-ES
        done = 0

        def stop(count: int, limit: int = limit) -> None:
            nonlocal done
            done += count
            if done >= limit:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            search(made, CONFIG, SMALL, chunk=4, checkpoint=checkpoint, progress=stop)
    resumed = search(made, CONFIG, SMALL, chunk=4, checkpoint=checkpoint)
    np.testing.assert_array_equal(whole.thresholds.limits, resumed.thresholds.limits)
    assert whole.scores == resumed.scores
    kept = json.loads(checkpoint.read_text())
    for wrong in ("abc", 3, [["x"]], [[1, 2], [3]], [[1.0] * 3] * 5, {"a": 1}):
        damaged = tmp_path / "damaged.json"
        damaged.write_text(json.dumps({**kept, "content": wrong}))
        with pytest.raises(InputError, match="no scores of a search"):
            search(made, CONFIG, SMALL, checkpoint=damaged)
    older = tmp_path / "older.json"
    older.write_text(json.dumps({**kept, "made_by": {**kept["made_by"], "version": "0.1"}}))
    with pytest.raises(InputError, match=r'version "0\.1", not "'):
        search(made, CONFIG, SMALL, checkpoint=older)
    with pytest.raises(InputError, match="other data or options"):
        search(made.take(np.array([0, 1, 2])), CONFIG, SMALL, checkpoint=checkpoint)
    checkpoint.write_bytes(checkpoint.read_bytes()[:100])
    with pytest.raises(InputError, match="damaged"):
        search(made, CONFIG, SMALL, checkpoint=checkpoint)


def test_successive_halving_scores_survivors_on_all_trials(made):
    options = SearchOptions(candidates=8, rungs=(0.5, 1.0), keep=0.25, space=SMALL.space)
    found = search(made, CONFIG, options, chunk=4)
    assert found.evaluations in (8 + 2, 8 + 3)  # two survivors, and the base if it is not one of them
    alone = score_candidates(made, CONFIG, found.thresholds.limits[None], chunk=4)[0]
    assert found.value == pytest.approx(float(alone @ options.objective.weights()), abs=1e-6)


class Judge:
    """In place of the encoder: scores of limits by their distance from some; it notes what it is asked about."""

    def __init__(self, steps: float = 0.0) -> None:
        self.asked: list[tuple[list[str], np.ndarray]] = []
        self.steps = steps  # added from one candidate to the next

    def __call__(self, data, config, thresholds, progress=None, **_) -> np.ndarray:
        self.asked.append((data.trial.tolist(), thresholds.limits))
        out = np.zeros((len(thresholds.limits), len(SCORES)), np.float32)
        out[:, 0] = self.value(thresholds.limits) if self.steps == 0 else 0.5 + self.steps * np.arange(len(out))
        progress(0, out)
        return out

    @staticmethod
    def value(limits: np.ndarray) -> np.ndarray:
        return 1 / (1 + np.abs(np.log(limits[:, 0, 1] / 10)))


@pytest.mark.parametrize(("rung", "trials"), [(0.5, 2), (0.1, 2), (0.75, 3)])
def test_the_best_by_some_trials_and_the_base_are_scored_on_all(made, monkeypatch, rung, trials):
    judge, options = Judge(), SearchOptions(candidates=11, rungs=(rung, 1.0), keep=0.3, seed=4, objective=ACCURACY)
    monkeypatch.setattr(searching, "score_candidates", judge)
    found = search(made, CONFIG, options)
    (some, first), (every, second) = judge.asked
    assert some == sorted(made.trial[np.random.default_rng(4).permutation(4)[:trials]])
    assert every == made.trial.tolist()
    values = judge.value(first)
    best = np.argsort(-values)[:3]
    assert 0 not in best  # else the case shows nothing
    np.testing.assert_array_equal(second, first[[0, *np.sort(best)]])
    np.testing.assert_allclose(first[0], preset().limits, rtol=1e-9)
    np.testing.assert_array_equal(found.thresholds.limits, first[values.argmax()])
    assert (found.value, found.start_value) == pytest.approx((values.max(), values[0]), abs=1e-6)


@pytest.mark.parametrize("groups", [(0, 0, 0, 1, 1, 1), (0,) * 6])
def test_the_base_is_scored_as_it_is_though_its_axes_differ_within_a_group(made, monkeypatch, groups):
    judge = Judge(steps=-0.1)
    monkeypatch.setattr(searching, "score_candidates", judge)
    base = GradientThresholds(np.geomspace(*np.array([[90, 5, 480, 2, 40, 9], [3, 2, 0.1, 1, 0.2, 0.5]]), 4, axis=1))
    found = search(made, CONFIG, SearchOptions(SearchSpace(base, groups), candidates=4, objective=ACCURACY))
    np.testing.assert_array_equal(judge.asked[0][1][0], base.limits)
    np.testing.assert_array_equal(found.thresholds.limits, base.limits)


@pytest.mark.parametrize("seed", [0, 3])
def test_generations_are_drawn_around_the_best_point_with_the_seed(made, monkeypatch, seed):
    judge = Judge()
    options = SearchOptions(candidates=8, generations=2, population=5, sigma=0.05, seed=seed, objective=ACCURACY)
    monkeypatch.setattr(searching, "score_candidates", judge)
    found = search(made, CONFIG, options)
    points = options.points()
    state = cma.CubeCma(cma.start(points[judge.value(judge.asked[0][1]).argmax()], 0.05))
    for _, limits in judge.asked[1:]:
        points = state.sample(5, seed)
        np.testing.assert_allclose(limits, options.space.thresholds(points).limits, rtol=1e-9)
        state = state.update(points, judge.value(limits).round(6))
    assert found.value == pytest.approx(max(judge.value(limits).max() for _, limits in judge.asked), abs=1e-6)


@pytest.mark.parametrize("steps", [1e-7, -1e-7])
def test_ties_go_to_the_candidate_evaluated_first(made, monkeypatch, steps):
    """Also where values differ beyond the sixth digit."""
    monkeypatch.setattr(searching, "score_candidates", Judge(steps))
    found = search(made, CONFIG, replace(SMALL, objective=ACCURACY))
    np.testing.assert_allclose(found.thresholds.limits, preset().limits, rtol=1e-9)


def test_a_point_is_the_mean_of_its_group_within_the_space():
    space = SearchSpace(groups=(0, 0, 0, 1, 1, 1))
    some = np.random.default_rng(1).random((6, 4))
    limits = np.exp(np.log(space.base_limits[:, 3:] * space.low) + np.sort(some)[:, ::-1] * np.log(
        space.base_limits[:, :1] * space.high / (space.base_limits[:, 3:] * space.low)
    ))  # fmt: skip
    expected = np.sort(some)[:, ::-1].reshape(2, 3, 4).mean(1).ravel()
    np.testing.assert_allclose(space.point(GradientThresholds(limits)), expected, rtol=1e-9)
    for factor, place in ((1e-9, 0), (1e9, 1)):
        np.testing.assert_array_equal(space.point(GradientThresholds(space.base_limits * factor)), place)


def test_times_of_a_chunk_of_candidates_fit_the_memory_limit(made, monkeypatch):
    for trials in (1, 2000, 5000):
        data = made.take(np.zeros(trials, int))
        chunk, each = searching._chunk("cpu", data), 4 * 150 * data.y.size  # int32 per sentence, axis and label
        assert chunk == 1 or chunk * each <= 2**28
        assert chunk == 128 or 2 * chunk * each > 2**28
    sizes = list[int]()
    monkeypatch.setitem(searching._MOST, "cpu", 2 * 4 * 150 * made.y.size)
    monkeypatch.setattr(searching, "label_durations", lambda _, some, *_a, **_k: sizes.append(len(some)) or some)
    monkeypatch.setattr(searching, "scores", lambda some, *_: np.zeros((len(some), len(SCORES)), np.float32))
    score_candidates(made, CONFIG, random_limits())
    assert sizes == [2, 2]


def test_trials_on_the_device_are_searched_like_any_others_and_nothing_is_copied(wrench, made):
    whole = made.edges.copy()
    whole[:, -1] = LENGTHS
    corpus = CalibrationData(wrench, made.windows, whole, made.y, made.classes, made.trial)
    beyond = np.where(np.arange(wrench.shape[1])[:, None] < LENGTHS[:, None, None], wrench, np.nan)  # must not matter
    arrays = jax.device_put((beyond, whole, made.y))
    with jax.transfer_guard("disallow"):
        there = device_calibration_data(CONFIG, *arrays, made.classes)
        found = search(there, CONFIG, SMALL)
        values = score_candidates(there, CONFIG, random_limits(), chunk=4, group=1)
    np.testing.assert_allclose(values, score_candidates(corpus, CONFIG, random_limits(), chunk=4), atol=2e-5)
    np.testing.assert_allclose(found.thresholds.limits, search(corpus, CONFIG, SMALL).thresholds.limits)


def test_a_score_may_have_the_weight_zero() -> None:
    assert Objective.of({"fisher": 2.0, "fit": 0.0}) == Objective(accuracy=0.0, fit=0.0, fisher=2.0)
    with pytest.raises(InputError, match="positive weights"):
        Objective.of({"fisher": 0.0, "fit": -1.0})


def test_errors_are_sentences(made):
    with pytest.raises(InputError, match="positive weights"):
        Objective.of({"speed": 1.0})
    with pytest.raises(InputError, match="six numbers"):
        SearchSpace(groups=(0, 0, 0, 0, 0, 7))
    with pytest.raises(InputError, match="order"):
        SearchSpace(GradientThresholds(preset().limits[:, ::-1]))
    for rungs in ((0.5,), (0.0, 1.0), (0.5, 0.5, 1.0)):
        with pytest.raises(InputError, match="increase to 1"):
            SearchOptions(rungs=rungs)
    for wrong in ({"keep": 0.0}, {"keep": 1.1}, {"population": 3}, {"candidates": 0}, {"generations": -1}):
        with pytest.raises(InputError, match="expected at least"):
            SearchOptions(**wrong)
    SearchOptions(keep=1.0, population=4, candidates=1)
    one = CalibrationData(made.wrench, made.windows, made.edges, np.zeros_like(made.y), ("a",), made.trial)
    with pytest.raises(InputError, match="two classes"):
        search(one, CONFIG, SMALL)
    # the only trial of its class is in no smaller rung
    last = np.random.default_rng(SMALL.seed).permutation(len(made))[-1]
    rare = replace(one, y=np.where(np.arange(len(made)) == last, 1, 0)[:, None] + one.y, classes=("a", "b"))
    with pytest.raises(InputError, match="have a single class"):
        search(rare, CONFIG, replace(SMALL, rungs=(0.5, 1.0)))


def test_every_method_raises_the_constant_limit_to_that_of_rest(made):
    rest = RestSlopes(np.full((6, 4), 3.0), weight=10.0)
    base = GradientThresholds(np.tile([40.0, 20.0, 5.0, 0.5], (6, 1)))
    options = replace(SMALL, space=SearchSpace(base, (0,) * 6), candidates=16, generations=0)
    free, held = (np.asarray(search(made, CONFIG, options, rest=way).thresholds.limits) for way in (None, rest))
    assert (free[:, 3] < 3).all()  # else the case shows nothing
    assert (held[:, 3] >= 3).all()
    quick = GradientOptions(steps=8, rate=0.2, loss="fit")
    assert (gradient.calibrate(made, CONFIG, base, quick, rest=rest).thresholds.limits[:, 3] > 1).all()
    missing = np.full((1, 6), np.nan)
    assert (contextual.combine(missing, missing, base, least=3.0).thresholds.limits[:, 3] == 3).all()


def test_intervals_that_do_not_fit_together_are_refused():
    """One recording's would become another's, and time between two the first one's."""
    marks = [("a", 0, 100), ("b", 100, 200), ("a", 0, 100), ("b", 100, 200), ("b", 200, 300)]
    owner = [0, 0, 1, 1, 1]

    def data(which: list[int]) -> CalibrationData:
        recordings = Recordings.from_arrays(np.ones((2, 300, 6)), rate=200)
        rows = [(owner[k], "t", marks[k][0], marks[k][1] / 200, marks[k][2] / 200) for k in which]
        annotations = Annotations.from_rows(rows)
        recordings = replace(recordings, annotations=annotations)
        return calibration_data(recordings, labelled_intervals(recordings, TaskSpec("t")), CONFIG)

    assert data([0, 1, 2, 3]).edges.tolist() == [[0, 100, 200]] * 2
    with pytest.raises(InputError, match="same number"):
        data([0, 2, 3, 4])
    with pytest.raises(InputError, match="follow each other"):
        data([0, 1, 2, 4])


def test_a_checkpoint_belongs_to_one_penalty_of_rest(made, tmp_path):
    """It decides which candidates go on."""
    checkpoint, steep = tmp_path / "scores.json", np.full((6, 4), 0.1)
    search(made, CONFIG, SMALL, checkpoint=checkpoint, rest=RestSlopes(steep, 1.0))
    search(made, CONFIG, SMALL, checkpoint=checkpoint, rest=RestSlopes(steep, 1.0))
    other_base = replace(SMALL, space=SearchSpace(GradientThresholds(2 * preset().limits), SMALL.space.groups))
    with pytest.raises(InputError, match="other data or options"):
        search(made, CONFIG, other_base, checkpoint=checkpoint, rest=RestSlopes(steep, 1.0))
    for other in (None, RestSlopes(steep, 5.0), RestSlopes(2 * steep, 1.0)):
        with pytest.raises(InputError, match="other data or options"):
            search(made, CONFIG, SMALL, checkpoint=checkpoint, rest=other)
