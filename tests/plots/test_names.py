"""Names of other people's data in figures."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.calibration.dataset import calibration_data
from rcbht_jax.encoding.rules import config_of
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.events import Belief
from rcbht_jax.learning.tasks import TaskSpec, labelled_intervals
from rcbht_jax.plots import canvas, label_map, save, trial_figure
from rcbht_jax.plots.beliefs import belief_map
from rcbht_jax.plots.thresholds import threshold_figure
from rcbht_jax.types import Recordings

ODD = "a$\\frac$b\x1b[2J"


@pytest.mark.filterwarnings("error")
def test_they_are_text(tmp_path: Path) -> None:
    """Neither formulas, which need not be sound ones, nor control characters, which no font has."""
    wrench = np.random.default_rng(0).normal(size=(3, 400, 2)).cumsum(1)
    names = dict.fromkeys(("trial", "session", "source"), np.array([ODD, "$", "$x_$\x07"]))
    recordings = Recordings.from_arrays(wrench, rate=100, axes=[ODD, "Fz"], units=["N", "$$"], **names)
    tracks = rj.encode(recordings.wrench, 1 / recordings.dt, window=5)
    figures = [trial_figure(recordings, tracks, 0, window=5), label_map(recordings, tracks, "mc")]
    figures.append(belief_map([Belief(200, 1.0, ODD, ODD, 0.9, "certain", 0.1, (ODD, "b"), (0.9, 0.1))], ODD))
    for figure in figures:
        save(figure, tmp_path / "a.svg")
        ElementTree.parse(tmp_path / "a.svg")
    assert figures[-1].get_suptitle() == r"a\$\frac\$b\x1b[2J"


@pytest.mark.filterwarnings("error")
def test_units_of_slopes_are_text_and_none_is_left_out(tmp_path: Path) -> None:
    """Dollar signs enclosed a formula, and a slope without a unit was in "/s"."""
    wrench = np.random.default_rng(0).normal(size=(4, 400, 6)).cumsum(1)
    recordings = Recordings.from_arrays(wrench, 100, units=["", "$\\frac$"] * 3, outcome=["x", "y"] * 2)
    items = labelled_intervals(recordings, TaskSpec("outcome"))
    data = calibration_data(recordings, items, config_of("paper", 5, recordings.dt))
    limits = preset("hiro")
    figure = threshold_figure(data, 5, limits, axes=recordings.axes, units=recordings.units)
    save(figure, tmp_path / "a.svg")
    texts = [text.get_text() for panel in figure.axes for text in panel.texts]
    assert [text for text in texts if text.endswith("/s")] == ["1/s", r"\$\frac\$/s"] * 3


@pytest.mark.filterwarnings("error")
def test_letters_that_the_usual_font_lacks_come_from_an_installed_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not every machine has Chinese fonts; a circled letter of a font that matplotlib brings stands for them."""
    belief = Belief(200, 1.0, "\u24b6", "a", 0.9, "certain", 0.1, ("a", "b"), (0.9, 0.1))
    with pytest.raises(UserWarning, match="No installed font has the letters \u24b6"):
        save(belief_map([belief], "trial"), tmp_path / "a.png")
    monkeypatch.setattr(canvas, "_MORE_SCRIPTS", ("No Such Font", "STIXGeneral"))
    save(belief_map([belief], "trial"), tmp_path / "a.png")


def test_a_session_without_a_name_is_not_named() -> None:
    """A comma stood before its outcome in a map, and the word session before nothing in a title."""
    wrench = np.random.default_rng(0).normal(size=(1, 400, 1)).cumsum(1)
    recordings = Recordings.from_arrays(wrench, 100, axes=["Fz"], session="", outcome="success")
    tracks = rj.encode(wrench, 100)
    [label] = label_map(recordings, tracks, "llb").axes[0].get_yticklabels()
    assert label.get_text() == "success (1)"
    assert "\nsuccess" in trial_figure(recordings, tracks, 0).get_suptitle()
    recordings = Recordings.from_arrays(wrench, 100, axes=["Fz"], session="1")
    assert "\nsession 1, outcome unknown" in trial_figure(recordings, tracks, 0).get_suptitle()


def test_long_names_of_sessions_are_told_apart_by_their_ends() -> None:
    """All sessions of a day had one name, as what is beyond 22 letters was left out."""
    sessions = [f"experiment_at_2018y05m19d15H48M03S__{number}" for number in range(3)]
    wrench = np.random.default_rng(0).normal(size=(3, 400, 1)).cumsum(1)
    recordings = Recordings.from_arrays(wrench, 100, axes=["Fz"], session=sessions, outcome="success")
    figure = label_map(recordings, rj.encode(wrench, 100), "llb")
    names = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert [name.partition(",")[0][-3:] for name in names] == ["__0", "__1", "__2"]


@pytest.mark.filterwarnings("ignore:No installed font", "ignore:Glyph")
@pytest.mark.parametrize("session", ["\uc6d4\uc694\uc77c & <b>", "\uc6d4\uc694\uc77c" * 10])
def test_letters_twice_as_wide_have_room_beside_a_label_map(session: str) -> None:
    """Names of Korean letters began beyond the picture's edge: letters were counted, not their width."""
    wrench = np.random.default_rng(0).normal(size=(1, 400, 1)).cumsum(1)
    recordings = Recordings.from_arrays(wrench, 100, axes=["Fz"], session=[session], outcome=["success"])
    figure = label_map(recordings, rj.encode(wrench, 100), "llb")
    figure.canvas.draw()
    (label,) = figure.axes[0].get_yticklabels()
    assert session[:3] in label.get_text()
    assert label.get_window_extent().x0 >= 0
