"""Stores of strangers that declare or unpack to far more than they hold: refused in one sentence, within memory."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from tests.support.store_cases import encoded_store, same, simple


def declare(path: Path, samples: int) -> None:
    """Have the wrench declare another number of samples, also where the metadata are collected."""
    for file in (path / "wrench" / "zarr.json", path / "zarr.json"):
        content = json.loads(file.read_text())
        collected = content.get("consolidated_metadata", {"metadata": {"wrench": content}})
        collected["metadata"]["wrench"]["shape"][1] = samples
        file.write_text(json.dumps(content))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return encoded_store(tmp_path / "trials.zarr", simple(3, 200))


@pytest.mark.parametrize(
    "words",
    [
        ["encode", "--window", "7"],
        ["stream", "--robot", "hiro"],
        ["plot", "map", "-o", "map.pdf"],
        ["describe", "t1"],
        ["evaluate"],
        ["info"],
        ["calibrate", "--method", "rest", "-o", "limits.json"],
    ],
)
@pytest.mark.parametrize("samples", [10**12, 2**62])
def test_a_huge_time_axis_is_one_sentence(
    path: Path, words: list[str], samples: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(path.parent)
    declare(path, samples)
    count = 2 if words[0] == "plot" else 1
    status = main([*words[:count], str(path), *words[count:]])
    error = capsys.readouterr().err
    if words != ["info"]:  # which shows what is counted of a large store, and reads no sample
        assert status == 2
        assert f"{samples} samples, and the longest recording 200; expected at most 1048576" in error
    assert "Traceback" not in error


@pytest.mark.parametrize("read", [store.longest_of, store.read_recordings, lambda path: list(store.read_batches(path))])
def test_no_reader_believes_a_huge_time_axis(path: Path, read: object) -> None:
    declare(path, 10**9)
    with pytest.raises(InputError, match=r"trials\.zarr holds contradictory recordings: the wrench has 1000000000"):
        read(path)  # type: ignore[operator]
    with pytest.raises(InputError, match="the longest recording 200"):
        store.read_recordings(path)


def test_padding_that_recordings_may_have_is_kept(tmp_path: Path) -> None:
    """Recordings chosen from longer ones are padded as those were."""
    recordings = simple(3, 2000)
    recordings.length[:] = 20
    recordings.wrench[:, 20:] = 0
    store.write_recordings(tmp_path / "x.zarr", recordings, {})
    same(store.read_recordings(tmp_path / "x.zarr"), recordings)
    assert store.longest_of(tmp_path / "x.zarr") == 2000


def test_what_no_reader_takes_is_not_written(tmp_path: Path) -> None:
    recordings = simple(1, 50)
    wide = np.zeros((1, 2**20 + 1, 6), np.float32)
    wide[:, :50] = recordings.wrench
    vars(recordings)["wrench"] = wide
    with pytest.raises(InputError, match="Cut what lies beyond"):
        store.write_recordings(tmp_path / "x.zarr", recordings, {})
