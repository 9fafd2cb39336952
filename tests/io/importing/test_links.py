"""Links in folders of strangers: they lead nowhere but to what was given to read."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.io.export import DataSet, export
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.importing.unpacked import plain_name
from tests.attacks.folders import recordings
from tests.io.importing.test_hostile import KIND, SUFFIXES, VALID, csv


@pytest.mark.parametrize("suffix", [suffix for suffix in SUFFIXES if suffix not in (*KIND, ".json")])
def test_links_out_of_the_folder_are_not_followed(suffix: str, tmp_path: Path) -> None:
    """Nor is a file whose folder is such a link; whoever names a link as the source means it."""
    (tmp_path / "runs" / "more").mkdir(parents=True)
    (tmp_path / f"secret{suffix}").write_bytes(VALID.get(suffix, lambda: b"root:hash")())
    (tmp_path / "runs" / "a.csv").write_bytes(csv())
    (tmp_path / "runs" / "more" / f"b{suffix}").symlink_to(tmp_path / f"secret{suffix}")
    (tmp_path / "runs" / "inside.csv").symlink_to("a.csv")
    (tmp_path / "source").symlink_to("runs")
    imported = read_source(tmp_path / "source", keep_copies=True)
    assert imported.recordings.trial.tolist() == ["a", "inside"]
    [(name, reason)] = imported.report.skipped
    assert name == plain_name(f"more/b{suffix}")
    assert "is a link out of" in reason
    if suffix in VALID:
        read_source(tmp_path / "runs" / "more" / f"b{suffix}", mapping=Mapping(source_rate=100.0))


@pytest.mark.parametrize("kind", ["csv", "parquet", "mcap", "lerobot", "bag"])
def test_links_out_of_a_folder_that_is_one_thing_are_not_followed(kind: str, tmp_path: Path) -> None:
    """An export, a LeRobot data set, a bag of ROS 2: all of it is inside, or nothing is read."""
    good = tmp_path / "good"
    if kind == "bag":
        good.mkdir()
        (good / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    else:
        export(DataSet.of(recordings()), good, kind)
    for number, path in enumerate(sorted(good.rglob("*"))):
        copy = tmp_path / f"copy-{number}"
        shutil.copytree(good, copy)
        (copy / path.relative_to(good)).rename(tmp_path / f"out-{number}")
        (copy / path.relative_to(good)).symlink_to(tmp_path / f"out-{number}")
        with pytest.raises(InputError, match="is a link out of"):
            read_source(copy)


def cached(good: Path, repository: Path) -> Path:
    """A copy of a data set as Hugging Face keeps it: the snapshot's files are links to blobs."""
    snapshot, blobs = repository / "snapshots" / "abc123", repository / "blobs"
    blobs.mkdir(parents=True)
    for number, path in enumerate(path for path in sorted(good.rglob("*")) if path.is_file()):
        link = snapshot / path.relative_to(good)
        link.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, blobs / f"blob-{number}")
        up = ".." + "/.." * len(link.parent.relative_to(repository).parts[1:])
        link.symlink_to(f"{up}/blobs/blob-{number}")
    return snapshot


@pytest.mark.parametrize("kind", ["lerobot", "parquet"])
def test_a_snapshot_in_a_cache_of_hugging_face_is_read(kind: str, tmp_path: Path) -> None:
    export(DataSet.of(recordings()), tmp_path / "good", kind)
    snapshot = cached(tmp_path / "good", tmp_path / "hub" / "datasets--me--pusht")
    plain, found = read_source(tmp_path / "good"), read_source(snapshot)
    assert (found.recordings.wrench == plain.recordings.wrench).all()
    assert found.report.content_sha256 == plain.report.content_sha256
    if kind == "lerobot":
        assert len(read_source(snapshot / "data", "parquet").recordings) == 2  # a folder of a snapshot


@pytest.mark.parametrize("trick", ["secret", "other", "beside", "blobs", "name", "place"])
def test_a_snapshot_leads_nowhere_but_to_its_own_blobs(trick: str, tmp_path: Path) -> None:
    """Not to other files, another repository, files beside the blobs, or blobs that are a link; nor other folders."""
    export(DataSet.of(recordings()), tmp_path / "good", "lerobot")
    name = "pusht" if trick == "name" else "datasets--me--pusht"
    snapshot = cached(tmp_path / "good", repository := tmp_path / "hub" / name)
    targets = {
        "secret": tmp_path / "secret", "other": tmp_path / "hub" / "datasets--you--pusht" / "blobs" / "secret",
        "beside": repository / "secret",
    }  # fmt: skip
    info = snapshot / "meta" / "info.json"
    if target := targets.get(trick):
        target.parent.mkdir(parents=True, exist_ok=True)
        info.resolve().rename(target)
        info.unlink()
        info.symlink_to(target)
    if trick == "blobs":
        (repository / "blobs").rename(tmp_path / "elsewhere")
        (repository / "blobs").symlink_to(tmp_path / "elsewhere")
    if trick == "place":
        snapshot = (repository / "snapshots").rename(repository / "others") / snapshot.name
    with pytest.raises(InputError, match="is a link out of"):
        read_source(snapshot, "lerobot")
