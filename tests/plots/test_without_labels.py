"""``rcbht plot trial`` of a store without labels: the wrench and the boundaries, and the command that makes labels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.cli import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import write_recordings
from rcbht_jax.labels import AXES
from rcbht_jax.plots import label_map, trial_figure
from rcbht_jax.types import Recordings


@pytest.fixture
def recordings() -> Recordings:
    wrench = np.random.default_rng(0).normal(size=(2, 400, 6)).cumsum(1)
    marks = [(0, "phase", "free", 0.0, 1.0), (0, "phase", "touch", 1.0, 2.0)]
    return Recordings.from_arrays(wrench, 200.0, trial=["one", "two"], annotations=marks)


def test_its_picture_is_the_wrench_with_boundaries(recordings: Recordings) -> None:
    figure = trial_figure(recordings, None, 0)
    assert [ax.get_gid() for ax in figure.axes] == [f"signal-{axis}" for axis in AXES]
    assert all(len(ax.collections) == 0 for ax in figure.axes)  # no lines, no bands
    assert [text.get_text() for text in figure.axes[0].texts] == ["free", "touch"]
    assert [text.get_text() for text in figure.legends[0].texts] == ["wrench", "start of a state"]
    assert figure.axes[-1].get_xlabel() == "time, s"


def test_the_command_says_what_makes_labels(
    recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare, out = tmp_path / "bare.zarr", tmp_path / "x.png"
    write_recordings(bare, recordings, {})
    assert main.main(["plot", "trial", str(bare), "two", "-o", str(out)]) == 0
    assert f' two, no labels; make them with "rcbht encode {bare}"\n' in capsys.readouterr().out
    assert out.is_file()
    assert main.main(["plot", "trial", str(bare), "two", "-o", str(out), "--json"]) == 0
    assert '"tracks": null' in capsys.readouterr().out
    assert main.main(["plot", "trial", str(bare), "two", "-o", str(out), "--tracks", "W20"]) == 2
    assert "has no label tracks; run" in capsys.readouterr().err


def test_what_is_no_force_is_called_a_signal(recordings: Recordings) -> None:
    currents = replace(recordings, units=("A",) * 6)
    assert trial_figure(currents, None, 0).legends[0].texts[0].get_text() == "signal"


@pytest.mark.parametrize("seconds", [(0.001, 0.004), (1.996, 3.0)])
def test_a_part_between_two_samples_is_refused(recordings: Recordings, seconds: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="No sample lies between"):
        trial_figure(recordings, None, 0, seconds=seconds)


def test_a_part_that_begins_early_shows_what_there_is(recordings: Recordings) -> None:
    """A start before the recording was refused with a false sentence; an end after it was not."""
    early, exact = (trial_figure(recordings, None, 0, seconds=(start, 1.0)) for start in (-0.5, 0.0))
    assert early.axes[0].get_xlim() == exact.axes[0].get_xlim()


def test_a_map_by_state_has_no_number_of_words(recordings: Recordings) -> None:
    with pytest.raises(InputError, match="by state has no number of words"):
        label_map(recordings, rj.encode(recordings.wrench, rate=200), "llb", by="state", words=3)
