"""rcbht calibrate end to end on a small store; the file of thresholds, and what happens to broken ones."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcbht_jax as rj
from rcbht_jax._util import compile_cache
from rcbht_jax.calibration import contextual, sample, search
from rcbht_jax.calibration.rest import auto_thresholds
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.limit_files import read_limits, taken_from_start, write_limits
from rcbht_jax.encoding.thresholds import GradientThresholds, preset, read_thresholds, write_thresholds
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from rcbht_jax.introspection import training
from rcbht_jax.introspection.model import load
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.learning.tasks import TaskSpec
from tests.calibration.test_contextual import recordings
from tests.support.snaps import marked


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("calibrate") / "small.zarr"
    write_recordings(path, recordings(trials=4), {})
    return path


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("context", ["--own-axes", "--robot", "hiro"]),
        ("search", ["--candidates", "2", "--generations", "0", "--devices", "all"]),
        ("gradient", ["--steps", "2", "--devices", "1"]),
    ],
)
def test_calibrated_thresholds_label_a_store(store, tmp_path, rcbht, method, options):
    out, figure = tmp_path / f"{method}.json", tmp_path / "thresholds.png"
    plot = ["--plot", str(figure)] if method == "context" else []
    said = rcbht.json("calibrate", store, "-o", out, "--method", method, *options, *plot)
    thresholds, provenance = read_thresholds(out)
    np.testing.assert_allclose(thresholds.limits, said["limits"])
    assert provenance["method"] == method
    assert provenance["trial_names"] == ["t0", "t1", "t2", "t3"]
    assert provenance["config"]["window"] == 5
    assert figure.exists() == bool(plot)
    assert said["value"] == pytest.approx(said["scores"]["accuracy"] + said["scores"]["fit"] - said["rest_penalty"])
    if method == "search":
        assert said["value"] >= said["preset_value"] - 1e-5
    rcbht("encode", store, "--thresholds", out)
    _, attrs = read_tracks(store, f"online-W5-{method}")
    np.testing.assert_allclose(attrs["thresholds"], said["limits"])
    assert attrs["thresholds_from"]["method"] == method


def test_axes_without_grades_are_named_also_where_rest_is_the_cause(store, tmp_path, monkeypatch, rcbht):
    """The sentence blamed the rotation alone."""
    steep = contextual.calibrate
    monkeypatch.setattr(contextual, "calibrate", lambda *what, **more: steep(*what[:-1], 1e3, **more))  # N/s at rest
    words = ["--method", "context", "--robot", "hiro"]
    named = "Insertion is hardly steeper than rotation or rest, so all limits are one: Fx, Fy, Fz, Mx, My, Mz."
    assert named in rcbht("calibrate", store, "-o", tmp_path / "one.json", *words).splitlines()
    provenance = read_thresholds(tmp_path / "one.json")[1]
    assert provenance["trials_per_limit"] == {"impulse": [4] * 6, "constant": [4] * 6}


@pytest.mark.parametrize("boundaries", ["harmonised", "recorded"])
def test_the_context_reads_the_boundaries_that_are_asked_for(tmp_path, boundaries, rcbht):
    some, out = recordings(trials=4), tmp_path / "context.json"
    late = marked(some, onset=some.starts("states-harmonised") + 0.25)
    write_recordings(tmp_path / "late.zarr", late, {})
    words = ["--method", "context", "--robot", "hiro", "--rest-weight", "0", "--boundaries", boundaries]
    rcbht("calibrate", tmp_path / "late.zarr", "-o", out, *words)
    expected = contextual.calibrate(late, np.arange(4), EncoderConfig(dt=late.dt), boundaries=boundaries)
    np.testing.assert_allclose(read_thresholds(out)[0].limits, expected.thresholds.limits)


def test_a_search_is_not_scored_again(store, tmp_path, monkeypatch, rcbht):
    """Two more candidates are a program of their own, which takes long to compile; the scores are there already."""
    scored, score = [], search.score_candidates
    monkeypatch.setattr(search, "score_candidates", lambda *a, **k: scored.append((a, score(*a, **k))) or scored[-1][1])
    caches: list[Path] = []
    monkeypatch.setattr(compile_cache, "use", caches.append)
    words = ["--method", "search", "--candidates", "4", "--generations", "0", "--robot", "hiro"]
    words += ["-o", tmp_path / "found.json", "--compile-cache", tmp_path]
    said = rcbht.json("calibrate", store, *words)
    ((data, config, _), _), *more = scored
    assert not more
    assert caches == [tmp_path]
    for thresholds, name in ((preset(), "preset_scores"), (read_thresholds(tmp_path / "found.json")[0], "scores")):
        again = score(data, config, GradientThresholds(np.asarray(thresholds.limits)[None]))[0]
        assert dict(zip(search.SCORES, again.tolist(), strict=True)) == said[name]


@pytest.mark.parametrize(
    ("method", "options"),
    [("rest", []), ("search", ["--candidates", "2", "--generations", "0"]), ("gradient", ["--steps", "1"])],
)
def test_the_fit_rule_is_calibrated_with_its_tolerance(store, tmp_path, rcbht, method, options):
    out = tmp_path / f"fit-{method}.json"
    words = ["calibrate", str(store), "-o", str(out), "--rule", "fit", "--method", method, *options, "--json"]
    said = json.loads(rcbht(*words))
    limits, provenance = read_limits(out)
    np.testing.assert_allclose(limits.gradients, said["limits"])
    np.testing.assert_allclose(limits.tolerance, said["tolerance"])
    assert provenance["method"] == method
    assert said["rule"] == "fit"
    if method == "rest":
        assert min(said["rest_constant"].values()) >= 0.95
    else:
        assert provenance["config"]["rule"] == "fit"
    if method == "search":
        assert said["value"] >= said["preset_value"] - 1e-5
    rcbht("encode", store, "--rule", "fit", "--thresholds", out)
    _, attrs = read_tracks(store, f"online-W5-fit-fit-{method}")
    np.testing.assert_allclose(attrs["thresholds"], said["limits"])
    np.testing.assert_allclose(attrs["config"]["tolerance"], said["tolerance"])
    assert "--rule fit" in rcbht.refused("encode", store, "--thresholds", out)


def test_limits_of_the_fit_rule_go_wherever_limits_go(store, tmp_path, rcbht):
    limits, path = FitLimits(preset().limits * 0.7, np.linspace(0.1, 0.6, 6)), tmp_path / "fit.json"
    write_limits(path, limits, {"method": "hand"})
    model, name = tmp_path / "m.model", str(tmp_path / "events.jsonl")
    fit = ["--rule", "fit", "--thresholds", str(path)]
    rcbht("train-online", store, "-o", model, *fit)
    encoding = load(model)
    np.testing.assert_array_equal(encoding.limits.tolerance, limits.tolerance)
    np.testing.assert_array_equal(encoding.limits.gradients, limits.gradients)
    rcbht("stream", store, "--trial", "t0", "--speed", "0", "-o", name, *fit)
    streamed = {
        event["label"] for line in Path(name).read_text().splitlines() if "label" in (event := json.loads(line))
    }
    assert streamed
    quick = ["--candidates", "2", "--generations", "0", "--rest-weight", "0"]
    rcbht("calibrate", store, "-o", tmp_path / "next.json", "--method", "search", *fit, *quick)
    for command in (["train-online", str(store), "-o", str(model)], ["stream", str(store), "--trial", "t0"]):
        assert "belong to the fit rule" in rcbht.refused(*command, "--thresholds", path)
    wrench = read_recordings(store).wrench[0]
    ours = rj.encode(wrench, rule="fit", thresholds=limits)
    other = rj.encode(wrench, rule="fit", thresholds=limits, tolerance=0.9)
    assert (ours.primitive.label > 0).sum() > (other.primitive.label > 0).sum()
    with pytest.raises(InputError, match="fit rule"):
        rj.encode(wrench, thresholds=limits)
    features = rj.WrenchFeatures(rule="fit", thresholds=limits).fit(wrench[None])
    np.testing.assert_array_equal(features.tolerance_, limits.tolerance)


def test_devices_that_are_not_there_or_not_used_are_refused(store, tmp_path, rcbht):
    for method, devices, sentence in (("search", "9", "expected at most 1"), ("rest", "all", "search or gradient")):
        words = ["calibrate", str(store), "-o", str(tmp_path / "no.json"), "--method", method, "--devices", devices]
        assert sentence in rcbht.refused(*words)
    assert not (tmp_path / "no.json").exists()


def test_a_file_of_the_fit_rule_is_read_by_axis_and_refused_where_it_cannot_be_used(tmp_path):
    limits, path = FitLimits(preset().limits * 0.7, np.linspace(0.1, 0.6, 6)), tmp_path / "fit.json"
    write_limits(path, limits, {"seed": 1})
    found, provenance = read_limits(path, ("Mz", "Fx"))
    np.testing.assert_array_equal(found.tolerance, limits.tolerance[[5, 0]])
    np.testing.assert_array_equal(found.gradients, limits.gradients[[5, 0]])
    assert provenance == {"seed": 1}
    assert taken_from_start("fit", "hiro", path) == []
    with pytest.raises(InputError, match="fit rule"):
        read_thresholds(path)
    content = json.loads(path.read_text())
    content["limits"]["Fz"]["tolerance"] = -1
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="positive"):
        read_limits(path)
    del content["limits"]["Fz"]["tolerance"]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="is not a file of thresholds"):
        read_limits(path)
    write_limits(path, preset(), {})
    assert taken_from_start("fit", "hiro", path) == ["tolerances"]
    np.testing.assert_array_equal(read_limits(path)[0].limits, preset().limits)


def calibrated(folder, rcbht, importer, calm, other, *words):
    """What a search says of the source "calm" where it shares a store with others, and where it is alone."""
    said = []
    for name, parts in (("both", [calm, other]), ("calm", [calm])):
        write_recordings(folder / f"{name}.zarr", rj.Recordings.join(parts), importer)
        options = ["--source", "calm", "--generations", "0", *words]
        said.append(rcbht.json("calibrate", folder / f"{name}.zarr", "-o", folder / f"{name}.json", *options))
    return said


def test_the_objective_counts_rest_and_trials_of_other_sources_teach_nothing(tmp_path, rcbht):
    calm = replace(recordings(trials=4), source=np.full(4, "calm"))
    noise = np.random.default_rng(0).normal(0, 5, calm.wrench.shape)
    shaken = replace(calm, source=np.full(4, "shaken"), wrench=(calm.wrench + noise).astype(np.float32))
    both, alone = calibrated(tmp_path, rcbht, {"importer": "hiro"}, calm, shaken, "--candidates", "4")
    assert both["preset_rest_penalty"] == alone["preset_rest_penalty"]
    assert both["limits"] == alone["limits"]


def test_thresholds_of_an_unknown_robot_come_from_the_chosen_trials_alone(tmp_path, rcbht):
    calm = replace(recordings(trials=4), source=np.full(4, "calm"))
    strong = replace(calm, source=np.full(4, "strong"), wrench=calm.wrench * np.float32(64))
    both, alone = calibrated(tmp_path, rcbht, {}, calm, strong, "--candidates", "2")
    assert both["limits"] == alone["limits"]
    assert both["preset_value"] == alone["preset_value"]


@pytest.mark.parametrize("others", [{"source": np.full(2, "strong")}, {"arm": np.full(2, "L")}])
def test_a_model_for_streams_of_an_unknown_robot_takes_thresholds_from_what_it_learns(
    tmp_path, monkeypatch, others, rcbht
):
    """Those of the other arm, which it does not learn, counted as well."""
    calm = replace(recordings(trials=2), source=np.full(2, "calm"))
    strong = replace(calm, wrench=calm.wrench * np.float32(64), **others)
    write_recordings(tmp_path / "both.zarr", rj.Recordings.join([calm, strong]), {})
    seen = []

    def train(recordings, specs, config, limits, *rest):
        seen.append(limits)
        raise InputError("seen")

    monkeypatch.setattr(training, "train_model", train)
    rcbht.refused("train-online", tmp_path / "both.zarr", "--source", "calm", "-o", tmp_path / "m")
    np.testing.assert_array_equal(seen[0].limits, auto_thresholds(calm).limits)


def test_the_context_of_an_unknown_robot_is_labelled_by_its_own_thresholds(tmp_path, rcbht):
    made = recordings(trials=4)
    limits = []
    for name, scale in (("newton", 1.0), ("milli", 1024.0)):
        store, start, out = (tmp_path / f"{name}{end}" for end in (".zarr", "-start.json", ".json"))
        write_recordings(store, replace(made, wrench=made.wrench * np.float32(scale)), {})
        write_thresholds(start, preset().limits * scale, {})
        words = ["--method", "context", "--thresholds", str(start), "--rest-weight", "0", "--json"]
        limits.append(np.array(json.loads(rcbht("calibrate", store, "-o", out, *words))["limits"]) / scale)
    np.testing.assert_allclose(*limits, rtol=1e-6)
    named = replace(made, axes=("a", "b", "c", "d", "e", "f"), units=("",) * 6)
    write_recordings(tmp_path / "named.zarr", named, {})
    error = rcbht.refused("calibrate", tmp_path / "named.zarr", "-o", out, "--method", "context")
    assert "for the axes Fx, Fy, Fz, Mx, My, Mz, not for a, b" in error


def test_a_sample_of_all_chosen_trials_is_no_part(store, monkeypatch):
    monkeypatch.setattr(sample, "SAMPLE_BYTES", 0)
    assert sample.read_sample(store, TaskSpec("states")).trials == 4
    row = 4 * 6 * read_recordings(store).wrench.shape[1]
    monkeypatch.setattr(sample, "SAMPLE_BYTES", 2 * row)
    some = TaskSpec("states", sources=(str(read_recordings(store).source[0]),))
    chosen = np.flatnonzero(read_recordings(store).source == some.sources[0])
    assert sample.read_sample(store, some).trials == (None if len(chosen) <= 2 else len(chosen))


@pytest.mark.parametrize(("groups", "numbers"), [("axis", range(6)), ("kind", [0, 1, 1, 0, 0, 1]), ("all", [0] * 6)])
def test_groups_of_a_search_go_by_units(tmp_path, monkeypatch, groups, numbers, rcbht):
    mixed = {"Mz": "Nm", "Fx": "N", "Fz": "N", "Mx": "Nm", "My": "Nm", "Fy": "N"}
    made = rj.Recordings.from_arrays(
        np.random.default_rng(0).normal(size=(4, 200, 6)), 200,
        axes=list(mixed), units=list(mixed.values()), tool=["a", "b"] * 2,
    )  # fmt: skip
    write_recordings(tmp_path / "s.zarr", made, {})
    seen = []

    def look(data, config, options, **_):
        seen.append(options.space.groups)
        raise InputError("seen")

    monkeypatch.setattr(search, "search", look)
    words = ["--groups", groups, "--task", "tool", "-o", str(tmp_path / "x.json")]
    rcbht.refused("calibrate", tmp_path / "s.zarr", *words)
    assert seen == [tuple(numbers)]


@pytest.mark.parametrize("axes", [1, 9])
def test_other_than_six_axes_are_refused_by_methods_of_classes(tmp_path, rcbht, axes):
    wrench = np.random.default_rng(0).normal(size=(4, 200, axes))
    names = [f"c{number}" for number in range(axes)]
    made = rj.Recordings.from_arrays(wrench, 200, axes=names, tool=["a", "b"] * 2)
    write_recordings(tmp_path / "s.zarr", made, {})
    words = ["--method", "search", "--task", "tool", "-o", str(tmp_path / "x.json")]
    assert f"on the 6 axes of a wrench, not on {axes}" in rcbht.refused("calibrate", tmp_path / "s.zarr", *words)


def test_wrong_calls_end_with_one_sentence(store, tmp_path, rcbht):
    for words, expected in (
        (["-o", str(tmp_path / "no" / "x.json")], "is not a folder"),
        (["-o", str(tmp_path / "x.json"), "--session", "Q"], "no recording has the session Q"),
        (["-o", str(tmp_path / "x.json"), "--rungs", "0.5"], "increase to 1"),
        *((["-o", str(tmp_path / "x.json"), f"--rest-weight={wrong}"], "0 or more") for wrong in ("-1", "nan", "inf")),
        (["-o", str(tmp_path / "x.json"), "--rule", "fit", "--method", "context"], "paper's rule"),
        (["-o", str(tmp_path / "x.json"), "--rule", "fit", "--plot", "x.png"], "leave it out"),
        (["-o", str(tmp_path / "x.json"), "--plot", "x.txt"], "x.txt does not end in .png"),  # not after the search
        (["-o", str(tmp_path / "x.json"), "--tolerance", "0.1"], "--rule fit"),
        (["-o", str(tmp_path / "x.json"), "--rule", "fit", "--method", "rest", "--tolerance", "1"], "leave out"),
        (["-o", str(tmp_path / "x.json"), "--method", "rest", "--plot", "x.png"], "--plot is for --method context or"),
        (["-o", str(tmp_path / "x.json"), "--method", "gradient", "--checkpoint", "x.json"], "for --method search;"),
    ):
        assert expected in rcbht.refused("calibrate", store, *words)
    assert not (tmp_path / "x.json").exists()
    assert "does not exist" in rcbht.refused("encode", store, "--thresholds", tmp_path / "x.json")


def test_thresholds_survive_the_file_to_the_last_bit(tmp_path):
    limits = np.sort(np.random.default_rng(0).random((6, 4)) + 1e-3)[:, ::-1] / 3
    write_thresholds(tmp_path / "t.json", GradientThresholds(limits), {"seed": 1})
    thresholds, provenance = read_thresholds(tmp_path / "t.json")
    np.testing.assert_array_equal(thresholds.limits, limits)
    assert provenance == {"seed": 1}
    with pytest.raises(InputError, match=r"\[6, 4\]"):
        write_thresholds(tmp_path / "t.json", GradientThresholds(limits[:3]), {})


def test_limits_out_of_order_are_refused(tmp_path):
    path = tmp_path / "t.json"
    write_thresholds(path, preset(), {})
    content = json.loads(path.read_text())
    content["limits"]["Fz"]["small"] = 1e6
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="ordered"):
        read_thresholds(path)


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        ("1", "small of Fz is '1', no finite number"),
        (True, "small of Fz is 'True', no finite number"),
        (None, "small of Fz is 'None', no finite number"),
        (1e-300, "1.2e-38 to 3.4e38"),
        (1e-40, "1.2e-38 to 3.4e38"),
    ],
)
def test_limits_that_are_no_numbers_of_single_precision_are_refused(store, tmp_path, rcbht, value, sentence):
    path, fit = tmp_path / "t.json", tmp_path / "fit.json"
    write_thresholds(path, preset(), {})
    write_limits(fit, FitLimits(preset().limits, np.ones(6)), {})
    content = json.loads(path.read_text())
    content["limits"]["Fz"]["small"] = value
    path.write_text(json.dumps(content))
    content = json.loads(fit.read_text())
    content["limits"]["Fz"]["tolerance"] = 1e300 if isinstance(value, float) else value
    fit.write_text(json.dumps(content))
    for words in ([str(path)], [str(fit), "--rule", "fit"]):
        error = rcbht.refused("encode", store, "--thresholds", *words)
        assert sentence.replace("small", "tolerance" if "fit" in words else "small") in error
        assert "Warning" not in error


@given(
    st.one_of(
        st.binary(max_size=60),
        st.recursive(
            st.none() | st.floats() | st.text(max_size=5) | st.sampled_from(["rcbht-thresholds", 1]),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(st.sampled_from(["format", "format_version", "limits", "provenance", "Fx"]), inner)
            ),
            max_leaves=8,
        ).map(lambda value: json.dumps(value).encode()),
    )
)
def test_any_other_content_is_one_sentence(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("fuzz") / "t.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"t\.json"):
        read_thresholds(path)
