"""``rcbht doctor --repair``: what is undamaged stays as it is, label tracks made by hand included."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.io import store
from rcbht_jax.io import zarr as zarr_io
from rcbht_jax.io.label_store import list_tracks, read_tracks, write_tracks
from sim_mjx.synthesis import pipeline
from sim_mjx.synthesis.pipeline import synthesise
from sim_mjx.validation import health
from tests.sim.validation.test_health import JOB, doctor, flip
from tests.support.fake_simulation import tree


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated store with a label track of "rcbht encode" and two that were made by hand."""
    target = tmp_path_factory.mktemp("made") / "trials.zarr"
    synthesise(target, JOB)
    tracks, _ = read_tracks(target, "online-W5")
    for name in ("by-hand", "by-hand-2"):
        write_tracks(target, name, tracks, {"who": "me"}, created="then")
    assert main(["encode", str(target), "--window", "10", "--robot", "hiro", "--name", "mine"]) == 0
    return target


@pytest.fixture
def copy(labelled: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(labelled, tmp_path / "trials.zarr"))


@pytest.fixture
def no_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "synthesise", lambda *_, **__: pytest.fail("simulated again"))


@pytest.mark.usefixtures("no_simulation")
def test_only_damaged_tracks_are_made_again_whatever_other_tracks_have(
    copy: Path, labelled: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flip(copy / "labels/by-hand/primitive/avg")
    before = tree(copy)
    flip(copy / "labels/mine/primitive/avg")
    (copy / "labels/online-W5/mc/emit/zarr.json").write_text("{")
    assert main(["doctor", str(copy)]) == 2
    said = capsys.readouterr().out
    assert "--repair" in said
    assert "encodes the labels again from the stored wrenches: mine, online-W5\n" in said
    cannot = "label tracks that cannot be made again as they were: by-hand\n"
    assert cannot in said
    assert "copy it again" in said  # as nothing else helps that one
    found = doctor(capsys, 2, str(copy), "--repair")
    assert (found["encoded_tracks"], found["simulated_again"], found["unknown"]) == (
        ["mine", "online-W5"], False, ["by-hand"],
    )  # fmt: skip
    assert tree(copy) == before
    assert main(["doctor", str(copy), "--repair"]) == 2
    said = capsys.readouterr().out
    assert cannot in said
    assert '--repair"' not in said


@pytest.mark.usefixtures("no_simulation")
@pytest.mark.parametrize("content", [b"{", b"[1]", b"\xff"])
def test_a_track_without_readable_metadata_is_left_and_stops_no_other(
    content: bytes, copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (copy / "labels/by-hand/zarr.json").write_bytes(content)
    (copy / "labels/stray").mkdir()
    flip(copy / "labels/mine/primitive/avg")
    found = doctor(capsys, 2, str(copy), "--repair")
    assert (found["encoded_tracks"], found["unknown"]) == (["mine"], ["by-hand", "stray"])
    assert main(["encode", str(copy), "--window", "7", "--robot", "hiro"]) == 0
    assert doctor(capsys, 2, str(copy))["unknown"] == ["by-hand", "stray"]


@pytest.mark.parametrize("what", ["wrench", "labels/by-hand-2/llb/t0", "labels/online-W5/llb/t0"])
def test_tracks_are_carried_over_when_a_store_is_simulated_again(
    what: str, copy: Path, labelled: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    by_hand = "by-hand" in what
    if what != "wrench":
        flip(copy / what)
    before = tree(copy)
    flip(copy / "wrench")
    found = doctor(capsys, 2 if by_hand else 0, str(copy), "--repair")
    assert found["simulated_again"]
    assert found["unknown"] == ["by-hand-2"] * by_hand
    assert tree(copy) == (before if by_hand else tree(labelled))


def test_a_store_whose_recordings_come_out_otherwise_keeps_its_tracks(
    copy: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    flip(copy / "wrench")
    before, real = tree(copy), health.store.read_attrs
    monkeypatch.setattr(
        health.store, "read_attrs", lambda path: {**real(path), "content_sha256": str(path)}
    )  # as on a machine that computes otherwise
    assert main(["doctor", str(copy), "--repair"]) == 2
    assert "label tracks by-hand, by-hand-2, mine would be lost" in capsys.readouterr().err
    assert tree(copy) == before
    assert list_tracks(copy) == ["by-hand", "by-hand-2", "mine", "online-W5"]


@pytest.mark.usefixtures("no_simulation")
def test_labels_of_other_recordings_are_named_and_those_of_the_simulation_made_again(
    copy: Path, labelled: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong, digest = "0" * 64, store.read_attrs(copy)["content_sha256"]
    for name in ("mine", "online-W5"):
        for file in (copy / "labels" / name / "zarr.json", copy / "zarr.json"):  # which holds a copy
            file.write_text(file.read_text().replace(f'recordings_sha256": "{digest}', f'recordings_sha256": "{wrong}'))
    assert main(["train", str(copy), "--tracks", "mine", "-o", str(copy.parent / "x.model")]) == 2
    assert "labels other recordings than those of" in capsys.readouterr().err
    found = doctor(capsys, 2, str(copy), "--repair")
    assert (found["encoded_tracks"], found["unknown"]) == (["online-W5"], ["mine"])
    assert tree(copy / "labels/online-W5") == tree(labelled / "labels/online-W5")


@pytest.mark.usefixtures("no_simulation")
def test_metadata_that_were_not_collected_are_collected(
    copy: Path, labelled: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (copy / "labels/by-hand").rename(copy.parent / "by-hand")
    zarr_io.consolidate(copy)
    (copy.parent / "by-hand").rename(copy / "labels/by-hand")  # whose process was killed after that
    assert "xarray misses them" in doctor(capsys, 2, str(copy))["damage"][0]
    assert main(["doctor", str(copy)]) == 2
    assert '--repair" collects the metadata of by-hand\n' in capsys.readouterr().out
    found = doctor(capsys, 0, str(copy), "--repair")
    assert (found["collected"], found["encoded_tracks"]) == (["by-hand"], [])
    assert tree(copy) == tree(labelled)
