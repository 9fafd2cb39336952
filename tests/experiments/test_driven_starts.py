"""The search from many starts, on an objective that costs nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from experiments.simulation import driven_starts
from sim_mjx.validation import system_id
from sim_mjx.validation.gauss_newton import Residuals
from sim_mjx.validation.system_id import Bound, Search, Values

BOUNDS = {"x": Bound(-2.0, 2.0), "y": Bound(-1.0, 1.0)}


class Bowl:
    """Curved valleys whose ends are at (1, .5) and (-1, .5); counts what it simulates."""

    def __init__(self) -> None:
        self.simulated = 0

    def __call__(self, candidates: list[Values]) -> Residuals:
        self.simulated += len(candidates)
        return np.array([[v["x"] ** 2 - 1, 0.3 * (v["y"] - v["x"] ** 2 / 2), 0.05 * (v["x"] - 1)] for v in candidates])


def starts() -> list[Search]:
    return [Search(BOUNDS, start={"x": -1.9, "y": -0.9}), Search(BOUNDS, start={"x": 0.3, "y": 0.9})]


def test_candidates_are_drawn_around_every_start_and_begin_with_them():
    around = starts()
    points = np.array([
        system_id.point_of(replace(around[0], start=values)) for values in driven_starts.drawn(around, 400, 3)
    ])  # fmt: skip
    first = np.array([system_id.point_of(one) for one in around])
    assert np.allclose(points[:2], first)
    for turn in (0, 1):
        near = np.median(points[2 + turn :: 2], axis=0)
        assert np.abs(near - first[turn]).max() < np.abs(near - first[1 - turn]).max()


def test_fits_that_were_cut_off_are_gone_on_with_and_count_on():
    objective, kept = Bowl(), []

    class Cut(Exception):
        pass

    def cut_at_the_fifth(found: dict[str, Any]) -> None:
        kept.append({**found, "fits": [dict(fit) for fit in found["fits"]]})
        if len(kept) == 5:
            raise Cut

    begun = driven_starts.best_drawn(objective, starts(), 16, 2, 0)
    with pytest.raises(Cut):
        driven_starts.fitted(objective, starts()[0], begun, 12, cut_at_the_fifth)
    left = kept[-1]
    done = [fit["iterations"] for fit in left["fits"]]
    assert min(done) >= 1
    ends: list[Any] = []
    driven_starts.fitted(objective, starts()[0], left, 12, ends.append)
    best = ends[-1]["fits"][0]
    assert best["loss"] < 1e-6
    assert best["values"]["x"] == pytest.approx(1.0, abs=0.01)
    assert min(fit["iterations"] for fit in ends[-1]["fits"]) == 12
    before = objective.simulated
    driven_starts.fitted(objective, starts()[0], ends[-1], 12, ends.append)  # nothing is left to do
    assert objective.simulated == before
