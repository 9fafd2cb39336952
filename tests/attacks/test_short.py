"""The short form of the attacks, in this process; and that an attack that should be noticed is noticed."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from rcbht_jax._util import atomic
from tests.attacks import harness, readers, streams, writers

SEED = 7


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("good")
    harness.make_good(folder)
    return folder


@pytest.mark.parametrize("name", harness.NAMES)
def test_nothing_breaks(name: str, good: Path) -> None:
    place = harness.NAMES.index(name)
    outcomes = [harness.attempt(place + len(harness.NAMES) * k, SEED, good)[1] for k in range(4)]
    assert set(outcomes) <= {"", "refused"}


def test_good_files_are_read_and_hold_what_was_written(good: Path) -> None:
    for reader in harness.READERS.values():
        found = reader.read(good / reader.name)
        assert reader.judge(found, found) == ""


def test_the_attacks_notice_what_is_wrong(good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that believes damage, a writer that replaces what came meanwhile, a stream that lets everything in."""
    blind = readers.Reader("results", lambda path: None, lambda path: [float("nan")], None, readers.finite)
    assert "not finite" in readers.attack(blind, "1", good / "results", tmp_path)
    monkeypatch.setattr(atomic, "identity", lambda path: (0, 0, 0, 0))
    found = set()
    for number in range(60):
        folder = tmp_path / str(number)
        folder.mkdir()
        found.add(writers.attack("thresholds", str(number), folder))
    assert "meanwhile: bystander is not what it was" not in found
    assert any("meanwhile" in one for one in found)
    monkeypatch.setattr(streams, "MOST", 1)
    assert {streams.attack(str(number)) for number in range(9)} - {""}


@pytest.mark.filterwarnings("ignore")  # of forks
def test_what_dies_or_hangs_is_a_defect(good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The child's end is the outcome of the attempt that it was at; the next child goes on behind it."""

    def hostile(number: int, seed: int, good: Path) -> tuple[str, str]:
        if number == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        if number == 3:
            time.sleep(60)
        return "read model", ""

    monkeypatch.setattr(harness, "attempt", hostile)
    monkeypatch.setattr(harness, "PATIENCE", 0.5)
    for found in (harness.in_children(range(5), SEED, good), harness.in_runners(range(5), SEED, good, 2)):
        assert [wrong for _, _, wrong in found] == ["", "died by signal 9", "", "waited without end", ""]
