"""Rules of early classification against cases that are computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.kernel_ridge import KernelRidge

from experiments._lib import early

DELAY = np.array([0.5, 1.0])


def beliefs(*largest: list[float]) -> np.ndarray:
    """Beliefs of two classes, the second of which has these probabilities ``[time][item]``."""
    second = np.array(largest)
    return np.stack([1 - second, second], 2)


def test_economy_waits_where_errors_become_fewer() -> None:
    """Half of the items are unsure at first, and wrong; all are right at the end."""
    seen = beliefs([0.9, 0.9, 0.6, 0.6], [0.9, 0.9, 0.9, 0.9])
    seen[0, 2:] = seen[0, 2:, ::-1]  # the unsure ones say the other class
    y = np.ones(4, int)
    # Two groups. Cost of the sure one: now .5 * 0 + .5 * .5 = .25, later .5. Of the unsure one: now w + (1 - w) / 2,
    # later 1 - w; waiting pays where w / 2 > 1 / 4 - ... , that is w + (1 - w) / 2 > 1 - w, w > 1 / 3.
    assert early.economy(seen, y, DELAY, 0.5, 2)(seen).tolist() == [0, 0, 1, 1]
    assert early.economy(seen, y, DELAY, 0.34, 2)(seen).tolist() == [0, 0, 1, 1]
    assert early.economy(seen, y, DELAY, 0.33, 2)(seen).tolist() == [0, 0, 0, 0]
    # One group: half of the items are wrong now. w / 2 + (1 - w) / 2 > 1 - w where w > 1 / 2.
    assert early.economy(seen, y, DELAY, 0.49, 1)(seen).tolist() == [0, 0, 0, 0]
    assert early.economy(seen, y, DELAY, 0.51, 1)(seen).tolist() == [1, 1, 1, 1]


def test_calimera_goes_backwards() -> None:
    """The middle time is worse than both others; its rule waits, so that the first compares with the last."""
    seen = beliefs([0.6] * 3, [0.55] * 3, [0.95] * 3)
    delay = np.array([0.2, 0.6, 1.0])
    # .4 w + .2 (1 - w), .45 w + .6 (1 - w), .05 w + (1 - w): the last is below the first where .35 w > .8 (1 - w).
    assert early.calimera(seen, delay, 0.69)(seen).tolist() == [0, 0, 0]
    assert early.calimera(seen, delay, 0.70)(seen).tolist() == [2, 2, 2]


@pytest.mark.parametrize("name", ["economy", "calimera", "certain"])
def test_no_rule_looks_ahead(name: str) -> None:
    rng = np.random.default_rng(0)
    seen = rng.dirichlet(np.ones(3), (5, 40))
    y, delay = rng.integers(0, 3, 40), np.linspace(0.2, 1, 5)
    rule = {
        "economy": lambda: early.economy(seen, y, delay, 0.8, 3),
        "calimera": lambda: early.calimera(seen, delay, 0.8),
        "certain": lambda: early.certain(0.7),
    }[name]()
    changed = seen.copy()
    changed[3:] = rng.dirichlet(np.ones(3), (2, 40))
    at, then = rule(seen), rule(changed)
    assert (at < 3).any()
    assert (at[at < 3] == then[at < 3]).all()
    assert (then[at >= 3] >= 3).all()


def test_what_decisions_are_worth() -> None:
    seen = beliefs([0.6, 0.4], [0.9, 0.9])
    accuracy, earliness, mean = early.worth(seen, np.array([1, 1]), DELAY, early.certain(0.8)(seen))
    assert (accuracy, earliness, mean) == (1.0, 1.0, 0.0)
    accuracy, earliness, mean = early.worth(seen, np.array([1, 1]), DELAY, np.array([0, 1]))
    assert (accuracy, earliness, mean) == (1.0, 0.75, 0.4)


def stops(seen: np.ndarray, y: np.ndarray, delay: np.ndarray, weight: float, groups: int, new: np.ndarray) -> list[int]:
    """ECONOMY-gamma by loops: the first time whose expected cost no later one undercuts, of each new item."""
    edges = [np.quantile(row.max(1), np.arange(1, groups) / groups) for row in seen]

    def group(now: int, belief: np.ndarray) -> int:
        return sum(belief.max() >= edge for edge in edges[now])

    items = range(len(y))
    member = [[group(now, row[item]) for item in items] for now, row in enumerate(seen)]

    def those(now: int, one: int) -> list[int]:
        """Items of a group; of an empty one, all."""
        return [item for item in items if member[now][item] == one] or list(items)

    def cost(now: int, one: int, then: int) -> float:
        where = {one: 1.0}
        for time in range(now, then):
            further = dict.fromkeys(range(groups), 0.0)
            for start, share in where.items():
                for item in those(time, start):
                    further[member[time + 1][item]] += share / len(those(time, start))
            where = further
        wrong = sum(
            share * np.mean([seen[then, item].argmax() != y[item] for item in those(then, end)])
            for end, share in where.items()
        )
        return weight * wrong + (1 - weight) * delay[then]

    last = len(delay) - 1
    return [
        next(
            now
            for now in range(last + 1)
            for one in [group(now, new[now, item])]
            if all(cost(now, one, now) <= cost(now, one, then) + 1e-12 for then in range(now, last + 1))
        )
        for item in range(new.shape[1])
    ]


@pytest.mark.parametrize("seed", range(6))
def test_economy_is_that_of_its_definition(seed: int) -> None:
    """At two times, beliefs have so few values that a group is empty into which new ones may fall."""
    rng = np.random.default_rng(seed)
    y, new, delay = rng.integers(0, 2, 30), rng.random((4, 30)), np.array([0.1, 0.3, 0.6, 1.0])
    sure = np.where(rng.random((4, 30)) < np.array([[0.5], [0.6], [0.7], [0.9]]), y, 1 - y)  # of the true class
    second = np.where(sure == 1, 0.5, 0) + rng.random((4, 30)) / 2
    second[::2] = np.where(sure[::2] == 1, 0.7, 0.3) + rng.integers(-1, 2, (2, 30)) / 20
    seen, new = np.stack([1 - second, second], 2), np.stack([1 - new, new], 2)
    found = early.economy(seen, y, delay, 0.7, 4)(new)
    assert found.tolist() == stops(seen, y, delay, 0.7, 4, new)


def test_calimera_reads_the_beliefs_the_largest_and_its_distance_from_the_next() -> None:
    rng = np.random.default_rng(3)
    seen, new = np.stack([rng.dirichlet(np.ones(4) / some, (2, 40)) for some in (2, 20)], 1)

    def described(belief: np.ndarray) -> np.ndarray:
        return np.array([[*row, max(row), max(row) - sorted(row)[-2]] for row in belief])

    cost = 0.7 * (1 - seen.max(2)) + 0.3 * DELAY[:, None]
    waits = KernelRidge(kernel="rbf").fit(described(seen[0]), cost[1] - cost[0]).predict(described(new[0])) < 0
    assert 5 < waits.sum() < 35
    np.testing.assert_array_equal(early.calimera(seen, DELAY, 0.7)(new), waits)
