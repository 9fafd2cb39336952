"""The signature metric reproduces the published table and the golden profiles, and its parts obey their definitions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import wasserstein_distance

from rcbht_jax.errors import InputError
from rcbht_jax.robots.snap_assembly import HARMONISED, snap_recordings
from rcbht_jax.types import Recordings
from sim_mjx.validation.signature import Similarity, _warping, _wasserstein, compare, profiles, signature_figure
from tests.support.snaps import marked

Floats = NDArray[np.float64]

# Reference, test -> coverage, W1/sd, DTW/sd: the baselines measured with the design, three digits.
BASELINES = {
    ("real_B", "real_A"): (0.641, 0.746, 0.674),
    ("real_A", "real_B"): (0.209, 1.436, 0.988),
    ("real_A", "sim_success"): (0.200, 1.988, 1.421),
    ("real_B", "sim_success"): (0.464, 1.370, 1.111),
    ("real_B_seated", "real_fail"): (0.315, 1.349, 1.332),
}
# One generator with seed 0 shuffles the groups in this order; even places against odd places.
HALVES = {
    "real_A": (0.911, 0.063, 0.062),
    "real_B": (0.871, 0.262, 0.112),
    "sim_success": (0.895, 0.090, 0.110),
}
# Group of the golden file -> data set, session, number of the first trial.
GROUPS = {
    "real_A": ("REAL_HIRO_ONE_SA_SUCCESS", "A", 1),
    "real_B": ("REAL_HIRO_ONE_SA_SUCCESS", "B", 22),
    "real_fail": ("REAL_HIRO_ONE_SA_ERROR_CHARAC", "C", None),
    "sim_success": ("SIM_HIRO_ONE_SA_SUCCESS", "SIM1", None),
}


@pytest.fixture(scope="module")
def golden(golden_dir: Path) -> dict[str, Floats]:
    """Profiles [n, 4, 100, 6] of all trials of each group."""
    with np.load(golden_dir / "signatures" / "signatures.npz") as file:
        names = [name for name in file.files if name.endswith("__harm__all")]
        return {name.removesuffix("__harm__all"): file[name].astype(float) for name in names}


def _triple(score: Similarity) -> tuple[float, ...]:
    return tuple(round(value, 3) for value in (score.coverage, score.w1_over_sd, score.dtw_over_sd))


@pytest.mark.parametrize("pair", BASELINES)
def test_published_baselines(golden: dict[str, Floats], pair: tuple[str, str]) -> None:
    assert _triple(compare(golden[pair[0]], golden[pair[1]])) == BASELINES[pair]


def test_published_halves(golden: dict[str, Floats]) -> None:
    rng = np.random.default_rng(0)
    for group, expected in HALVES.items():
        order = rng.permutation(len(golden[group]))
        assert _triple(compare(golden[group][order[::2]], golden[group][order[1::2]])) == expected, group


@pytest.mark.parametrize("group", GROUPS)
def test_profiles_equal_golden(golden: dict[str, Floats], hiro_recordings: Recordings, group: str) -> None:
    source, session, first = GROUPS[group]
    usable = (hiro_recordings.source == source) & (hiro_recordings.session == session)
    usable &= np.isfinite(hiro_recordings.starts(HARMONISED)).all(axis=1)
    usable &= np.char.find(hiro_recordings.note.astype(str), "other-setup") < 0
    rows = np.flatnonzero(usable)
    assert len(rows) >= 8
    ours = profiles(hiro_recordings, rows)
    for row, profile in zip(rows, ours, strict=True):
        gap = np.abs(golden[group] - profile).max(axis=(2, 3))
        match = int(gap.sum(axis=1).argmin())
        if first is not None:
            assert match == int(str(hiro_recordings.trial[row])[-2:]) - first
        # The golden boundary of a few trials of B and C is one sample off; everything else is equal.
        limits = [0.001, 0.35, 0.35, 0.001] if group in ("real_B", "real_fail") else [0.001] * 4
        assert (gap[match] < limits).all(), (hiro_recordings.trial[row], gap[match])
    exact = [np.abs(golden[group] - profile).max(axis=(1, 2, 3)).min() < 0.001 for profile in ours]
    assert np.mean(exact) >= 0.7


@pytest.fixture
def ramp() -> Recordings:
    """Two records of 2 s whose axes are ramps of the time, so that every profile is known."""
    time = np.arange(401) * 0.005
    wrench = np.repeat((time[:, None] * np.arange(1, 7))[None], 2, axis=0).astype(np.float32)
    text = np.array(["one", "two"], np.str_)
    onset = np.array([[0.0, 0.3, 0.31, 0.8], [0.0, 0.3, 0.31, 1.5]])
    return snap_recordings(
        wrench=wrench,
        length=np.array([401, 401], np.int32),
        dt=0.005,
        onset=onset,
        onset_harmonised=onset + np.array([0.0, 0.0, 0.2, 0.0]),
        trial=text,
        arm=text,
        source=text,
        session=text,
        outcome=text,
        failure_type=text,
        deviation=np.zeros((2, 3)),
        note=text,
    )


def test_profiles_of_ramps(ramp: Recordings) -> None:
    got = profiles(ramp)
    for row, edges in enumerate([(0, 0.3, 0.51, 0.8, 1.8), (0, 0.3, 0.51, 1.5, 2.0)]):
        for state in range(4):
            expected = np.linspace(edges[state], edges[state + 1], 100)[:, None] * np.arange(1, 7)
            np.testing.assert_allclose(got[row, state], expected, atol=1e-5)
    np.testing.assert_array_equal(profiles(ramp, [1]), got[1:])


def test_profiles_mistakes(ramp: Recordings) -> None:
    onset = ramp.starts(HARMONISED)
    onset[1, 3] = np.nan
    broken = marked(ramp, onset_harmonised=onset)
    with pytest.raises(InputError, match=r"insertion state of recording 1 \(two\)"):
        profiles(broken)
    assert profiles(broken, [0]).shape == (1, 4, 100, 6)
    onset[1, 3] = 2.0
    with pytest.raises(InputError, match=r"mating state of recording 1 \(two\)"):
        profiles(marked(ramp, onset_harmonised=onset))
    with pytest.raises(InputError, match="rows is empty"):
        profiles(ramp, [])


def test_wasserstein_equals_scipy() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(50, 3)), rng.gamma(2.0, size=(37, 3)).round(1)
    expected = [wasserstein_distance(a[:, i], b[:, i]) for i in range(3)]
    np.testing.assert_allclose(_wasserstein(a, b), expected, rtol=1e-12)


def _slow_warping(a: Floats, b: Floats) -> float:
    total = np.full((101, 101), np.inf)
    total[0, 0] = 0.0
    for i in range(100):
        for j in range(max(0, i - 15), min(100, i + 16)):
            total[i + 1, j + 1] = abs(a[i] - b[j]) + min(total[i, j], total[i, j + 1], total[i + 1, j])
    return float(total[100, 100] / 100)


def test_warping_equals_recursion() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 3, 100)).cumsum(axis=-1)
    np.testing.assert_allclose(_warping(a, b), [_slow_warping(x, y) for x, y in zip(a, b, strict=True)], rtol=1e-12)


def test_warping_forgives_shifts_within_its_band() -> None:
    pulse = np.zeros((1, 100))
    pulse[0, 30:40] = 1.0
    assert _warping(pulse, np.roll(pulse, 15)) == 0.0
    assert _warping(pulse, np.roll(pulse, 16)) > 0.0


def test_equal_and_shifted_sets() -> None:
    x = np.random.default_rng(3).normal(size=(40, 4, 100, 6))
    same = compare(x, x)
    assert same.coverage > 0.9
    assert (same.w1_table == 0).all()
    assert (same.dtw_table == 0).all()
    shifted = compare(x, x + 100 * x.std())
    assert shifted.coverage == 0
    np.testing.assert_allclose(shifted.w1_table, 100, rtol=0.05)
    moved = x.copy()
    moved[:, 2, :, 4] += 100
    apart = np.argwhere(compare(x, moved).w1_table > 50)
    assert apart.tolist() == [[2, 4]]


def test_comparison_mistakes() -> None:
    x = np.random.default_rng(4).normal(size=(5, 4, 100, 6))
    with pytest.raises(InputError, match=r"test profiles have shape \(5, 4, 99, 6\)"):
        compare(x, x[:, :, 1:])
    with pytest.raises(InputError, match="reference profiles have shape"):
        compare(x[:0], x)
    broken = x.copy()
    broken[0, 0, 0, 0] = np.nan
    with pytest.raises(InputError, match="test profiles are not finite"):
        compare(x, broken)
    flat = x.copy()
    flat[:, 1, :, 2] = 7.0
    with pytest.raises(InputError, match="Fz is constant in state rotation"):
        compare(flat, x)


def test_figure_shows_both_medians(golden: dict[str, Floats]) -> None:
    reference, test = golden["real_A"], golden["sim_success"]
    figure = signature_figure(reference, test, "A against OpenHRP", ("session A", "OpenHRP"))
    assert len(figure.axes) == 24
    panel = figure.axes[2 * 4 + 3]  # Fz, mating
    for line, values in zip(panel.lines, (reference, test), strict=True):
        np.testing.assert_allclose(line.get_ydata(), np.median(values[:, 3, :, 2], axis=0))
    assert "0.20" in figure.get_suptitle()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["session A (n = 21)", "OpenHRP (n = 38)"]
