"""The confounds of the data that a report states."""

from __future__ import annotations

import json

import numpy as np

from rcbht_jax.cli.main import main
from rcbht_jax.io.export import DataSet, load
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.report import page
from rcbht_jax.types import Recordings


def test_the_page_has_the_confounds_of_every_task_that_the_commands_print(tmp_path, capsys) -> None:
    """All tasks, and how recordings begin."""
    rng, store = np.random.default_rng(0), tmp_path / "biased.zarr"
    material = ["steel", "wood"] * 6
    wrench = rng.normal(0, 0.02, (12, 800, 1)) + 3.0 * (np.array(material) == "wood")[:, None, None]
    spans = [("phase", "near", 0, 2), ("phase", "far", 2, 4), ("grip", "open", 0, 1), ("grip", "closed", 1, 4)]
    marks = [(row, *span) for row in range(12) for span in spans]
    write_recordings(store, Recordings.from_arrays(wrench, 200.0, annotations=marks, material=material), {})
    assert main(["info", str(store), "--json"]) == 0
    tasks = json.loads(capsys.readouterr().out)["tasks"]
    assert "first second predicts" in tasks["material"]["sentences"][0]
    assert "differ in length" in tasks["grip"]["sentences"][0]
    for data in (load(store), DataSet.of(read_recordings(store))):
        text = page(data)
        assert f"<li>Task material: {tasks['material']['sentences'][0]}</li>" in text
        assert f"<li>Task grip (all outcomes): {tasks['grip']['sentences'][0]}</li>" in text
        assert "Task phase" not in text


def test_a_confound_of_several_tasks_is_stated_once() -> None:
    """What a task leaves out is no confound."""
    spans = [("phase", "near", 0, 1), ("phase", "far", 1, 4)]
    marks = [(row, *span) for row in range(8) for span in [*spans, *[("grip", *span[1:]) for span in spans]]]
    columns = {"arm": ["R", "L"] * 4, "outcome": ["success"] * 4 + ["failure"] * 4}
    data = DataSet.of(Recordings.from_arrays(np.ones((8, 80, 1)), 20.0, annotations=marks, **columns))
    assert (text := page(data)).count("<li>Tasks phase (all outcomes), grip (all outcomes): The classes differ") == 1
    assert "Only the right arm" not in text
    assert "All of them are in the browser" in text
