"""Stores at a URL are read by the same readers and commands; what cannot work is refused in one sentence."""

from __future__ import annotations

import json
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import pytest

from rcbht_jax._util.url_path import UrlPath, as_path, url_of
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io import label_store, store
from tests.support.parted_stores import COUNT, GAPS, add, begun, finish, ragged, tracks_of, trimmed
from tests.support.store_cases import same
from tests.support.trees import assert_trees_equal

fsspec = pytest.importorskip("fsspec")


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of three parts with gaps, a simulation and label tracks."""
    path = begun(tmp_path_factory.mktemp("local") / "parts.zarr", GAPS)
    for number in (0, 1, 2):
        add(path, number, GAPS)
    return finish(path)


@pytest.fixture(scope="module", params=["memory", "s3"])
def url(request: pytest.FixtureRequest, local: Path) -> Iterator[str]:
    """The same store in the memory of this process, and on a server like Amazon's on this machine."""
    name = f"b{uuid.uuid4().hex[:8]}"
    if request.param == "memory":
        fsspec.filesystem("memory").put(str(local), f"/{name}/trials.zarr", recursive=True)
        yield f"memory://{name}/trials.zarr"
        return
    pytest.importorskip("s3fs", reason="s3fs and moto are not installed")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    made_up = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_ACCESS_KEY_ID": "none", "AWS_SECRET_ACCESS_KEY": "none",
        "AWS_DEFAULT_REGION": "us-east-1",
    }  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        for variable, value in made_up.items():
            patch.setenv(variable, value)
        files = fsspec.filesystem("s3")
        files.mkdir(name)
        files.put(str(local), f"{name}/trials.zarr", recursive=True)
        yield f"s3://{name}/trials.zarr"
    server.stop()


def test_readers_find_what_is_in_the_folder(url: str, local: Path) -> None:
    path = Path(url)  # which folds the slashes
    same(store.read_recordings(url), store.read_recordings(local))
    same(store.read_rows(url, [8, 2]), store.read_rows(local, [8, 2]))
    assert [len(batch) for batch in store.read_batches(url)] == [4, 3, 2]
    same(store.read_table(path), store.read_table(local))
    assert_trees_equal(store.read_simulation(path), store.read_simulation(local))
    assert label_store.list_tracks(path) == ["x"]
    assert_trees_equal(label_store.read_tracks(path, "x"), label_store.read_tracks(local, "x"))
    store.verify(path)
    assert store.count_recordings(path) == COUNT - len(GAPS)


def test_commands_take_a_url(url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", url, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["store"], found["recordings"], found["verified"]) == (url, COUNT - len(GAPS), True)
    assert main(["export", url, "--format", "csv", "-o", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "labels.csv").exists()


def test_nothing_is_written_to_a_url(url: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = as_path(url)
    for write in (
        lambda: store.write_recordings(path, ragged(), {}, overwrite=True),
        lambda: label_store.write_tracks(path, "y", tracks_of(COUNT - 2), {}),
    ):
        with pytest.raises(InputError, match=f"{url} can be read, not written"):
            write()
    assert main(["encode", url]) == 2
    assert "copy it there when it is complete" in capsys.readouterr().err
    assert label_store.list_tracks(path) == ["x"]


def test_damage_and_absence_are_told(local: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files, name = fsspec.filesystem("memory"), uuid.uuid4().hex
    files.put(str(local), f"/{name}/x.zarr", recursive=True)
    files.rm(f"/{name}/x.zarr/wrench/c/2/0/0")
    url = f"memory://{name}/x.zarr"
    same(store.read_rows(url, [0]), trimmed(ragged().take([0])))
    for use in (store.read_recordings, lambda place: store.verify(Path(place))):
        with pytest.raises(InputError, match="damaged"):
            use(url)
    assert main(["info", f"memory://{name}/none.zarr"]) == 2
    assert f"memory://{name}/none.zarr cannot be read as a store" in capsys.readouterr().err
    assert main(["info", "nothing://bucket/x.zarr"]) == 2
    assert "nothing://bucket/x.zarr cannot be read" in capsys.readouterr().err
    with pytest.raises(InputError, match="no label tracks y; it has: x"):
        label_store.read_tracks_attrs(Path(url), "y")


def test_the_extra_is_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(InputError, match=r's3://b/x.zarr is a URL, and .*pip install "rcbht-jax\[cloud\]"'):
        store.read_recordings("s3://b/x.zarr")


def test_urls_are_told_from_folders() -> None:
    assert url_of(UrlPath("s3://b/x.zarr") / "labels") == "s3://b/x.zarr/labels"
    assert str(UrlPath("s3://b/x.zarr").parent) == "s3://b"
    for plain in ("x.zarr", "/s3:/b", "./a:/b", "C:/b", "a b://c", "s3:"):
        assert url_of(Path(plain)) is None, plain
    assert as_path("x.zarr") == Path("x.zarr")


@pytest.mark.parametrize(
    ("url", "path"),
    [
        ("file:///data/x.zarr", "/data/x.zarr"),
        ("file:/data/x.zarr", "/data/x.zarr"),
        ("FILE://localhost/data/x.zarr", "/data/x.zarr"),
        ("file:///a%20b/%C3%A4 #1?%2520.zarr", "/a b/ä #1?%20.zarr"),
    ],
)
def test_a_url_of_a_file_is_its_path(url: str, path: str) -> None:
    assert as_path(url) == Path(path)
    assert url_of(as_path(url)) is None
    if "localhost" not in url:  # which Path leaves as the first folder
        assert as_path(Path(url)) == Path(path)


@pytest.mark.parametrize("url", ["file://server/x.zarr", "file:///x%00.zarr"])
def test_a_url_of_no_file_of_this_computer_is_refused(url: str) -> None:
    with pytest.raises(InputError, match=f"{url} is not a file of this computer; expected file:///PATH"):
        as_path(url)


@pytest.mark.parametrize("chain", ["zip://x.zarr::/data/a.zip", "simplecache::s3://bucket/x.zarr"])
def test_a_chain_of_urls_is_refused(chain: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Its store was called damaged."""
    with pytest.raises(InputError, match="is a chain of URLs"):
        store.read_recordings(Path(chain))
    assert main(["info", chain]) == 2
    assert capsys.readouterr().err.count(f"{chain} is a chain of URLs; expected one URL") == 1


def test_stores_are_written_and_read_by_urls_of_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "my trials %20.zarr"
    url = f"file://{quote(str(place))}"
    store.write_recordings(url, ragged(), {})
    same(store.read_recordings(Path(url)), store.read_recordings(place))
    plain = tmp_path / "x.zarr"
    place.rename(plain)
    assert store.read_attrs(Path(f"file://{plain}")) == store.read_attrs(plain)  # takes paths alone
    export = ["export", "--format", "csv", "-o", f"file://{tmp_path}/my%20tables"]
    for command in (["info"], ["encode", "--robot", "auto"], ["doctor"], export):
        assert main([command[0], f"file://{plain}", *command[1:]]) == 0, command
    assert (tmp_path / "my tables" / "labels.csv").exists()
    assert str(plain) in capsys.readouterr().out
