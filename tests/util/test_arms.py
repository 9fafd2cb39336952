"""Arms of any names: which is meant where none is named, and what is said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rcbht_jax import FeatureSpec, Recordings, TaskSpec, encode
from rcbht_jax._util.arms import chosen_arm
from rcbht_jax.errors import InputError
from rcbht_jax.io.messages import Sample
from rcbht_jax.io.playback import play
from rcbht_jax.learning.tasks import extract_features, labelled_intervals, unlabelled_intervals


def of_arms(*arms: str) -> Recordings:
    """Four trials, each of all arms; the wrench of an arm is its place in the alphabet of the arms."""
    names = sorted(arms)
    rows = [(trial, names.index(arm) + 1.0) for trial in "abcd" for arm in arms]
    return Recordings.from_arrays(
        [np.full((40, 6), value) for _, value in rows], trial=[trial for trial, _ in rows], arm=list(arms) * 4,
        outcome=["success" if trial in "ab" else "failure" for trial, _ in rows],
    )  # fmt: skip


def played(recordings: Recordings, arm: str = "") -> set[float]:
    return {message.wrench[0] for message in play(recordings, arm=arm) if isinstance(message, Sample)}


@pytest.mark.parametrize(("arms", "meant"), [(("left", "right"), "right"), (("L", "R"), "R"), (("a", "b", "c"), "c")])
def test_the_last_by_name_is_meant_where_none_is_named(arms: tuple[str, ...], meant: str) -> None:
    recordings = of_arms(*arms)
    (intervals,) = labelled_intervals(recordings, TaskSpec("outcome")).intervals
    assert set(recordings.arm[intervals.recording]) == {meant} == {intervals.arm}
    assert played(recordings) == {float(len(arms))}
    assert played(recordings, arms[0]) == {1.0}


def test_all_arms_stand_side_by_side_under_their_names() -> None:
    recordings = of_arms("a", "left", "right")
    items = labelled_intervals(recordings, TaskSpec("outcome", arms="both"))
    found = extract_features(encode(recordings.wrench, rate=200), items, FeatureSpec(("histogram",)))
    assert list(dict.fromkeys(name.partition(".")[0] for name in found.names)) == ["right", "left", "a"]
    assert [found.meanings[at].partition(",")[0] for at in (0, -1)] == ["right arm", "arm a"]
    one = extract_features(
        encode(recordings.wrench, rate=200), labelled_intervals(recordings, TaskSpec("outcome", arms="a")),
        FeatureSpec(("histogram",)),
    )  # fmt: skip
    assert one.names[0].startswith("histogram.")
    np.testing.assert_array_equal(found.values[:, -len(one.names) :], one.values)


@pytest.mark.parametrize("name", ["R", "both", "Left"])
def test_an_arm_that_is_not_there_is_refused_with_those_that_are(name: str) -> None:
    with pytest.raises(InputError, match=r"have no arm .*, only right, left; choose one of these \(--arm\)\."):
        chosen_arm(["left", "right"], name)


@pytest.mark.parametrize("name", ["L", "X"])
def test_an_arm_that_the_chosen_recordings_lack_is_refused(name: str) -> None:
    """Though the data set has it: a task of one source would be about another arm than the one named."""
    recordings = of_arms("R", "L")
    source = np.where(recordings.trial == "d", "both", "right")
    recordings = replace(recordings, source=source).take((recordings.arm == "R") | (source == "both"))
    for intervals_of in (labelled_intervals, unlabelled_intervals):
        with pytest.raises(InputError, match=f"The recordings have no arm '{name}', only R"):
            intervals_of(recordings, TaskSpec("outcome", arms=name, sources=("right",)))
    with pytest.raises(InputError, match=f"no arm '{name}', only R"):
        set(play(of_arms("R"), arm=name))


def test_one_arm_alone_need_not_be_named() -> None:
    for recordings, name in ((of_arms("wrist"), ""), (of_arms(""), "R")):
        assert len(labelled_intervals(recordings, TaskSpec("outcome", arms=name)).y) == 4
        assert played(recordings, name) == {1.0}
