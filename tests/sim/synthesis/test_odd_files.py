"""A work folder where something else stands in the place of a file: made good or refused; no link is followed."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from rcbht_jax.errors import InputError
from sim_mjx.synthesis import claims, descriptions, shards
from sim_mjx.synthesis.pipeline import synthesise
from tests.sim.synthesis.test_resume import interrupted, whole  # noqa: F401  # the fixture
from tests.support.fake_simulation import SMALL, fake_engine, tree
from tests.support.parted_stores import add
from tests.support.parted_stores import begun as begun_store


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the work folder of SMALL, of which one shard is finished."""
    folder = tmp_path_factory.mktemp("begun")
    interrupted(folder / "trials.zarr", SMALL)
    return folder


def _as_folder(path: Path, _: Path) -> None:
    path.mkdir()
    (path / "file").write_text("content")


def _as_link(path: Path, elsewhere: Path) -> None:
    path.symlink_to(elsewhere)


def _as_file(path: Path, _: Path) -> None:
    path.write_text("{}")


def _as_pipe(path: Path, _: Path) -> None:
    os.mkfifo(path)


def test_only_the_store_in_a_work_folder_becomes_another(begun: Path, tmp_path: Path) -> None:
    work = shards.folder_of(begun / "trials.zarr")
    assert shards.target_of(shards.store_of(work)) == begun / "trials.zarr"
    other = Path(shutil.copytree(work, tmp_path / "trials.zarr.kept"))
    assert shards.target_of(shards.store_of(other)) == shards.store_of(other)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        (descriptions.FILE, _as_folder),
        ("store.zarr", _as_link),
        ("store.zarr", _as_file),
        ("store.zarr/wrench/c", _as_link),
        ("store.zarr/source/c", _as_pipe),
        ("store.zarr/simulation/seated/c/0", _as_file),
        ("store.zarr/odd.partial", _as_link),
    ],
)
def test_it_is_made_again(
    name: str,
    change: Callable[[Path, Path], None],
    begun: Path,
    whole: dict[str, bytes],  # noqa: F811
    tmp_path: Path,
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept").write_text("content")
    shutil.copytree(begun, tmp_path / "case")
    path = shards.folder_of(tmp_path / "case/trials.zarr") / name
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    change(path, elsewhere)
    synthesise(tmp_path / "case/trials.zarr", SMALL, simulate=fake_engine)
    assert tree(tmp_path / "case/trials.zarr") == whole
    assert tree(elsewhere) == {"kept": b"content"}


@pytest.mark.parametrize("change", [_as_link, _as_file, _as_pipe])
def test_claims_are_a_folder(change: Callable[[Path, Path], None], begun: Path, tmp_path: Path) -> None:
    shutil.copytree(begun, tmp_path / "case")
    path = shards.folder_of(tmp_path / "case/trials.zarr") / claims.FOLDER
    shutil.rmtree(path)
    change(path, tmp_path)
    with pytest.raises(InputError, match="is a link or a file"):
        synthesise(tmp_path / "case/trials.zarr", SMALL, simulate=fake_engine)


def test_a_claim_that_is_a_folder_holds_nobody_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / claims.FOLDER / "000000-0").mkdir(parents=True)
    (attempt,) = claims.attempts(tmp_path, "000000")
    assert attempt.state == "held"  # somebody may just be writing it
    monkeypatch.setattr(claims, "LEASE", 0.0)
    (attempt,) = claims.attempts(tmp_path, "000000")
    assert attempt.state == "dead"
    claims.clear(tmp_path)
    assert not list((tmp_path / claims.FOLDER).iterdir())


def test_work_of_a_version_without_an_option_is_not_resumed(tmp_path: Path) -> None:
    interrupted(tmp_path / "t.zarr", SMALL)
    file = shards.folder_of(tmp_path / "t.zarr") / shards.MANIFEST
    manifest = json.loads(file.read_text())
    del manifest["job"]["spec"]["longest"]  # null
    file.write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=r"begun with other options \(one of the manifests alone has job.spec.longest"):
        synthesise(tmp_path / "t.zarr", SMALL, simulate=fake_engine)


@pytest.mark.parametrize(
    "reader", ["rcbht_jax.io.chunk_reader.read", "zarr.open_group", "sim_mjx.synthesis.descriptions.read_bytes"]
)
@pytest.mark.parametrize("error", [OSError(errno.EMFILE, "Too many open files"), MemoryError()])
def test_what_cannot_be_read_now_is_not_damaged(
    reader: str, error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: object, **__: object) -> None:
        raise error

    (tmp_path / claims.FOLDER).mkdir()
    descriptions.keep(tmp_path, begun_store(shards.store_of(tmp_path)))
    add(shards.store_of(tmp_path), 0)
    before = tree(shards.store_of(tmp_path))
    with monkeypatch.context() as patch:
        patch.setattr(reader, failing)
        with pytest.raises(type(error)):
            shards.renew(tmp_path)
    assert tree(shards.store_of(tmp_path)) == before
    shards.renew(tmp_path)
    assert shards.finished(tmp_path) == {0}
