"""The manifest: what it covers, and that it is plain JSON."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

from sim_mjx.synthesis import plan


def test_the_digest_of_the_code_covers_what_trials_depend_on(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = list[str]()

    def note(root: Path, paths: Iterable[Path]) -> str:
        seen.extend(path.relative_to(root).as_posix() for path in paths if path.is_file())
        return ""

    monkeypatch.setattr(plan, "files_hash", note)
    plan.code_hash.__wrapped__()
    assert seen == sorted(seen)
    # kinematics, stored starts, and options of the compiler
    for name in ("robots/kinematics.py", "io/hiro/onsets.py", "_util/compiling.py"):
        assert f"rcbht_jax/{name}" in seen
    assert {f"sim_mjx/{name}" for name in ("own_files.py", "synthesis/records.py", "engines/native.py")} <= set(seen)
