"""``rcbht doctor``: numbers of the machine; damage of a store is found, told and made good."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rcbht_jax._util.ratios import latest, read_history
from rcbht_jax.cli.main import main
from rcbht_jax.io.store import write_recordings
from sim_mjx.assemblies.latch import LatchVariation
from sim_mjx.cli import doctor as doctor_command
from sim_mjx.synthesis import plan, shards
from sim_mjx.synthesis.pipeline import synthesise
from sim_mjx.synthesis.plan import SynthesisConfig
from sim_mjx.validation import health
from tests.support import fake_simulation
from tests.support.fake_simulation import SMALL, short, tree
from tests.support.store_cases import simple

JOB = SynthesisConfig("C", 4, seed=3, shard=3, spec=short(), window=5)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of the native engine with labels."""
    target = tmp_path_factory.mktemp("made") / "trials.zarr"
    synthesise(target, JOB)
    return target


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "trials.zarr"))


def flip(path: Path) -> None:
    """Change a byte of the first chunk below a folder."""
    chunk = next(file for file in sorted((path / "c").rglob("*")) if file.is_file())
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 0xFF
    chunk.write_bytes(data)


def doctor(capsys: pytest.CaptureFixture[str], status: int, *words: str) -> dict[str, Any]:
    capsys.readouterr()
    assert main(["doctor", *words, "--json"]) == status
    return json.loads(capsys.readouterr().out)


def test_the_machine_in_numbers(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(health, "SECONDS", 0.01)
    monkeypatch.setattr(health, "TRIALS", 2)
    monkeypatch.setattr(doctor_command, "SAMPLES", 200)
    monkeypatch.setattr(doctor_command, "TRIALS", 2)
    monkeypatch.setattr(doctor_command, "USUAL", 1e9)
    found = doctor(capsys, 0)
    assert "is usual. Compare with other versions of jax" in found["problems"][-1]
    assert found["versions"]["rcbht-jax"]
    assert found["cores"] >= 1
    assert found["free_disk_bytes"] > 0
    assert all(value > 0 for value in found["benchmark"].values())


def test_the_usual_ratio_is_the_committed_one() -> None:
    size = {"device": "cpu", "trials": doctor_command.TRIALS, "samples": doctor_command.SAMPLES}
    record = latest(read_history(Path(__file__).resolve().parents[3] / "benchmarks/history.json"), size)
    assert record is not None
    assert record["ratios"][f"encode/W={doctor_command.WINDOW}"] == pytest.approx(doctor_command.USUAL, rel=0.01)


def test_problems_are_sentences(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"versions": {"mujoco": "3.17.0", "mujoco-mjx": "3.17.0"}, "devices": ["cuda:0"], "free_disk_bytes": 2**40}
    monkeypatch.setattr(shutil, "which", lambda _: "/bin/nvidia-smi")
    assert health.problems(found) == []
    worse = {"versions": {"mujoco": "3.17.0", "mujoco-mjx": "3.16.0"}, "devices": ["cpu:0"], "free_disk_bytes": 2**20}
    assert len(health.problems(worse)) == 3


def test_a_whole_store_is_whole(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = doctor(capsys, 0, str(made))
    assert (found["recordings"], found["damage"], found["notes"], found["repairable"]) == (4, [], [], True)
    assert main(["doctor", str(made)]) == 0
    assert "every checksum is right" in capsys.readouterr().out


@pytest.mark.parametrize("what", ["wrench", "simulation/friction", "labels/online-W5/llb/t0", "no labels"])
def test_damage_is_found_told_and_made_good(
    what: str, made: Path, copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if what == "no labels":
        shutil.rmtree(copy / "labels")
    else:
        flip(copy / what)
    found = doctor(capsys, 2, str(copy))
    assert len(found["damage"]) == 1
    assert found["repairable"]
    assert main(["doctor", str(copy)]) == 2
    said = capsys.readouterr().out
    assert "--repair" in said
    assert "copy it again" not in said + "".join(found["damage"])
    assert ("from the stored wrenches" in said) == ("labels" in what)
    if what != "simulation/friction":
        repaired = doctor(capsys, 0, str(copy), "--repair")
        assert repaired["repaired"]
        assert repaired["encoded_tracks"] == (["online-W5"] if "labels" in what else [])
        assert tree(copy) == tree(made)


@pytest.mark.parametrize(
    "options",
    [("--robot", "auto"), ("--rule", "fit"), ("--window", "10", "--no-gate"), ("--mode", "offline", "--clean")],
)
def test_only_the_damaged_labels_are_encoded_again(
    options: tuple[str, ...], copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["encode", str(copy), "--name", "mine", *options]) == 0
    before = tree(copy)
    flip(copy / "labels/mine/primitive/avg")
    monkeypatch.setattr(plan, "code_hash", lambda: "other")  # whoever simulated the store
    assert main(["doctor", str(copy), "--repair"]) == 0
    assert "have been encoded again: mine\n" in capsys.readouterr().out
    assert tree(copy) == before


def test_labels_that_come_out_otherwise_are_not_kept(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file in (copy / "labels/online-W5/zarr.json", copy / "zarr.json"):  # which holds a copy
        file.write_text(file.read_text().replace("23.0", "2.0"))
    flip(copy / "labels/online-W5/llb/t0")
    before = tree(copy)
    assert main(["doctor", str(copy), "--repair"]) == 2
    assert "the installed versions encode otherwise" in capsys.readouterr().err
    assert tree(copy) == before


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("dt/c", b"\x28\xb5\x2f\xfd", b"\x29\xb5\x2f\xfd"),  # what begins a packed chunk
        ("time/c/0", b"\x28\xb5\x2f\xfd", b"\x29\xb5\x2f\xfd"),
        ("time/zarr.json", b'"s"', b'"r"'),  # its unit
        ("labels/online-W5/mc/emit/zarr.json", b"configuration", b"bonfiguration"),
        ("zarr.json", b'"units": "s"', b'"units": "r"'),  # what is collected of the others
        ("zarr.json", b'"gaps"', b'"gapr"'),
    ],
)
def test_damage_of_what_others_read_is_found(
    file: str, old: bytes, new: bytes, copy: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    content = (copy / file).read_bytes()
    assert old in content
    (copy / file).write_bytes(content.replace(old, new, 1))
    monkeypatch.chdir(copy.parent)
    [sentence] = doctor(capsys, 2, copy.name)["damage"]
    assert sentence.startswith(
        f"{Path(copy.name, *Path(file).parts[:2]) if 'labels' in file else copy.name} is damaged"
    )


def test_a_track_that_was_deleted_is_no_damage(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["encode", str(copy), "--robot", "auto", "--name", "mine"]) == 0
    shutil.rmtree(copy / "labels" / "mine")
    assert doctor(capsys, 0, str(copy))["damage"] == []


def test_what_cannot_be_made_again_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text("from sim_mjx.assemblies.clip import CLIP\n")
    job = SynthesisConfig("own.py:CLIP@panda", 1, spec=LatchVariation(longest=0.1))
    synthesise(tmp_path / "own.zarr", job)
    assert health.check_store(tmp_path / "own.zarr").repairable
    (tmp_path / "own.py").unlink()
    assert health.check_store(tmp_path / "own.zarr").notes == ["There is no Python file own.py."]


def test_what_other_code_made_is_not_made_again(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flip(copy / "wrench")
    before = tree(copy)
    monkeypatch.setattr(plan, "code_hash", lambda: "other")
    found = doctor(capsys, 2, str(copy))
    assert not found["repairable"]
    assert "other versions or code: another content of the simulation's code (sim_mjx_sha256). Sim" in found["notes"][0]
    assert main(["doctor", str(copy), "--repair"]) == 2
    assert "cannot be made again: It was made with other versions" in capsys.readouterr().err
    assert tree(copy) == before


def test_the_processor_that_made_a_store_is_named_in_full(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(plan, "processor", lambda: "Linux x86_64 with AVX-1024")
    (note,) = doctor(capsys, 0, str(copy))["notes"]
    assert "now Linux x86_64 with AVX-1024. Simulated again" in note


def test_a_store_that_was_not_simulated_has_no_seed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recordings(tmp_path / "t.zarr", simple(4, 100), {})
    assert doctor(capsys, 0, str(tmp_path / "t.zarr"))["damage"] == []
    folder = shards.folder_of(tmp_path / "t.zarr")
    folder.mkdir()
    assert "is a leftover" in doctor(capsys, 0, str(tmp_path / "t.zarr"))["notes"][0]
    (folder / shards.MANIFEST).write_text("{}")
    assert "goes on, or was interrupted" in doctor(capsys, 0, str(tmp_path / "t.zarr"))["notes"][0]
    flip(tmp_path / "t.zarr" / "wrench")
    assert main(["doctor", str(tmp_path / "t.zarr"), "--repair"]) == 2
    assert "was not simulated" in capsys.readouterr().err
    assert main(["doctor", "--repair"]) == 2
    assert "--repair needs a store" in capsys.readouterr().err


@pytest.fixture
def interrupted(tmp_path: Path) -> Path:
    """The place of a store whose job has ended after the first of three shards."""
    fake_simulation.interrupted(tmp_path / "t.zarr", SMALL)
    return tmp_path / "t.zarr"


@pytest.mark.parametrize("repair", [(), ("--repair",)])
@pytest.mark.parametrize("place", ["target", "work folder", "inside"])
def test_a_store_that_its_job_has_not_finished_is_not_damaged(
    place: str,
    repair: tuple[str, ...],
    interrupted: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    draft = shards.store_of(shards.folder_of(interrupted))
    monkeypatch.chdir(draft.parent)
    path = {"target": interrupted, "work folder": draft, "inside": Path(draft.name)}[place]
    before = tree(interrupted.parent)
    assert main(["doctor", str(path), *repair]) == 2
    told, said = capsys.readouterr()
    state = "not finished" if place == "target" else "still being written"
    assert f"{path} is {state}: 1 of 3 parts are there" in said
    assert f'"rcbht simulate {interrupted} --status"' in said
    assert "damaged" not in told + said
    assert tree(interrupted.parent) == before


def test_an_unfinished_store_without_a_job_is_not_damaged(
    interrupted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shards.store_of(shards.folder_of(interrupted)).rename(moved := interrupted.with_name("moved.zarr"))
    assert main(["doctor", str(moved), "--repair"]) == 2
    assert "moved.zarr is still being written: 1 of 3 parts" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["B", "two", "hooked-A", "peg-in-hole@panda"])
def test_a_job_comes_back_from_its_provenance(name: str) -> None:
    from sim_mjx.registry import get_scenario

    spec = replace(get_scenario(name).spec(), longest=3.0)
    job = SynthesisConfig(name, 7, seed=2, spec=spec)
    known = shards.as_json(plan.provenance(plan.manifest_of(job)))
    assert plan.job_of(known["job"]) == job


def test_what_checks_a_store_without_the_physics_engine_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of an imported store, the error named only an engine that such a store does not need."""
    store = tmp_path / "imported.zarr"
    write_recordings(store, simple(), {})
    for name in [name for name in sys.modules if name.startswith("sim_mjx.synthesis")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert main(["doctor", str(store)]) == 2
    said = capsys.readouterr().err
    assert said.startswith('rcbht: mujoco is not installed: pip install "rcbht-jax[sim]". Without it, "rcbht info ')
    assert f'"rcbht info {store} --check" compares all checksums but those of label tracks' in said
    assert main(["info", str(store), "--check"]) == 0
