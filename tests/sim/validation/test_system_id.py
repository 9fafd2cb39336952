"""The search for physical parameters: it finds optima, keeps to its bounds, and resumes to the same result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rcbht_jax.cli import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import read_attrs, read_simulation
from sim_mjx.presets import preset
from sim_mjx.randomization import overrides
from sim_mjx.randomization.trials import DomainRandomization, sample
from sim_mjx.validation.system_id import Bound, Fit, Generation, Search, _mirrored, _share, fit, values_of

BOUNDS = {"a": Bound(-2.0, 5.0), "b": Bound(1e-3, 1e3, log=True), "c": Bound(0.0, 1.0), "d": Bound(-1.0, 1.0)}
OPTIMUM = {"a": 1.5, "b": 20.0, "c": 0.9, "d": -0.2}
SEARCH = Search(BOUNDS, population=10, generations=60, seed=3)


def bowl(candidates: list[dict[str, float]]) -> NDArray[np.float64]:
    """An ellipsoid about the optimum, a hundred times steeper along one parameter, turned into another one."""
    u = np.array([[_share(c[n], b) - _share(OPTIMUM[n], b) for n, b in BOUNDS.items()] for c in candidates])
    u[:, 0] += u[:, 1]
    return (u**2 * [1.0, 10.0, 100.0, 1.0]).sum(1)


def test_it_finds_the_optimum_of_an_ill_conditioned_bowl() -> None:
    found = fit(bowl, replace(SEARCH, generations=150))
    for name, value in OPTIMUM.items():
        assert found.values[name] == pytest.approx(value, rel=1e-3)
    assert found.loss < 1e-7
    assert found.generations[-1].step < 1e-2 < found.generations[0].step


def test_an_optimum_on_a_bound_is_found_and_no_bound_is_passed() -> None:
    seen: list[dict[str, float]] = []

    def slope(candidates: list[dict[str, float]]) -> NDArray[np.float64]:
        seen.extend(candidates)
        return np.array([c["a"] - np.log(c["b"]) for c in candidates])

    found = fit(slope, Search({"a": BOUNDS["a"], "b": BOUNDS["b"]}, 8, 60, seed=1))
    assert found.values["a"] == pytest.approx(-2.0, abs=1e-2)
    assert found.values["b"] == pytest.approx(1e3, rel=1e-2)
    assert all(BOUNDS[name].low <= value <= BOUNDS[name].high for c in seen for name, value in c.items())


def test_candidates_without_a_loss_are_the_worst() -> None:
    def holed(candidates: list[dict[str, float]]) -> NDArray[np.float64]:
        return np.where([c["c"] < 0.5 for c in candidates], np.nan, bowl(candidates))

    assert fit(holed, SEARCH).values["c"] == pytest.approx(OPTIMUM["c"], abs=1e-2)
    with pytest.raises(InputError, match="No candidate of the search had a finite loss"):
        fit(lambda candidates: np.full(len(candidates), np.nan), replace(SEARCH, generations=2))


def test_interrupted_anywhere_it_ends_the_same(tmp_path: Path) -> None:
    whole = fit(bowl, replace(SEARCH, generations=12))

    def stop_after(limit: int) -> None:
        def progress(now: Generation, _: Fit) -> None:
            if now.number == limit:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            fit(bowl, replace(SEARCH, generations=12), checkpoint=tmp_path / "c.json", progress=progress)

    stop_after(3)
    stop_after(7)
    assert fit(bowl, replace(SEARCH, generations=12), checkpoint=tmp_path / "c.json") == whole
    longer = fit(bowl, replace(SEARCH, generations=14), checkpoint=tmp_path / "c.json")
    assert longer.generations[:12] == whole.generations
    assert [path.name for path in tmp_path.iterdir()] == ["c.json"]


def test_a_foreign_or_damaged_checkpoint_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    fit(bowl, replace(SEARCH, generations=2), checkpoint=path)
    with pytest.raises(InputError, match=r"other data or options \(about.session null, not \"A\"\)"):
        fit(bowl, replace(SEARCH, generations=2, about={"session": "A"}), checkpoint=path)
    text = path.read_text()
    for damaged in (text[: len(text) // 2], "[]", "{}"):
        path.write_text(damaged)
        with pytest.raises(InputError, match="damaged"):
            fit(bowl, replace(SEARCH, generations=2), checkpoint=path)


@pytest.mark.parametrize(
    ("search", "sentence"),
    [
        (Search({}), "at least one parameter"),
        (replace(SEARCH, population=3), "population is 3"),
        (replace(SEARCH, spread=0.0), "spread 0.0"),
        (Search({"a": Bound(1.0, 1.0)}), "range of a"),
        (Search({"a": Bound(-1.0, 1.0, log=True)}), "positive if log"),
        (replace(SEARCH, start={"c": 2.0}), "starts at c = 2.0"),
    ],
)
def test_impossible_searches_are_one_sentence(search: Search, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        fit(bowl, search)


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=5))
def test_mirroring_keeps_inside_and_leaves_inner_points(point: list[float]) -> None:
    folded = _mirrored(np.array(point))
    assert ((folded >= 0) & (folded <= 1)).all()
    inner = np.array([0 <= x <= 1 for x in point])
    np.testing.assert_allclose(folded[inner], np.array(point)[inner], atol=1e-12)
    np.testing.assert_allclose(_mirrored(-np.array(point)), folded, atol=1e-12)


@given(st.floats(0, 1))
def test_shares_and_values_are_inverse(share: float) -> None:
    for name, bound in BOUNDS.items():
        value = values_of(np.array([share]), {name: bound})[name]
        assert _share(value, bound) == pytest.approx(share, abs=1e-9)


def test_named_parameters_reach_the_trial_and_nothing_else_changes() -> None:
    exact = {"stiffness": (1.0, 1.0), "overlap": (1.0, 1.0), "friction": (1.0, 1.0), "mount": (1.0, 1.0)}
    spec = DomainRandomization(nominal_share=1.0, **exact)
    chosen = (
        ("parts.hook_overlap", 4e-4),
        ("parts.hook_overlap[2:4]", 6e-4),
        ("parts.mount_stiffness[2]", 5e3),
        ("parts.friction", 0.3),
        ("sensor.delay", 5.6),
    )
    before, _ = sample(preset("B"), 1, 2, spec)
    after, _ = sample(preset("B"), 1, 2, replace(spec, physical=chosen))
    np.testing.assert_array_equal(after.parts.hook_overlap, [4e-4, 4e-4, 6e-4, 6e-4])
    np.testing.assert_array_equal(after.parts.mount_stiffness, [*before.parts.mount_stiffness[:2], 5e3])
    assert (float(after.parts.friction), int(after.sensor.delay)) == (0.3, 6)
    np.testing.assert_array_equal(after.task.way_position, before.task.way_position)
    np.testing.assert_array_equal(after.sensor.bias, before.sensor.bias)
    np.testing.assert_array_equal(after.parts.tab_stiffness, before.parts.tab_stiffness)


@pytest.mark.parametrize(
    ("pair", "sentence"),
    [
        (("parts.colour", 1.0), "no physical parameter 'parts.colour'"),
        (("friction", 1.0), "no physical parameter 'friction'"),
        (("sensor.step", 0.0), "sensor.step is 0; expected more than zero"),
        (("parts.hook_overlap[4]", 1.0), "does not exist"),
        (("parts.friction[0]", 1.0), "does not exist"),
        (("parts.hook_overlap[2:2]", 1.0), "does not exist"),
        (("parts.friction", float("nan")), "finite number"),
        (("parts.friction", 1e300), "friction is 1e\\+300; expected a finite number up to 1e\\+30"),
        (("sensor.bias", -3.4e38), "bias is -3.4e\\+38; expected a finite number"),
        (("parts.friction", -1.0), "friction must be positive"),
        (("sensor.noise[1]", -1.0), "expected zero or more"),
        (("sensor.delay", 1e18), "expected 0 to 11 control periods"),
        (("sensor.delay", 12.0), "expected 0 to 11 control periods"),
        (("sensor.delay", -1.0), "expected 0 to 11 control periods"),
    ],
)
def test_wrong_parameters_are_one_sentence(pair: tuple[str, float], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        sample(preset("A"), 0, 0, DomainRandomization(physical=(pair,)))


def test_simulate_takes_a_parameter_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "fit.json", tmp_path / "t.zarr"
    overrides.write(path, {"parts.friction": 0.123}, {})
    words = ["simulate", str(out), "--preset", "C", "--trials", "2", "--max-seconds", "0.1", "--nominal-share", "1"]
    assert main.main([*words, "--physical", str(path)]) == 0
    simulation = read_simulation(out)
    low, high = DomainRandomization().friction
    assert ((simulation["friction"] >= 0.123 * low) & (simulation["friction"] <= 0.123 * high)).all()
    assert read_attrs(out)["simulated"]["job"]["spec"]["physical"] == [["parts.friction", 0.123]]
    path.write_text('{"format": "rcbht-physical", "values": {"parts.friction": 1e300}}')
    assert main.main([*words, "--overwrite", "--physical", str(path)]) == 2
    assert "expected a finite number up to 1e+30" in capsys.readouterr().err
    path.write_text("{}")
    assert main.main([*words, "--overwrite", "--physical", str(path)]) == 2
    assert "holds no physical parameters" in capsys.readouterr().err


def test_parameter_files_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "b.json"
    values = {"parts.friction": 0.1 + 0.2, "sensor.delay": 7.0}
    overrides.write(path, values, {"session": "B"})
    assert dict(overrides.read(path)) == values
    assert overrides.value(preset("A").parts, preset("B").sensor, "sensor.delay") == 11.0
    parts = preset("A").parts
    assert overrides.value(parts, preset("A").sensor, "parts.mount_stiffness") == np.mean(parts.mount_stiffness)
    with pytest.raises(InputError, match=r"parts\.friction is nan"):
        overrides.write(path, {"parts.friction": np.nan}, {})
    for text in ("", '{"format": "other", "values": {}}',
                 '{"format": "rcbht-physical", "values": {"parts.friction": "much"}}',
                 '{"format": "rcbht-physical", "values": {"parts.friction": "0.3"}}'):  # fmt: skip
        path.write_text(text)
        with pytest.raises(InputError, match="holds no physical parameters"):
            overrides.read(path)
