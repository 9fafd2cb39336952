"""``rcbht simulate``: a store from the real engine, resumed when called again, one sentence for every mistake."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import pytest

from rcbht_jax._util import compile_cache
from rcbht_jax.cli import main
from rcbht_jax.cli.encode import Encode
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import list_tracks, read_tracks_attrs
from rcbht_jax.io.store import read_recordings
from sim_mjx.synthesis import launch, pipeline
from sim_mjx.synthesis.draft import Draft
from sim_mjx.synthesis.pipeline import SynthesisReport
from sim_mjx.synthesis.plan import SynthesisConfig
from tests.support.fake_simulation import tree

SHORT = ["--preset", "C", "--trials", "6", "--seed", "3", "--shard", "2", "--max-seconds", "0.1"]


def test_interrupted_and_called_again_it_gives_the_same_store(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    one, two = tmp_path / "one.zarr", tmp_path / "two.zarr"
    assert main.main(["simulate", str(one), *SHORT, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["stored"], result["resumed"], result["diverged"]) == (6, 0, [])
    assert sum(count["trials"] for count in result["faults"].values()) == 6
    real = Draft.write

    def stop_at_third(self: Draft, shard: int, *of_it: Any) -> None:
        if shard == 2:
            raise KeyboardInterrupt
        real(self, shard, *of_it)

    with monkeypatch.context() as patch:
        patch.setattr(Draft, "write", stop_at_third)
        assert main.main(["simulate", str(two), *SHORT]) == 130
    assert not two.exists()
    assert main.main(["simulate", str(two), *SHORT]) == 0
    assert "4 of them were simulated earlier" in capsys.readouterr().out
    assert tree(one) == tree(two)
    recordings = read_recordings(two)
    assert recordings.session.tolist() == ["sim-C"] * 6
    assert recordings.length.tolist() == [21] * 6  # 0.1 s and the sample at time zero
    assert main.main(["info", str(two)]) == 0
    assert "SIM_MJX_C" in capsys.readouterr().out


def interrupted(_: Encode) -> None:
    raise KeyboardInterrupt


def test_other_assemblies_are_encoded_with_thresholds_of_their_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    store = tmp_path / "pegs.zarr"
    words = [
        "simulate",
        str(store),
        "--assembly",
        "peg-in-hole",
        "--trials",
        "2",
        "--max-seconds",
        "1",
        "--window",
        "5",
    ]
    with monkeypatch.context() as patch:
        patch.setattr(Encode, "run", interrupted)
        assert main.main(words) == 130
    assert list_tracks(store) == []
    assert main.main(words) == 0  # goes on where it was interrupted
    assert "2 of them were simulated earlier" in capsys.readouterr().out
    assert list_tracks(store) == ["online-W5"]
    assert main.main(words) == 2
    assert "exists already" in capsys.readouterr().err
    limits = read_tracks_attrs(store, "online-W5")["thresholds"]
    assert main.main(["encode", str(store), "--window", "5", "--robot", "auto"]) == 0
    assert limits == read_tracks_attrs(store, "online-W5-auto")["thresholds"]
    assert limits != preset("hiro").limits.tolist()
    capsys.readouterr()
    assert main.main([*words, "--worker"]) == 2
    assert "encode the store when it is complete" in capsys.readouterr().err
    with pytest.raises(InputError, match="which do not fit peg-in-hole@panda"):
        pipeline.synthesise(tmp_path / "b.zarr", SynthesisConfig("peg-in-hole@panda", 2, window=5))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--trials", "0"], "number of trials is 0"),
        (["--seed", "-1"], "seed is -1"),
        (["--nominal-share", "1.5"], "nominal share is 1.5"),
        (["--max-seconds", "-2"], "longest trial is -2.0 s"),
        (["--shard", "0"], "shard's number of trials is 0"),
        (["--preset", "D"], "options are wrong"),
        (["--engine", "abacus"], "options are wrong"),
        (["--lanes", "4", "--trials", "0"], "--lanes is for --engine mjx, warp or fused"),
    ],
)
def test_mistakes_are_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["simulate", str(tmp_path / "t.zarr"), *words]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("rcbht: ")
    assert sentence in last
    assert os.listdir(tmp_path) == []


def test_a_full_disk_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Draft, "write", full)
    assert main.main(["simulate", str(tmp_path / "t.zarr"), *SHORT]) == 1
    assert "disk is full" in capsys.readouterr().err
    assert not (tmp_path / "t.zarr").exists()


@pytest.mark.parametrize("chosen", [None, "true"])
def test_a_gpu_s_memory_is_taken_as_needed_unless_the_user_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chosen: str | None
) -> None:
    monkeypatch.setattr(os, "environ", {name: value for name, value in os.environ.items() if "XLA" not in name})
    if chosen is not None:
        os.environ[launch.AS_NEEDED[0]] = chosen
    seen: list[str | None] = []

    def simulated(*_: Any, **__: Any) -> SynthesisReport:
        seen.append(os.environ.get("XLA_PYTHON_CLIENT_PREALLOCATE"))
        return SynthesisReport(6, 6, [], 0, {})

    monkeypatch.setattr(pipeline, "synthesise", simulated)
    monkeypatch.setattr(compile_cache, "use", lambda folder: None)
    for engine in ("native", "warp"):
        assert main.main(["simulate", str(tmp_path / "one.zarr"), *SHORT, "--engine", engine, "--processes", "1"]) == 0
    assert seen == [chosen, chosen or "false"]
