"""Which moments of a trial share a picture, and what its heading says of their times."""

from __future__ import annotations

import pytest

from sim_mjx.plots.trial_overview import FRAMES, choose

MOMENTS = {
    "before touch": 4.58, "touch": 5.17, "FL past lip": 6.07, "FR past lip": 6.66, "mid-rotation": 8.35,
    "RL past lip": 10.99, "RR past lip": 11.01, "insertion": 11.53, "mating": 12.01, "end": 33.01,
}  # fmt: skip


def test_names_of_earlier_moments_carry_their_own_times() -> None:
    assert choose(MOMENTS) == {
        "before touch": 4.58,
        "touch": 5.17,
        "FL (6.07 s) FR past lip": 6.66,
        "mid-rotation": 8.35,
        "RL RR past lip": 11.01,
        "insertion (11.53 s), mating": 12.01,
        "end": 33.01,
    }


@pytest.mark.parametrize("touch", [0.1, 5.0])
def test_before_touch_and_end_have_their_own_frames(touch: float) -> None:
    steps = {f"step {number}": touch + 0.7 * number for number in range(1, 10)}
    frames = choose({"before touch": max(touch - 0.6, 0.0), "touch": touch} | steps | {"end": touch + 6.4})
    assert len(frames) == FRAMES
    assert {"before touch", "end"} <= set(frames)


def test_a_chain_of_close_moments_does_not_share_one_frame() -> None:
    frames = choose({f"step {number}": 0.3 * number for number in range(6)})
    assert len(frames) == 3
