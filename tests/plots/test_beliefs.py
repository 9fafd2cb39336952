"""The heat map of beliefs shows the numbers that the stream gave, where and when it gave them."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from rcbht_jax._util.digest import wrench_digests
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief, SubtaskStarted
from rcbht_jax.introspection import model as model_files
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.io.store import write_recordings
from rcbht_jax.plots.beliefs import belief_map
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import Recordings
from tests.support.introspection_models import model, trial


def test_the_numbers_are_those_of_the_stream():
    introspector = Introspector(model())
    events = introspector.push(trial(0, 50, 200)) + introspector.begin("push") + introspector.push(trial(1, 51, 200))
    figure = belief_map(events, "a trial")
    panels = figure.axes[:3]
    assert [panel.get_title(loc="left") for panel in panels] == ["states", "outcome", "failure-type"]
    for panel, head in zip(panels, model().heads, strict=True):
        [mesh] = [c for c in panel.collections if isinstance(c, QuadMesh)]
        mine = [e for e in events if isinstance(e, Belief) and e.head == head.name]
        np.testing.assert_allclose(mesh.get_array(), np.array([b.probabilities for b in mine]).T)
        assert [label.get_text() for label in panel.get_yticklabels()] == list(head.classes)
        ends = mesh.get_coordinates()[0, 1:, 0]
        np.testing.assert_allclose(ends, [b.time for b in mine])
    [start] = [e for e in events if isinstance(e, SubtaskStarted)]
    lines = {float(np.asarray(line.get_xdata())[0]) for line in panels[0].lines}
    assert lines == {start.time}
    assert "push" in [text.get_text() for text in panels[0].texts]
    with pytest.raises(InputError, match="no belief among the events"):
        belief_map([start])


def test_every_line_has_the_name_of_what_begins_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Of the recording that is asked for, also where nothing begins at its start."""
    wrench = np.concatenate([trial(0, 52, 150), trial(2, 53, 150)])
    marks = [(0, "s", "other", 0.0, 1.5), (1, "s", "late", 0.3, 0.9), (1, "s", "last", 0.9, 1.5)]
    pair = Recordings.from_arrays([wrench, wrench], 200.0, trial="t", arm=["R", "L"], annotations=marks)
    write_recordings(tmp_path / "s.zarr", pair, {})
    model_files.save(tmp_path / "m", model())
    figures: list[Figure] = []
    monkeypatch.setattr("rcbht_jax.plots.save", lambda figure, _: figures.append(figure))
    words = ["plot", "beliefs", str(tmp_path / "s.zarr"), "t", "--arm", "L", "-m", str(tmp_path / "m"), "-o", "b.png"]
    assert main(words) == 0
    assert figures[0].get_suptitle() == "t, left arm, beginnings of the track s"
    assert [(text.get_text(), round(text.xy[0], 2)) for text in figures[0].axes[0].texts] == [
        ("late", pytest.approx(0.3, abs=0.03)), ("last", pytest.approx(0.9, abs=0.03)),
    ]  # fmt: skip


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    wrench = np.concatenate([trial(0, 52, 150), trial(2, 53, 150)])[None]
    onset = np.array([[0.0, 0.75, np.nan, np.nan]])
    text = {name: np.array([name]) for name in ("source", "session", "failure_type", "note")}
    one = snap_recordings(
        wrench=wrench, length=np.array([300], np.int32), dt=0.005, onset=onset, onset_harmonised=onset,
        trial=np.array(["t"]), arm=np.array(["R"]), outcome=np.array(["success"]), deviation=np.full((1, 3), np.nan),
        **text,
    )  # fmt: skip
    write_recordings(tmp_path / "s.zarr", one, {})
    model_files.save(tmp_path / "m", model())
    words = ["plot", "beliefs", str(tmp_path / "s.zarr"), "t", "-m", str(tmp_path / "m"), "-o"]
    assert main([*words, str(tmp_path / "b.png")]) == 0
    assert "45 beliefs about t" in capsys.readouterr().out
    assert (tmp_path / "b.png").stat().st_size > 5000
    assert main([*words, str(tmp_path / "w.png"), "--rate", "0"]) == 0  # as in "rcbht stream"
    assert "180 beliefs about t" in capsys.readouterr().out
    assert main([*words, str(tmp_path / "b.gif")]) == 2
    assert main([*words, str(tmp_path / "b.png"), "--starts", "detected"]) == 2
    assert "train-online --detect" in capsys.readouterr().err


@pytest.mark.parametrize(("rows", "said"), [([0], "was trained on this recording: its"), ([1], ""), ([], "not known")])
def test_a_recording_of_the_training_is_said_to_be_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, rows: list[int], said: str
) -> None:
    """The report said it, the figure and its command did not."""
    two = Recordings.from_arrays([trial(0, 52, 150), trial(1, 53, 150)], 200.0, trial=["t", "u"])
    write_recordings(tmp_path / "s.zarr", two, {})
    digests = wrench_digests(two.wrench, two.length)[rows]
    model_files.save(tmp_path / "m", replace(model(), digests=digests))
    figures: list[Figure] = []
    monkeypatch.setattr("rcbht_jax.plots.save", lambda figure, _: figures.append(figure))
    assert main(["plot", "beliefs", str(tmp_path / "s.zarr"), "t", "-m", str(tmp_path / "m"), "-o", "b.png"]) == 0
    printed = capsys.readouterr().out
    assert said in printed
    assert ("trained" in printed) == bool(said)
    assert figures[0].get_suptitle().endswith("training data") == (rows == [0])


def test_names_of_sub_tasks_do_not_overlap() -> None:
    """Neither each other nor the title of the panel, and all of them are in the figure."""
    classes = "align", "free_space_motion"
    beliefs = [Belief(k, k / 10, "states", "align", 0.9, "certain", 0.1, classes, (0.9, 0.1)) for k in range(1, 300)]
    begins = {"search": 0.2, "free_space_motion": 3.0, "align": 6.8}
    begins |= {"insertion": 11.8, "mating": 12.2, "a much longer name": 29.7}
    starts = [SubtaskStarted(round(time * 10), time, 0, False, label) for label, time in begins.items()]
    figure = belief_map([*beliefs, *starts], "a trial")
    figure.canvas.draw()
    panel = figure.axes[0]
    assert [text.get_text() for text in panel.texts] == list(begins)
    boxes = [text.get_window_extent() for text in (*panel.texts, panel._left_title)]
    assert not any(one.overlaps(two) for one, two in itertools.combinations(boxes, 2))
    assert all(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1 for box in boxes)


def test_a_long_title_is_inside_the_figure() -> None:
    belief = Belief(200, 1.0, "state", "a", 0.9, "certain", 0.1, ("a", "b"), (0.9, 0.1))
    figure = belief_map([belief], "a trial with a long name " * 9 + "training data")
    figure.canvas.draw()
    [title] = [text for text in figure.texts if text.get_text() == figure.get_suptitle()]
    assert title.get_text().endswith("training data")  # the end of a long title was cut, with what it warns of
    assert figure.bbox.x0 <= title.get_window_extent().x0
