"""The frozen method: its file names its digest, every headline carries it, and sessions B and C did not choose it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sklearn.metrics import r2_score

from experiments._lib import frozen, intervals, streams
from experiments._lib.results_io import COMMITTED, committed
from experiments.classification import frozen_choice, headline
from experiments.classification.frozen_choice import CLOSE, OPTIONS, option_name
from experiments.online import causal, detected_starts, frozen_stream_choice, table2
from experiments.tables.headline import SHORT
from rcbht_jax import StateClassifier
from rcbht_jax.errors import InputError
from rcbht_jax.features import ABSOLUTE, Features
from rcbht_jax.features.online import names
from rcbht_jax.introspection.training import Snapshots
from rcbht_jax.learning import metrics
from rcbht_jax.learning.scaling import KNOTS
from rcbht_jax.learning.svm import DEGREE, Grid
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.types import Recordings
from tests.support.blank_trials import blank_trials

README = Path(__file__).resolve().parents[2] / "README.md"
TRIALS, STATE, DT, SEED = 16, 60, 0.005, 3  # STATE: samples in each of the four states
COLUMNS = "9b3e5ecce241"  # of the families, when the headlines were made
FAST = {"kernels": ["linear"], "costs": [1.0], "scalings": [True], "inner": 2}


def without_digest(text: str, digest: str) -> list[str]:
    """Rows of a page's table of results that do not carry a digest."""
    table = re.split(r"<!-- table (?:all-)?results:", text)[1].split("<!-- end of table -->")[0]
    rows = [line for line in table.splitlines() if line.startswith("| ")][2:]
    assert len(rows) >= 10
    return [row for row in rows if f"[{digest[:SHORT]}](" not in row]


def test_every_headline_carries_the_frozen_digest() -> None:
    text, digest = README.read_text(encoding="utf-8"), frozen.load().sha256
    whole = (README.parent / "docs" / "evaluation.md").read_text(encoding="utf-8")
    assert not without_digest(whole, digest)
    assert not without_digest(text, digest)
    assert len(without_digest(text.replace(f"[{digest[:SHORT]}](", "[0123456789ab](", 1), digest)) == 1
    made = [row["method"] for name, row in committed("headline")["rows"].items() if " | frozen" in name]
    for name in ("causal", "zero_shot_stream"):
        made += [row["method"] for row in committed(name)["rows"].values() if "method" in row]
    made += [row["method"] for row in committed("zero_shot")["rows"].values()]
    assert set(made) == {digest}


def test_results_of_the_headline_are_strict_json_and_whole() -> None:
    for name in ("headline", "causal", "zero_shot", "zero_shot_stream", "frozen_choice", "frozen_stream_choice"):
        text = (COMMITTED / f"{name}.json").read_text(encoding="utf-8")
        assert json.loads(text, parse_constant=pytest.fail)["result"]["complete"]


def test_a_changed_method_is_refused(tmp_path: Path) -> None:
    record = json.loads(frozen.FILE.read_text(encoding="utf-8"), parse_constant=pytest.fail)
    path = tmp_path / "method.json"
    path.write_text(json.dumps(record, indent=3))  # layout does not matter
    assert frozen.load(path).sha256 == frozen.load().sha256
    record["method"]["grid"]["costs"][0] *= 2
    path.write_text(json.dumps(record))
    with pytest.raises(InputError, match="was changed"):
        frozen.load(path)
    for text in ("{", "[1]", '{"method": {}}', '{"method": NaN, "sha256": ""}'):
        path.write_text(text)
        with pytest.raises(InputError, match="no frozen method"):
            frozen.load(path)
    with pytest.raises(InputError, match="no frozen method"):
        frozen.load(tmp_path / "none.json")


def test_the_frozen_method_is_the_one_that_its_rule_chooses() -> None:
    rows, method = committed("frozen_choice")["rows"], frozen.load().content
    best = max(row["mean"] for row in rows.values())
    close = [option for option in OPTIONS if rows[option_name(*option)]["mean"] >= best - CLOSE]
    grammars, families = min(close, key=lambda option: len(option[0]) * len(option[1]))
    assert [one["name"] for one in method["grammars"]] == list(grammars)
    assert [one["encoders"] for one in method["grammars"]] == [list(frozen_choice.GRAMMARS[name]) for name in grammars]
    assert [one["families"] for one in method["features"]] == [list(frozen_choice.FAMILIES[name]) for name in families]
    streams = committed("frozen_stream_choice")["rows"]
    beliefs = {(option, belief): score["mean"] for option, row in streams.items() for belief, score in row.items()}
    option, belief = max(beliefs, key=lambda key: beliefs[key])
    assert method["streamed"] == json.loads(json.dumps(frozen_stream_choice.streamed(option, belief)))


def test_no_session_but_a_chooses(monkeypatch: pytest.MonkeyPatch) -> None:
    source = np.array([frozen_choice.SIM1, frozen_choice.FAILURES, *["other"] * (TRIALS - 2)])
    session = np.array(["SIM1", "SIM1F", *"ABC", *["B"] * (TRIALS - 5)])
    known = replace(blank_trials(TRIALS, STATE, DT), source=source, session=session)
    monkeypatch.setattr(frozen_choice, "recorded", lambda: known)
    assert set(frozen_choice.Experiment().recordings.session) == {"SIM1", "SIM1F", "A"}
    assert set(frozen_stream_choice.permitted(known).session) == {"SIM1", "A"}


def test_relative_features_know_neither_offset_nor_duration() -> None:
    method = frozen.load()
    specs = [*method.relative.values(), *(method.stream_spec(head, True) for head in ("state", "phase"))]
    assert all(not {*ABSOLUTE, "duration", "elapsed"} & set(spec.families) for spec in specs)
    assert len({spec.families for spec in method.relative.values()}) == len(method.relative)
    assert all("duration" not in spec.families for spec in method.specs.values())


def test_the_method_is_what_its_file_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the digest does not hold, because it is code: limits of the preset, columns of the families."""
    method = frozen.load()
    np.testing.assert_allclose(method.thresholds("W20 fine").limits[2], np.array([70.0, 46.0, 23.0, 1.0]) / 16)
    np.testing.assert_allclose(method.thresholds("W5").limits[4], [7.0, 4.6, 2.3, 0.1])
    assert all(spec.balance for spec in method.specs.values())
    columns = {name: names(spec) for name, spec in method.specs.items()}
    columns |= {head: names(method.stream_spec(head)) for head in ("state", "phase")}
    assert frozen.digest(columns)[:SHORT] == COLUMNS
    assert (KNOTS, DEGREE) == (21, 3)

    monkeypatch.setattr(frozen, "encode_batch", lambda config, made, *data: (config.window, float(made.limits[2, 3])))
    made = method.grammars(blank_trials(2, STATE, DT))
    assert made == {"preset and fine": {"W5": (5, 1.0), "W20 fine": (20, 1 / 16), "W20 finer": (20, 1 / 256)}}


def test_candidates_keep_their_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    method, items = frozen.load(), labelled_intervals(blank_trials(2, STATE, DT), TaskSpec())
    part = Features(np.zeros((len(items.y), 2), np.float32), ("a", "b"), ("levels", "histogram"), ("", ""))
    monkeypatch.setattr(frozen, "candidates", lambda *given: {"one": (part, part.weights(method.specs["untimed"]))})
    monkeypatch.setattr(frozen, "nested_svm", lambda matrices, y, trial, grid, weights: (grid, weights))
    grid, weights = method.learner({}, items)
    assert (grid.ranks, list(grid.costs)) == (True, method.content["grid"]["costs"])
    assert weights["one"] is not None


def test_the_choice_looks_at_training_rows_only(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, trials = np.random.default_rng(0), 12
    items = labelled_intervals(blank_trials(trials, STATE, DT), TaskSpec())
    x = rng.normal(size=(len(items.y), 2)) + 2 * items.y[:, None]
    train, test = (np.flatnonzero(np.isin(items.trial, names)) for names in np.split(np.unique(items.trial), 2))
    asked = []
    chosen = frozen_choice.select

    def noting(matrices, y, *rest):
        asked.append((matrices[""], y))
        return chosen(matrices, y, *rest)

    monkeypatch.setattr(frozen_choice, "select", noting)
    answer = partial(frozen_choice.Experiment.answer, None, x, None, split=(train, test), seed=0)
    inner, said = answer(items)
    np.testing.assert_array_equal(asked[0][0], x[train])
    swapped = items.y.copy()
    swapped[test] = 3 - swapped[test]
    again, same = answer(replace(items, y=swapped))
    assert inner == again
    np.testing.assert_array_equal(said, same)


def test_trials_with_a_mistake_are_noted() -> None:
    items = labelled_intervals(blank_trials(4, STATE, DT), TaskSpec())
    wrong: set[str] = set()
    learn = headline.noting(lambda train, test, seed: (np.where(test == 5, -1, items.y[test]), {}), items, wrong)
    learn(np.arange(4), np.arange(4, 16), 0)
    assert wrong == {items.trial[5]}


def test_the_method_describes_classifies_and_names_its_choice() -> None:
    rng = np.random.default_rng(0)
    wrench = rng.normal(0, 0.01, (12, 200, 6)).astype(np.float32)
    wrench[6:, :, 2] += np.linspace(0, 20, 200)
    data = Recordings.from_arrays(wrench, outcome=["success"] * 6 + ["failure"] * 6)
    content = frozen.load().content  # with one of its encoders: each takes seconds to compile
    one = {"encoders": {"W5": content["encoders"]["W5"]}, "grammars": [{"name": "preset", "encoders": ["W5"]}]}
    method = frozen.FrozenMethod({**content, **one})
    items = labelled_intervals(data, TaskSpec("outcome"))
    learner = method.learner(method.grammars(data), items)
    train, test = np.arange(0, 12, 2), np.arange(1, 12, 2)
    predicted, choice = learner(train, test, 0)
    assert predicted.tolist() == items.y[test].tolist()
    assert choice["cost"] == min(method.grid.costs)  # a tie goes to the first kernel and the smallest cost
    assert choice["kernel"] == method.grid.kernels[0]
    classifier = StateClassifier(rate=1 / data.dt, **method.description()).fit(wrench[train], items.y[train])
    assert classifier.score(wrench[test], items.y[test]) == 1


def test_intervals_have_a_width() -> None:
    assert metrics.wilson(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    sure = intervals.with_width({"mean": 1.0, "low": 1.0, "high": 1.0}, 35)
    assert (sure["low"], sure["high"]) == (pytest.approx(35 / (35 + 1.96**2)), 1.0)
    assert intervals.with_width({"mean": 0.5, "low": 0.4, "high": 0.6}, 35)["low"] == 0.4
    assert metrics.rule_of_three(2) == 1
    for name, row in committed("headline")["rows"].items():
        assert row["score"]["low"] < row["score"]["high"], name
        assert ("trials with a mistake, at most" in row) == (row["trials with a mistake"] == 0)


class Spoilt(causal.Stream):
    """A stream whose features are noise and the present state, but not numbers where nobody may read them."""

    inside: np.ndarray

    def described(self, snapshots: Snapshots, head: str) -> np.ndarray:
        columns = len(names(self.method.stream_spec(head)))
        x = np.random.default_rng(0).normal(size=(len(snapshots), columns)).astype(np.float32)
        state = np.minimum((snapshots.now - 1) // STATE, 3)
        return x + 3 * (np.arange(columns) % 4 == state[:, None])

    def x(self, which: str) -> np.ndarray:
        snapshots = {"regular": self.regular, "trial": self.trial, "training": self.training}.get(which)
        snapshots = causal.since_trial_start(self.training) if snapshots is None else snapshots
        hidden = self.inside[snapshots.interval] == (which in ("regular", "trial"))
        values = self.described(snapshots, "phase" if which.startswith("trial") else "state")
        return np.where(hidden[:, None], np.nan, values)


@pytest.fixture
def stream() -> Spoilt:
    part = {"families": ["levels", "spread"], "balance": True, "grid": FAST, "ends": 1}
    streamed = {"encoder": "W5", "rate": 10.0, "belief": "phase", "state": part, "phase": part}
    content = {**frozen_stream_choice.ENCODER, "thresholds": "hiro", "streamed": streamed}
    made = Spoilt(frozen.FrozenMethod(content), blank_trials(TRIALS, STATE, DT))
    made.inside = causal.inside_of(made, (), SEED)
    return made


def test_a_stream_trains_on_one_side_and_is_scored_on_the_other(stream: Spoilt) -> None:
    assert isinstance(stream.method.stream_learning("state")[0], Grid)
    assert causal.given_starts(stream, False, stream.inside, SEED)["macro step accuracy"] > 0.8
    beliefs = causal.unaided(stream, False, stream.inside, SEED)
    assert set(beliefs) == {"phase", "filter", "state"}
    assert beliefs["phase"]["macro step accuracy"] > 0.6


def test_halves_never_divide_a_trial(stream: Spoilt) -> None:
    trial = stream.items.trial
    assert all(len(set(stream.inside[trial == one].tolist())) == 1 for one in trial)
    assert stream.inside.sum() == len(trial) / 2
    assert not np.array_equal(stream.inside, streams.halves(stream.items, SEED + 1))


@pytest.mark.parametrize("relative", [False, True])
def test_table2_trains_on_one_half_and_scores_the_other(stream: Spoilt, relative: bool) -> None:
    result = table2.repeat(stream, relative, SEED)
    probability, y_true = result[table2.WHOLE]
    assert np.isfinite(probability).all()
    np.testing.assert_array_equal(y_true, stream.items.y[~stream.inside])
    assert result["full-sequence accuracy"] > 0.8
    assert result["confusion of full sequences"].trace() == result["full-sequence accuracy"] * len(y_true)
    assert (result["seconds to lasting confidence at .70"] >= 0).all()


def test_detected_beginnings_are_scored_on_the_half_that_is_streamed(stream: Spoilt) -> None:
    result = detected_starts.repeat(stream, SEED)
    assert len(result["errors"]) == TRIALS / 2
    assert result["macro step accuracy, given"] > 0.8
    assert result["macro step accuracy, phase alone"] > 0.6


def test_counting_told_beginnings_is_enough_and_time_alone_is_not(stream: Spoilt) -> None:
    assert causal.counted(stream, stream.inside) == dict.fromkeys(causal.MEASURES, 1.0)
    alone = causal.little(stream, stream.inside, SEED, from_trial=False, wrench=False)
    assert alone["macro step accuracy"] < 0.5  # all states last equally long
    since_start = causal.little(stream, stream.inside, SEED, from_trial=True, wrench=False)
    assert since_start["macro step accuracy"] == 1


def test_r2_of_drawn_trials_is_that_of_their_steps() -> None:
    rng, trial = np.random.default_rng(0), np.repeat(np.arange(6), 5)
    true = rng.normal(size=30)
    predicted = true + 0.3 * rng.normal(size=30)
    drawn = np.array([[1] * 6, [2, 0, 1, 1, 1, 1]])
    rows = np.concatenate([np.flatnonzero(trial == one) for one in (0, 0, 2, 3, 4, 5)])
    expected = [r2_score(true, predicted), r2_score(true[rows], predicted[rows])]
    np.testing.assert_allclose(causal.drawn_r2(true, predicted, trial, drawn), expected)
