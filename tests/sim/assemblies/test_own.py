"""docs/howto/own_assembly.md: a new part takes at most 60 lines and a new robot 30, and both run as they stand."""

from __future__ import annotations

import hashlib
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import get_type_hints

import pytest

from rcbht_jax.cli import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import read_recordings
from sim_mjx import own_files as ran
from sim_mjx.own_files import run_file
from sim_mjx.registry import get_scenario, own_files
from sim_mjx.synthesis.pipeline import synthesise
from sim_mjx.synthesis.plan import SynthesisConfig, manifest_of
from tests.support.pages import ROOT

PAGE = ROOT / "docs" / "howto" / "own_assembly.md"


def blocks() -> dict[str, str]:
    """The page's two files."""
    found = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.S | re.M)
    return {
        name: next(block for block in found if f"\n{what} = " in block)
        for name, what in (("key.py", "KEY"), ("arm.py", "ARM"))
    }


def test_a_part_takes_60_lines_and_a_robot_30() -> None:
    lines = {name: block.count("\n") for name, block in blocks().items()}
    assert lines["key.py"] <= 60
    assert lines["arm.py"] <= 30


def test_own_files_are_simulated_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, block in blocks().items():
        (tmp_path / name).write_text(block)
    arguments = ["--assembly", "key.py:KEY", "--robot", "arm.py:ARM", "--trials", "2", "--nominal-share", "1"]
    assert main.main(["simulate", "keys.zarr", *arguments]) == 0
    recordings = read_recordings(tmp_path / "keys.zarr")
    assert recordings.trial.tolist() == ["sim-key-mine-000000", "sim-key-mine-000001"]
    assert recordings.outcome.tolist() == ["success"] * 2
    assert recordings.annotations.labels == {"phase": ("approach", "insertion", "rest")}
    # a finished part of another version of the file is not mixed in
    job = SynthesisConfig("key.py:KEY@arm.py:ARM", 2, spec=get_scenario("key.py:KEY@panda").spec(longest=0.1), shard=1)
    begin(tmp_path / "more.zarr", job)
    (tmp_path / "key.py").write_text(blocks()["key.py"] + "\n")
    ran._run.cache_clear()  # as in another process
    with pytest.raises(InputError, match=r"another content of your files \(own_sha256\)"):
        synthesise(tmp_path / "more.zarr", job)
    # nor of another version of a file that it reads
    arm = get_scenario("clip@arm.py:ARM").preset.robot.build()
    arm.compile()
    (tmp_path / "arm.xml").write_text(arm.to_xml())
    made = 'from_mjcf("arm.xml", site="WRIST", home=(0.0, 0.6, 0.0, 1.5, 0.0, 1.04, 0.0), place=(0.5, 0.0, 0.15))'
    (tmp_path / "read.py").write_text(f"from sim_mjx.robots import from_mjcf\n\nARM = {made}\n")
    job = replace(job, preset="clip@read.py:ARM", spec=get_scenario("clip@read.py:ARM").spec())
    begin(tmp_path / "clips.zarr", job)
    (tmp_path / "arm.xml").write_text(arm.to_xml().replace('mass="5"', 'mass="9"'))
    with pytest.raises(InputError, match="scene_sha256"):
        synthesise(tmp_path / "clips.zarr", job)


def begin(target: Path, job: SynthesisConfig) -> None:
    """Begin a store and stop at its first trial."""

    def stop(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        synthesise(target, job, simulate=stop)  # type: ignore[arg-type]


def test_a_path_may_have_any_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "us@er").mkdir()
    for name, block in blocks().items():
        (tmp_path / "us@er" / name).write_text(block)
    scenario = get_scenario("us@er/key.py:KEY@us@er/arm.py:ARM")
    assert (scenario.assembly, scenario.robot) == ("key", "mine")
    assert get_scenario("clip@us@er/arm.py:ARM").robot == "mine"


def test_mistakes_in_own_files_are_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "key.py").write_text(blocks()["key.py"])
    (tmp_path / "lacks.py").write_text("import nothere\n")
    (tmp_path / "wrong.py").write_text("def x(:\n")
    (tmp_path / "nofile.py").write_text(
        'from sim_mjx.robots import from_mjcf\nfrom_mjcf("no.xml", site="", home=(), place=(0, 0, 0))\n'
    )
    with pytest.raises(InputError, match=r"^lacks.py cannot be imported: No module named 'nothere'.$"):
        get_scenario("lacks.py:KEY@panda")
    with pytest.raises(InputError, match=r"^wrong.py cannot be imported: invalid syntax \(wrong.py, line 1\).$"):
        get_scenario("wrong.py:KEY@panda")
    with pytest.raises(InputError, match=r"^There is no file no.xml.$"):
        get_scenario("clip@nofile.py:ARM")
    with pytest.raises(InputError, match=r"key.py has no assembly named LOCK"):
        get_scenario("key.py:LOCK@panda")
    for name, old, new, sentence in (
        ("touch", 'touch(spec, f"CORNER_{i}"', 'touch(spec, f"NONE_{i}"', "cannot compile key on panda: geom 'NONE_0'"),
        ("twice", 'box(body, "FLOOR"', 'box(body, "WALL_0"', "cannot compile key on panda: repeated name 'WALL_0'"),
        ("phases", 'Phase("insertion"', 'Phase("rest"', "key has the phases approach, rest, rest; expected"),
    ):
        (tmp_path / f"{name}.py").write_text(blocks()["key.py"].replace(old, new))
        with pytest.raises(InputError, match=sentence):
            get_scenario(f"{name}.py:KEY@panda").scene()


def test_a_file_may_import_its_neighbours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "arm_of_mine.py").write_text(blocks()["arm.py"])
    (tmp_path / "lab" / "cell.py").write_text("from arm_of_mine import ARM\n")
    before = list(sys.path)
    assert get_scenario("clip@lab/cell.py:ARM").robot == "mine"
    assert sys.path == before


MADE_OF_COMMON = """from dataclasses import replace
from common import Kept, WHO
from sim_mjx.robots import ROBOTS
ARM = replace(ROBOTS["panda"], name=WHO)
KEPT = Kept()
"""
COMMON = """from __future__ import annotations
from dataclasses import dataclass
WHO = "{}"
@dataclass
class Kept:
    size: int = 1
"""


def write_arm(folder: Path, who: str) -> None:
    folder.mkdir(exist_ok=True)
    (folder / "arm.py").write_text(MADE_OF_COMMON)
    (folder / "common.py").write_text(COMMON.format(who))


def test_neighbours_of_one_name_are_kept_apart(tmp_path: Path) -> None:
    both = ("first", "second")
    for who in both:
        write_arm(tmp_path / who, who)
    assert tuple(get_scenario(f"clip@{tmp_path}/{who}/arm.py:ARM").robot for who in both) == both
    assert "common" not in sys.modules
    for who in both:  # each class finds the module in which it was made
        kept = run_file(f"{tmp_path}/{who}/arm.py").module.KEPT
        assert get_type_hints(type(kept)) == {"size": int}
        assert who == sys.modules[type(kept).__module__].WHO


def test_a_neighbour_that_was_imported_before_is_left_to_its_importer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_arm(tmp_path, "file")
    earlier = ModuleType("common")
    earlier.__file__ = str(tmp_path / "common.py")
    monkeypatch.setitem(sys.modules, "common", earlier)
    assert get_scenario(f"clip@{tmp_path}/arm.py:ARM").robot == "file"
    assert sys.modules["common"] is earlier
    [file] = own_files(f"clip@{tmp_path}/arm.py:ARM")
    assert file.files == (tmp_path / "arm.py", tmp_path / "common.py")


def test_the_manifest_covers_what_a_file_imports_from_its_folder(tmp_path: Path) -> None:
    (tmp_path / "kit").mkdir()
    (tmp_path / "kit" / "__init__.py").touch()
    (tmp_path / "kit" / "far.py").write_text(COMMON.format("far"))
    (tmp_path / "common.py").write_text("from kit.far import Kept, WHO\n")
    (tmp_path / "arm.py").write_text(MADE_OF_COMMON)
    (tmp_path / "unused.py").touch()
    job = SynthesisConfig(f"clip@{tmp_path}/arm.py:ARM", 1, spec=get_scenario("clip@panda").spec())
    names = ("arm.py", "common.py", "kit/__init__.py", "kit/far.py")
    [file] = own_files(job.preset)
    assert file.files == tuple(tmp_path / name for name in names)
    before = manifest_of(job)["versions"]["own_sha256"]
    (tmp_path / "kit" / "far.py").write_text(COMMON.format("another"))
    assert manifest_of(job)["versions"]["own_sha256"] == before  # what is simulated is what was run
    ran._run.cache_clear()  # as in another process
    assert manifest_of(job)["versions"]["own_sha256"] != before


def test_a_relative_path_counts_from_the_present_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for who in ("first", "second"):
        write_arm(tmp_path / who, who)
        monkeypatch.chdir(tmp_path / who)
        assert get_scenario("clip@arm.py:ARM").robot == who
        assert run_file("arm.py") is run_file(str(tmp_path / who / "arm.py"))


def test_the_digest_of_a_file_without_neighbours_stands_in_work_folders(tmp_path: Path) -> None:
    (tmp_path / "arm.py").write_text("import numpy\nfrom sim_mjx.robots import ROBOTS\nARM = ROBOTS['panda']\n")
    job = SynthesisConfig(f"clip@{tmp_path}/arm.py:ARM", 1, spec=get_scenario("clip@panda").spec())
    content = hashlib.sha256((tmp_path / "arm.py").read_bytes()).digest()
    assert manifest_of(job)["versions"]["own_sha256"] == [hashlib.sha256(b"arm.py" + content).hexdigest()]


def test_a_module_that_is_imported_lazily_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To load one changes the table of modules that is gone through, and takes what its user wanted to save."""

    class Lazy(ModuleType):
        def __getattribute__(self, name: str) -> object:
            sys.modules[f"loaded_by_{name}"] = ModuleType("loaded")
            return super().__getattribute__(name)

    monkeypatch.setattr(sys, "modules", {**sys.modules, "lazy_one": Lazy("lazy_one"), "no_module": object()})
    (tmp_path / "part.py").write_text("VALUE = 7\n")
    assert run_file(str(tmp_path / "part.py")).module.VALUE == 7
    assert not [name for name in sys.modules if name.startswith("loaded_by_")]
