"""rcbht calibrate end to end on a small store; the file of thresholds, and what happens to broken ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcbht_jax.cli.main import main
from rcbht_jax.encoding.thresholds import GradientThresholds, preset, read_thresholds, write_thresholds
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import write_recordings
from tests.calibration.test_contextual import recordings


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("calibrate") / "small.zarr"
    write_recordings(path, recordings(trials=4), {})
    return path


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("context", ["--own-axes"]),
        ("search", ["--candidates", "2", "--generations", "0"]),
        ("gradient", ["--steps", "2"]),
    ],
)
def test_calibrated_thresholds_label_a_store(store, tmp_path, capsys, method, options):
    out, figure = tmp_path / f"{method}.json", tmp_path / "thresholds.png"
    plot = ["--plot", str(figure)] if method == "context" else []
    assert main(["calibrate", str(store), "-o", str(out), "--method", method, *options, *plot, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    thresholds, provenance = read_thresholds(out)
    np.testing.assert_allclose(thresholds.limits, said["limits"])
    assert provenance["method"] == method
    assert provenance["trial_names"] == ["t0", "t1", "t2", "t3"]
    assert provenance["config"]["window"] == 5
    assert figure.exists() == bool(plot)
    if method == "search":
        assert said["value"] >= said["preset_value"] - 1e-5
    assert main(["encode", str(store), "--thresholds", str(out)]) == 0
    _, attrs = read_tracks(store, f"online-W5-{method}")
    np.testing.assert_allclose(attrs["thresholds"], said["limits"])
    assert attrs["thresholds_from"]["method"] == method


def test_wrong_calls_end_with_one_sentence(store, tmp_path, capsys):
    for words, expected in (
        (["-o", str(tmp_path / "no" / "x.json")], "is not a folder"),
        (["-o", str(tmp_path / "x.json"), "--session", "Q"], "no recording has the session Q"),
        (["-o", str(tmp_path / "x.json"), "--rungs", "0.5"], "increase to 1"),
    ):
        assert main(["calibrate", str(store), *words]) == 2
        assert expected in capsys.readouterr().err
    assert not (tmp_path / "x.json").exists()
    assert main(["encode", str(store), "--thresholds", str(tmp_path / "x.json")]) == 2
    assert "does not exist" in capsys.readouterr().err


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
