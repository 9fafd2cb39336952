"""Groups, types, attributes and lists of units beside arrays."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcbht_jax.io.importing.attributes import lists_of_units, units_in
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.trees import Tree, leaves
from rcbht_jax.labels import AXES
from tests.io.importing.test_readers import TIME, WRENCH, N, same


def test_groups_called_after_errors_are_recordings(tmp_path: Path) -> None:
    groups = {"baseline": WRENCH, "error": WRENCH[:-5], "error_2": WRENCH + 1}
    for names in (("baseline", "error"), ("baseline", "error", "error_2")):
        with pytest.importorskip("h5py").File(tmp_path / "a.h5", "w") as file:
            for name in names:
                file[f"{name}/t"], file[f"{name}/ft"] = TIME[: len(groups[name])], groups[name]
        assert len(read_source(tmp_path / "a.h5").recordings) == len(names)


def test_groups_share_a_time_by_a_link(tmp_path: Path) -> None:
    with pytest.importorskip("h5py").File(tmp_path / "a.h5", "w") as file:
        file["one/t"], file["one/ft"], file["two/ft"] = TIME, WRENCH, WRENCH + 1
        file["two/t"], file["two/loop"] = file["one/t"], file["/"]
    assert read_source(tmp_path / "a.h5").recordings.trial.tolist() == ["a-one", "a-two"]


def test_a_signal_with_two_names_is_one(tmp_path: Path) -> None:
    with pytest.importorskip("h5py").File(tmp_path / "a.h5", "w") as file:
        file["entry/data/t"], file["entry/data/ft"] = TIME, WRENCH
        file["entry/sensor/t"], file["entry/sensor/ft"] = file["entry/data/t"], file["entry/data/ft"]
        file["entry/data/wrench"] = file["entry/data/ft"]
    imported = read_source(tmp_path / "a.h5")
    assert imported.recordings.trial.tolist() == ["a"]
    assert not any("wrenches were found" in remark for remark in imported.report.remarks)


def test_hdf5_types_and_null_arrays_beside_recordings_change_nothing(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("one", "two"):
            file[f"{name}/t"], file[f"{name}/grip"] = TIME, WRENCH[:, :2] + len(file)
        file["type"], file["nothing"] = np.dtype("f8"), h5py.Empty("f8")
    assert len(read_source(tmp_path / "a.h5").recordings) == 2


def test_hdf5_lists_of_texts_among_attributes_change_nothing(tmp_path: Path) -> None:
    with pytest.importorskip("h5py").File(tmp_path / "a.h5", "w") as file:
        file["t"], file["wrench"] = TIME, WRENCH
        file.attrs["tags_1"], file.attrs["tags_2"] = ["a", "b"], ["a", "b", "c"]
        file["wrench"].attrs["axes"] = np.array(["Größe".encode()] * 6)
    same(read_source(tmp_path / "a.h5"))


GROUP = {"t": TIME, "wrench": WRENCH}
TWO = {"a": GROUP, "b": {"t": TIME, "wrench": WRENCH + 1}}


@pytest.mark.parametrize("kind", ["json", "h5"])
@pytest.mark.parametrize(
    ("content", "trials"),
    [
        ({"raw": GROUP, "compensated": TWO["b"]}, ["run"]),
        ({"data": TWO, "meta": {"rate": 100.0, "names": np.zeros(1)}}, ["run-a", "run-b"]),
        ({**TWO, "c": {"t": TIME[:1], "wrench": WRENCH[:1]}}, ["run-a", "run-b"]),
        ({**TWO, "few": {"t": TIME[:9], "wrench": WRENCH[:9], "no": 1 + TIME[:9]}}, ["run-a", "run-b", "run-few"]),
        ({"#a": GROUP, "#b": TWO["b"]}, ["run-a", "run-b"]),
        ({"gains": {"kp": np.arange(3.0)}, **TWO}, ["run-a", "run-b"]),
        ({**GROUP, "poses": {"hand": {"x": TIME, "y": TIME}, "base": {"x": TIME, "y": TIME}}}, ["run"]),
    ],
)
def test_one_walk_finds_the_recordings_of_all_nested_formats(
    kind: str, content: dict[str, Any], trials: list[str], tmp_path: Path
) -> None:
    if kind == "json":
        (tmp_path / "run.json").write_text(json.dumps(content, default=np.ndarray.tolist))
    else:
        with pytest.importorskip("h5py").File(tmp_path / "run.h5", "w") as file:
            for path, one in leaves(tree_of(content)):
                file[path] = one
    imported = read_source(tmp_path)
    assert (imported.recordings.trial.tolist(), imported.recordings.axes) == (trials, AXES)
    assert bool(imported.report.skipped) == ("c" in content)
    assert not {"meta.names", "meta_names"} & set(imported.recordings.columns)


def tree_of(content: dict[str, Any]) -> Tree:
    return {f"{key}/" if isinstance(one, dict) else key: tree_of(one) if isinstance(one, dict) else one
            for key, one in content.items()}  # fmt: skip


@pytest.mark.parametrize(
    ("start", "later", "every", "remarked"), [(0, 0, 2, True), (0, 0, 1, False), (9, 0.1, 1, True), (9, 1, 1, False)]
)
@pytest.mark.parametrize("names", [("wrist", "ati"), ("trial_1", "trial_2")])
def test_sensors_of_one_trial_that_became_recordings_are_remarked(
    start: float, later: float, every: int, remarked: bool, names: tuple[str, str], tmp_path: Path
) -> None:
    with pytest.importorskip("h5py").File(tmp_path / "run.h5", "w") as file:
        for name, time, wrench in zip(names, (TIME, (later + TIME)[::every]), (WRENCH, -WRENCH[::every]), strict=True):
            file[f"{name}/t"], file[f"{name}/wrench"] = start + time, wrench
    remarked = remarked and names[0] == "wrist"  # trials may have clocks of their own
    said = "may be of sensors of one trial: "
    assert any(said in remark for remark in read_source(tmp_path).report.remarks) == remarked


def test_what_is_no_list_of_units_stays(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **{"run/t": TIME, "run/wrench": WRENCH, "run/unit": np.array(["N"] * N)})
    assert read_source(tmp_path / "a.npz").recordings.columns["run_unit"].tolist() == ["N"]
    facts: dict[str, str | float] = {"force_units": "N"}
    assert units_in(facts, [f"force_{axis}" for axis in "xyz"]) == (facts, {})


def test_many_lists_of_units_are_found_in_linear_time() -> None:
    spent = []
    for count in (100, 1000):
        start = time.process_time()
        assert len(lists_of_units({f"{k}_units": np.array(["N", "Nm"]) for k in range(count)} | {"t": TIME})) == count
        spent.append(time.process_time() - start)
    assert spent[1] < 40 * spent[0]


def test_arrays_beside_groups_that_are_left_out_are_remarked(tmp_path: Path) -> None:
    groups = {f"{name}/{key}": one for name in ("one", "two") for key, one in (("t", TIME), ("ft", WRENCH + len(name)))}
    groups["other"] = np.arange(N + 3.0)
    np.savez(tmp_path / "a.npz", **groups)
    with pytest.importorskip("h5py").File(tmp_path / "a.h5", "w") as file:
        file.update(groups)
    for kind in ("npz", "h5"):
        remarks = read_source(tmp_path / f"a.{kind}").report.remarks
        assert "Arrays of another shape or kind were left out: 'other'." in remarks
