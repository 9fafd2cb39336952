"""Least squares: it finds what SciPy finds, keeps to its bounds, and counts what it simulates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from rcbht_jax.errors import InputError
from sim_mjx.validation import gauss_newton
from sim_mjx.validation.gauss_newton import Iteration, Residuals
from sim_mjx.validation.system_id import Bound, Search, Values, fit

BOUNDS = {"a": Bound(-2.0, 2.0), "b": Bound(-1.0, 3.0)}


def rosenbrock(candidates: list[Values]) -> Residuals:
    return np.array([[10 * (v["b"] - v["a"] ** 2), 1 - v["a"]] for v in candidates])


def test_the_least_sum_is_scipys() -> None:
    found = gauss_newton.fit(rosenbrock, Search(BOUNDS, start={"a": -1.2, "b": 1.0}), iterations=60)
    theirs = least_squares(lambda x: [10 * (x[1] - x[0] ** 2), 1 - x[0]], [-1.2, 1.0])
    np.testing.assert_allclose([found.values["a"], found.values["b"]], theirs.x, atol=0.05)
    assert found.loss < 1e-3
    assert found.at_bound == []


def test_fewer_candidates_than_a_search_that_compares_losses() -> None:
    search = Search(BOUNDS, population=8, generations=100, start={"a": -1.2, "b": 1.0})
    found = gauss_newton.fit(rosenbrock, search, iterations=60)
    other = fit(lambda candidates: (rosenbrock(candidates) ** 2).sum(1), search)
    best = np.minimum.accumulate([generation.best for generation in other.generations])
    assert best[found.candidates // 8] > found.loss  # of a search that simulated as many


def test_a_bound_holds_and_is_told() -> None:
    bounds = {"a": Bound(-2.0, 0.5), "b": Bound(-1.0, 3.0)}
    found = gauss_newton.fit(rosenbrock, Search(bounds, start={"a": -1.2, "b": 1.0}), iterations=60)
    theirs = least_squares(
        lambda x: [10 * (x[1] - x[0] ** 2), 1 - x[0]], [-1.2, 1.0], bounds=([-2.0, -1.0], [0.5, 3.0])
    )
    assert found.at_bound == ["a"]
    assert found.values["a"] == pytest.approx(0.5)
    assert found.loss == pytest.approx(2 * theirs.cost, rel=0.05)


def test_every_candidate_is_counted_and_the_loss_only_falls() -> None:
    asked: list[int] = []
    seen: list[Iteration] = []

    def counted(candidates: list[Values]) -> Residuals:
        asked.append(len(candidates))
        return rosenbrock(candidates)

    search = Search(BOUNDS, start={"a": -1.2, "b": 1.0})
    found = gauss_newton.fit(counted, search, iterations=5, progress=lambda at, _: seen.append(at))
    assert found.candidates == sum(asked)
    assert asked[0] == 1
    assert set(asked[1::2]) == {2}  # the differences
    assert seen == found.iterations
    losses = [at.loss for at in seen]
    assert losses == sorted(losses, reverse=True)


def test_a_parameter_without_effect_and_a_simulation_that_fails_do_no_harm() -> None:
    def partly(candidates: list[Values]) -> Residuals:
        out = np.array([[v["a"] - 0.3] for v in candidates])
        return np.where(np.array([[v["a"] > 0.4] for v in candidates]), np.nan, out)

    found = gauss_newton.fit(partly, Search(BOUNDS, start={"a": -1.5, "b": 1.0}), iterations=30)
    assert found.values["a"] == pytest.approx(0.3, abs=0.01)
    assert found.values["b"] == pytest.approx(1.0)


def test_the_spectrum_and_deviations_are_those_of_linear_regression() -> None:
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(200, 3)) * [1.0, 5.0, 0.2]
    said = gauss_newton.identifiability(jacobian, ["x", "y", "z"], 2.0, 200.0)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * 2.0 / 197
    np.testing.assert_allclose(list(said["deviation"].values()), np.sqrt(np.diag(covariance)))
    np.testing.assert_allclose(np.square(said["spectrum"]), np.linalg.eigvalsh(jacobian.T @ jacobian)[::-1])
    assert max(said["weakest"], key=lambda name: abs(said["weakest"][name])) == "z"


SEEN = np.array([[1.0, 0.2], [0.3, 1.0], [0.5, 0.1], [0.2, 0.7]])


@pytest.mark.parametrize(
    ("jacobian", "undetermined"),
    [
        (np.array([[1.0, 0.0], [2.0, 0.0]]), [1]),
        (np.insert(SEEN, 1, 0.0, axis=1), [1]),
        (np.insert(SEEN, [1, 1], SEEN @ [[0.3, 0.1], [0.0, 0.0]], axis=1), [0, 1, 2]),  # only a sum of three is seen
        (np.array([[1.0, 1.0, 0.0]]), [0, 1, 2]),  # fewer residuals than parameters
        (np.array([[1.0, 0.0, 0.0]]), [1, 2]),
        (np.zeros((3, 2)), [0, 1]),
    ],
)
def test_what_the_residuals_do_not_determine_has_no_deviation(
    jacobian: gauss_newton.Jacobian, undetermined: list[int]
) -> None:
    names = [str(place) for place in range(jacobian.shape[1])]
    said = gauss_newton.identifiability(jacobian, names, 1.0, 10.0)
    assert [int(name) for name, value in said["deviation"].items() if value is None] == undetermined
    variance = np.diag(np.linalg.pinv(jacobian.T @ jacobian)) / (10 - len(names))
    found = np.array(list(said["deviation"].values()), np.float64)  # None becomes NaN
    np.testing.assert_allclose(np.delete(found, undetermined), np.sqrt(np.delete(variance, undetermined)))
    assert len(said["spectrum"]) == len(names)
    assert said["weakest"]


def test_a_start_that_cannot_be_simulated_is_refused() -> None:
    with pytest.raises(InputError, match="simulation of the start gives no finite residuals"):
        gauss_newton.fit(lambda candidates: np.full((len(candidates), 2), np.nan), Search(BOUNDS))


@pytest.mark.parametrize(("iterations", "step"), [(0, 0.02), (5, 0.0), (5, 0.9)])
def test_impossible_settings_are_refused(iterations: int, step: float) -> None:
    with pytest.raises(InputError, match=f"iterations is {iterations} and step {step}"):
        gauss_newton.fit(rosenbrock, Search(BOUNDS), iterations=iterations, step=step)


def test_fits_in_step_are_those_alone_in_fewer_batches() -> None:
    searches = [Search(BOUNDS, start={"a": a, "b": 1.0}) for a in (-1.2, 0.3, 1.9)]
    batches: list[int] = []

    def counted(candidates: list[Values]) -> Residuals:
        batches.append(len(candidates))
        return rosenbrock(candidates)

    seen: list[int] = []
    together = gauss_newton.fit_together(counted, searches, iterations=20, progress=lambda n, *_: seen.append(n))
    alone = [gauss_newton.fit(rosenbrock, search, iterations=20) for search in searches]
    assert [found.values for found in together] == [found.values for found in alone]
    assert sum(batches) == sum(found.candidates for found in alone)
    assert len(batches) == max(1 + 2 * len(found.iterations) for found in alone)
    assert set(seen) == {0, 1, 2}


def test_a_simulation_that_fails_ends_every_fit() -> None:
    def broken(candidates: list[Values]) -> Residuals:
        if len(candidates) > 3:
            raise InputError("The device is gone.")
        return rosenbrock(candidates)

    searches = [Search(BOUNDS, start={"a": a, "b": 1.0}) for a in (-1.2, 0.3, 1.9)]
    with pytest.raises(InputError, match="device is gone"):
        gauss_newton.fit_together(broken, searches)


def test_what_progress_of_fits_in_step_raises_ends_them() -> None:
    searches = [Search(BOUNDS, start={"a": a, "b": 1.0}) for a in np.linspace(-1.9, 1.9, 8).tolist()]
    seen: list[int] = []

    def broken(number: int, at: Iteration, _values: Values) -> None:
        seen.append(at.candidates)
        if number == 5:
            raise InputError("The disk is full.")

    with pytest.raises(InputError, match="disk is full"):
        gauss_newton.fit_together(rosenbrock, searches, iterations=20, progress=broken)
    assert set(seen) == {1}


def test_no_search_is_refused() -> None:
    with pytest.raises(InputError, match="at least one"):
        gauss_newton.fit_together(rosenbrock, [])
