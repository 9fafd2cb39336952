"""docs/howto/own_assembly.md: a new part takes at most 60 lines and a new robot 30, and both run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from rcbht_jax.cli import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import read_recordings
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis.pipeline import synthesise
from sim_mjx.synthesis.plan import SynthesisConfig
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

    def stop(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        synthesise(tmp_path / "more.zarr", job, simulate=stop)  # type: ignore[arg-type]
    (tmp_path / "key.py").write_text(blocks()["key.py"] + "\n")
    with pytest.raises(InputError, match="own_sha256"):
        synthesise(tmp_path / "more.zarr", job)
    with pytest.raises(InputError, match=r"key.py has no assembly named LOCK"):
        get_scenario("key.py:LOCK@panda")
