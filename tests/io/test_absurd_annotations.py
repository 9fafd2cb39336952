"""Annotations at times that no recording has: a file may hold any number, and nobody computes with it.

Warnings are errors under pytest, and a cast of such a number warns.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.annotations import Annotations
from rcbht_jax.cli.main import main
from rcbht_jax.introspection import model as model_files
from rcbht_jax.io.export.dataset import states_at_samples
from rcbht_jax.io.messages import Begin
from rcbht_jax.io.playback import play
from rcbht_jax.io.store import write_recordings
from rcbht_jax.types import Recordings
from tests.support.introspection_models import model

INTERVALS = (("a", 0.0, 0.5), ("b", 0.5, 1.0))
ABSURD = (("c", 1e300, 1.7e308), ("d", 1.7e308, np.nan), ("e", -1.7e308, -1e300))


def recordings(intervals: tuple[tuple[str, float, float], ...]) -> Recordings:
    rng = np.random.default_rng(0)
    rows = [(number, "phase", *interval) for number in range(12) for interval in intervals]
    return Recordings.from_arrays(
        [rng.normal(size=(300, 6)).cumsum(0) for _ in range(12)], 200.0, annotations=rows,
        outcome=["success", "failure"] * 6,
    )  # fmt: skip


def test_what_lies_outside_is_as_if_it_were_not_there() -> None:
    plain, absurd = recordings(INTERVALS), recordings((*INTERVALS, *ABSURD))
    found = [[type(message) for message in play(one)] for one in (plain, absurd)]
    assert found[0] == found[1]
    assert found[0].count(Begin) == 12
    for one in (plain, absurd):
        names = np.array([*one.annotations.labels["phase"], ""])  # code -1 = nothing
        for codes in (one.annotations.of_samples(3, "phase", 300, 1 / 200), states_at_samples(one, 3)):
            assert names[codes].tolist() == ["a"] * 100 + ["b"] * 100 + [""] * 100


def test_an_interval_without_an_end_marks_no_sample() -> None:
    marks = Annotations.from_rows([(0, "phase", "a", 0.0, np.nan), (0, "phase", "b", 0.2, 0.3)])
    assert marks.of_samples(0, "phase", 5, 0.1).tolist() == [-1, -1, 1, -1, -1]


@pytest.mark.parametrize(
    "words",
    [
        ["stream", "a.zarr", "-m", "a.model", "--rate", "0", "-o", "events.jsonl"],
        ["report", "a.zarr", "-m", "a.model", "-o", "page.html"],
        ["export", "a.zarr", "--format", "mcap", "-o", "out"],
        ["train-online", "a.zarr", "--task", "phase", "-o", "b.model"],
        ["info", "a.zarr"],
    ],
)
def test_no_command_warns(
    tmp_path: Path, words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_recordings(Path("a.zarr"), recordings((*INTERVALS, *ABSURD)), {})
    model_files.save(Path("a.model"), model())
    assert main(words) == 0, capsys.readouterr().err
