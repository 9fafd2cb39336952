"""Damaged files of nominal monitors are refused when they are read, not where a score fails."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcbht_jax.errors import InputError
from rcbht_jax.introspection import nominal_file
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.learning.model_io import reading, write_archive

RNG = np.random.default_rng(0)
MONITOR = NominalMonitor().fit(RNG.normal(size=(9, 30, 2)))
VALUES = [
    ("neighbours", ""), ("slack", []), ("drift", 10**19), ("reach", -1), ("axes", ["Fz"]), ("units", ["N"]),
    ("levels", [2]), ("parameters", []),
]  # fmt: skip
PARAMETERS = [
    ("rate", None), ("score_rate", None), ("memory", 10**18), ("baseline", "x"), ("baseline", [1]), ("drift", None),
    ("lags", "aaa"), ("lags", [2**63, 0.4]),
]  # fmt: skip
ARRAYS: list[tuple[str, Any]] = [
    ("described", lambda values: np.zeros(values.shape, np.int32)), ("described", lambda values: values * np.nan),
    ("scale", lambda values: values[:, :1]), ("scale", np.zeros_like), ("reference", np.zeros_like),
    ("peaks", lambda values: values[:, None]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("part", "name", "damage"),
    [(part, *one) for part, some in (("meta", VALUES), ("parameters", PARAMETERS), ("arrays", ARRAYS)) for one in some],
)
def test_a_damaged_file_is_refused_in_one_sentence(part: str, name: str, damage: Any, tmp_path: Path) -> None:
    path = tmp_path / "nominal.monitor"
    nominal_file.save(path, nominal_file.MonitorFile(MONITOR, ("Fz", "Mx"), ()))
    with reading(path, nominal_file.FORMAT, gaps=("described",)) as (meta, archive):
        arrays = dict(archive)
        if part == "arrays":
            arrays[name] = damage(arrays[name])
        else:
            (meta if part == "meta" else meta["parameters"])[name] = damage
        write_archive(path, meta, arrays)
    with pytest.raises(InputError, match=r"nominal\.monitor is "):
        nominal_file.load(path)


def test_scores_are_finite_for_all_samples_that_a_store_may_hold() -> None:
    series = np.where(np.arange(30)[:, None] < 15, 0.0, [1e30, -1e30])
    assert np.isfinite(MONITOR.scores(series)).all()
