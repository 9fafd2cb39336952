"""The authors' published feature matrices, recomputed from the recordings.

Rows carry no names, so a recomputed row must equal *some* published row. Published primitive features of
failures lack the first record of many axes (Q8); those axes must fit after dropping it, and nothing else may
differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rcbht_jax.labels import AXES
from rcbht_jax.reference import OfflineLabels
from rcbht_jax.reference import published_features as pub
from rcbht_jax.robots.snap_assembly import STATES
from tests.support.reference_cases import TWO_ARMS, encode_all, job, onset

# A trial of another set-up, which is not among the published ones.
UNPUBLISHED = "20120426-1732-SideApproach-S"
# Its state file is empty; any second state before 0.05 s gives the published labels.
EMPTY_STATES = "20160930-HIRO_ERROR-05"


def _trials(folder: Path) -> list[Path]:
    usable = [path for path in sorted(folder.iterdir()) if (path / "R_State.dat").is_file()]
    return [path for path in usable if path.name != UNPUBLISHED]


def _labels(trials: Sequence[Path], version: str, arm: str = "R") -> list[OfflineLabels]:
    states = [[0.0, 0.02] if path.name == EMPTY_STATES else None for path in trials]
    return encode_all([job(path, arm, version, given) for path, given in zip(trials, states, strict=True)])


@cache
def _columns(lengths: pub.Lengths, layer: str, axis: str = "") -> NDArray[np.bool_]:
    return np.array([name.startswith(f"{layer}_{axis}") for name in pub.feature_names(lengths)])


def _is_row(row: NDArray, matrix: NDArray) -> bool:
    return bool((matrix[:, :-1] == row).all(axis=1).any())


@pytest.mark.parametrize(
    ("folder", "matrix", "task", "count"),
    [
        ("REAL_HIRO_ONE_SA_SUCCESS", "real_one_arm", "real", 35),
        ("SIM_HIRO_ONE_SA_SUCCESS", "sim_one_arm", "sim", 28),
    ],
)
def test_every_success_is_published_cell_for_cell(
    folder: str, matrix: str, task: str, count: int, hiro_dir: Path, golden_dir: Path
) -> None:
    published = dict(np.load(golden_dir / "published_features" / f"{matrix}.npz"))
    trials = _trials(hiro_dir / folder)
    assert len(trials) == count
    for path, labels in zip(trials, _labels(trials, "a1ca1d1"), strict=True):
        outcome = pub.outcome_features(labels, pub.LENGTHS[f"{task}_outcome"])
        assert _is_row(outcome, published["success"]), path.name
        rows = pub.state_features(labels, onset(path), pub.LENGTHS[f"{task}_states"])
        for row, state in zip(rows, STATES, strict=True):
            assert _is_row(row, published[state]), (path.name, state)


@pytest.mark.parametrize(("arm", "side"), [("R", "right"), ("L", "left")])
def test_every_two_arm_state_is_published_cell_for_cell(arm: str, side: str, hiro_dir: Path, golden_dir: Path) -> None:
    published = dict(np.load(golden_dir / "published_features" / "sim_two_arm.npz"))
    trials = [path for path in _trials(hiro_dir / TWO_ARMS) if len(onset(path)) == 4]
    assert len(trials) == 13
    for path, labels in zip(trials, _labels(trials, "a1ca1d1", arm), strict=True):
        rows = pub.state_features(labels, onset(path), pub.LENGTHS[f"two_{side}_states"])
        for row, state in zip(rows, STATES, strict=True):
            assert _is_row(row, published[f"{side}_{state}"]), (path.name, state)


@pytest.mark.parametrize(
    ("folder", "matrix", "task", "version", "published_trials", "complete"),
    [
        ("REAL_HIRO_ONE_SA_ERROR_CHARAC", "real_one_arm", "real_outcome", "wip", 12, 9),
        ("SIM_HIRO_ONE_SA_ERROR_CHARAC_Prob", "sim_one_arm", "sim_outcome", "a642c8b", 186, 78),
    ],
)
def test_failures_are_published_but_for_lost_records(
    folder: str,
    matrix: str,
    task: str,
    version: str,
    published_trials: int,
    complete: int,
    hiro_dir: Path,
    golden_dir: Path,
) -> None:
    published = np.load(golden_dir / "published_features" / f"{matrix}.npz")["failure"][:, :-1]
    lengths = pub.LENGTHS[task]
    upper = ~_columns(lengths, "primitive")
    found, exact = 0, 0
    trials = _trials(hiro_dir / folder)
    for path, labels in zip(trials, _labels(trials, version), strict=True):
        recording = pub.sentences(labels)
        row = pub.feature_row(recording, lengths)
        candidates = published[(published[:, upper] == row[upper]).all(axis=1)]
        if not len(candidates):
            continue  # the published failures are a part of those recorded
        found += 1
        exact += bool((candidates == row).all(axis=1).any())
        fits = [_fits_with_lost_records(recording, candidate, lengths) for candidate in candidates]
        assert any(fits), path.name
    assert (found, exact) == (published_trials, complete)


def _fits_with_lost_records(recording: pub.Sentences, row: NDArray, lengths: pub.Lengths) -> bool:
    for axis, sentence in zip(AXES, recording["primitive"], strict=True):
        block = row[_columns(lengths, "primitive", axis)]
        whole = pub.resample(sentence, lengths.primitive)
        if np.array_equal(block, whole):
            continue
        rest = pub.resample(pub.Sentence(*(column[1:] for column in sentence)), lengths.primitive)
        if not np.array_equal(block, rest):
            return False
    return True
