"""Several stores as one: what is kept, what is left out, what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcbht_jax.annotations import Annotations
from rcbht_jax.cli import main
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.export import load
from rcbht_jax.io.export.card import card
from rcbht_jax.io.joining import importer_of, join_stores
from rcbht_jax.types import Recordings
from tests.support.store_cases import same

RATE = 200.0


def recordings(seed: int, count: int = 3, samples: int = 40, **columns: Any) -> Recordings:
    rng = np.random.default_rng(seed)
    wrenches = [5.0 + rng.normal(size=(samples + row, 6)) for row in range(count)]
    marks = [(0, "states", f"state-{seed}", 0.05, 0.1)]
    names = {"trial": [f"{seed}-{row}" for row in range(count)], "source": f"set-{seed}"}
    return Recordings.from_arrays(wrenches, RATE, annotations=marks, **{**names, **columns})


def written(path: Path, of: Recordings, **attrs: Any) -> Path:
    store.write_recordings(path, of, attrs)
    return path


def test_recordings_without_corrected_boundaries_stay_in_the_task(tmp_path: Path) -> None:
    """Simulated trials of the camera snap have them, a user's trials do not: tasks used to leave the latter out."""
    corrected = recordings(2)
    rows = [
        (n, track, "state-2", at, 0.12)
        for n in range(3)
        for track, at in (("states", 0.05), ("states-harmonised", 0.06))
    ]
    corrected = replace(corrected, annotations=Annotations.from_rows(rows))
    paths = [written(tmp_path / "1.zarr", recordings(1)), written(tmp_path / "2.zarr", corrected)]
    join_stores(paths, tmp_path / "both.zarr")
    marks = store.read_recordings(tmp_path / "both.zarr").annotations
    starts = np.full((6, 2), np.nan)
    starts[0, 0], starts[3:, 1] = 0.05, 0.06
    np.testing.assert_array_equal(marks.starts("states-harmonised", 6), starts)
    assert marks.labels["states-harmonised"] == ("state-1", "state-2")
    assert len(marks.of("states")) == 4


def test_a_joined_store_has_the_recordings_of_each(tmp_path: Path) -> None:
    parts = [recordings(1, mass=2.5), recordings(2, count=2, samples=60, operator="Ann")]
    paths = [
        written(tmp_path / f"{number}.zarr", part, importer="csv", frames="sensor") for number, part in enumerate(parts)
    ]
    said = join_stores(paths, tmp_path / "both.zarr")
    assert (said.taken, said.copies) == (
        {str(paths[0]): 3, str(paths[1]): 2}, {str(paths[0]): 0, str(paths[1]): 0},
    )  # fmt: skip
    both = store.read_recordings(tmp_path / "both.zarr")
    same(both, Recordings.join(parts))
    assert both.annotations.labels["states"] == ("state-1", "state-2")
    assert both.columns["operator"].tolist() == ["", "", "", "Ann", "Ann"]
    attrs = store.read_attrs(tmp_path / "both.zarr")
    assert (attrs["importer"], attrs["frames"]) == ("csv", "sensor")
    assert [one["content_sha256"] for one in attrs["joined"]] == [
        store.read_attrs(path)["content_sha256"] for path in paths
    ]


def test_each_recording_is_tared_by_its_own_beginning(tmp_path: Path) -> None:
    paths = [written(tmp_path / f"{seed}.zarr", recordings(seed)) for seed in (1, 2)]
    join_stores(paths, tmp_path / "both.zarr", tare_seconds=0.1)
    wrench = store.read_recordings(tmp_path / "both.zarr").wrench
    np.testing.assert_allclose(wrench[:, : round(0.1 * RATE)].mean(1), 0.0, atol=1e-6)


def test_exact_copies_are_taken_once_and_other_recordings_of_the_name_refused(tmp_path: Path) -> None:
    one = recordings(1, mass=np.arange(3))  # as a float where a recording of the store has none
    same = replace(one.take([2, 0]), columns={"mass": np.array([2.0, 0.0])})
    first, copy = written(tmp_path / "a.zarr", one), written(tmp_path / "b.zarr", same)
    said = join_stores([first, copy, written(tmp_path / "c.zarr", recordings(2))], tmp_path / "out.zarr")
    assert list(said.copies.values()) == [0, 2, 0]
    assert len(store.read_recordings(tmp_path / "out.zarr")) == 6
    altered = one.wrench.copy()
    altered[1, 3] += 1.0
    other = written(tmp_path / "d.zarr", Recordings.from_arrays([altered[1, :41]], RATE, trial=["1-1"], source="set-1"))
    with pytest.raises(InputError, match="another recording '1-1' of 'set-1'"):
        join_stores([first, other], tmp_path / "never.zarr")
    assert not (tmp_path / "never.zarr").exists()


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("what", ["outcome", "session", "part", "annotations", "nothing"])
def test_copies_of_which_another_thing_is_known_are_refused(what: str, turned: bool, tmp_path: Path) -> None:
    one = replace(recordings(1), annotations=Annotations.from_rows([(0, "states", "push", 0.05, np.nan)]))
    others = {
        "outcome": replace(one, outcome=np.array(["unknown", "success", "unknown"])),
        "session": replace(one, session=np.array(["", "monday", ""])),
        "part": replace(one, columns={"part": np.array(["", "peg", ""])}),
        "annotations": replace(one, annotations=Annotations.from_rows([(0, "states", "push", 0.05, 0.1)])),
        "nothing": replace(one, columns={"part": np.full(3, "")}, note=np.full(3, "uneven")),
    }
    paths = [written(tmp_path / "a.zarr", one), written(tmp_path / "b.zarr", others[what])][:: -1 if turned else 1]
    if what == "nothing":
        assert join_stores(paths, tmp_path / "out.zarr").copies[str(paths[1])] == 3
        return
    same_name = rf"{paths[1].name} and .*{paths[0].name} have the same recording '1-[01]' of 'set-1' with another"
    with pytest.raises(InputError, match=same_name):
        join_stores(paths, tmp_path / "out.zarr")


def test_presets_of_a_robot_apply_only_where_all_stores_are_of_it(tmp_path: Path) -> None:
    simulated, hiro = (
        written(tmp_path / "s.zarr", recordings(1), simulated={}),
        written(tmp_path / "h.zarr", recordings(2), importer="hiro"),
    )
    join_stores([simulated, hiro], tmp_path / "one.zarr")
    assert store.read_attrs(tmp_path / "one.zarr")["importer"] == "hiro"
    mine = written(tmp_path / "m.zarr", recordings(4), robot="mine")  # whose maker is not known
    join_stores([mine, written(tmp_path / "n.zarr", recordings(5))], tmp_path / "unknown.zarr")
    assert importer_of(store.read_attrs(tmp_path / "unknown.zarr")) == "joined"
    other = written(tmp_path / "o.zarr", recordings(3), importer="csv")
    join_stores([hiro, other], tmp_path / "two.zarr")
    assert store.read_attrs(tmp_path / "two.zarr")["importer"] == "joined"


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    first = written(tmp_path / "a.zarr", recordings(1, mass=2.5))
    slow = written(tmp_path / "b.zarr", Recordings.from_arrays([np.zeros((30, 6))], 100.0))
    few = written(tmp_path / "c.zarr", Recordings.from_arrays([np.zeros((30, 2))], RATE, axes=("Fz", "Mz")))
    text = written(tmp_path / "d.zarr", recordings(2, mass="heavy"))
    for stores, sentence in (
        ([first], "at least two stores to join, not 1"),
        ([first, slow, first], "a.zarr is named twice"),
        ([first, slow], "100 samples a second, .* has 200"),
        ([first, few], "Fz in N, Mz in Nm; .* Fx in N"),
        ([first, text], r"d\.zarr has text in the column mass, .*a\.zarr has numbers"),
    ):
        with pytest.raises(InputError, match=sentence):
            join_stores(stores, tmp_path / "never.zarr")
    with pytest.raises(InputError, match="tare is -1"):
        join_stores([first, slow], tmp_path / "never.zarr", tare_seconds=-1.0)
    assert not (tmp_path / "never.zarr").exists()


@pytest.mark.parametrize("turned", [False, True])
def test_the_map_that_converts_units_is_stated(tmp_path: Path, turned: bool) -> None:
    """Stores that both state their units were asked to state them."""
    samples, axes = [np.zeros((30, 2))], ("Fz", "Mz")

    def joined(*units: tuple[str, str]) -> str:
        parts = [Recordings.from_arrays(samples, RATE, axes=axes, units=one) for one in units]
        stores = [tmp_path / f"{'-'.join(part.units)}.zarr" for part in parts]
        for path, part in zip(stores, parts, strict=True):
            store.write_recordings(path, part, {}, overwrite=True)
        with pytest.raises(InputError) as said:
            join_stores(stores[:: -1 if turned else 1], tmp_path / "never.zarr")
        return str(said.value)

    right = ("N", "Nm")
    assert joined(right, ("N", "Nmm")).endswith(
        'N-Nmm.zarr again with a map that has scale = 0.001 and unit = "Nm" for Mz.'
    )
    assert 'has scale = 4.448221615 and unit = "N" for Fz; scale = 0.001 and' in joined(right, ("lbf", "Nmm"))
    assert "State units in the names" in joined(right, ("N", ""))
    assert joined(right, ("N", "V")).endswith(("Mz in Nm.", "Mz in V."))  # of no known ratio


def test_a_store_is_not_joined_onto_itself(tmp_path: Path) -> None:
    """Its label tracks would be lost."""
    paths = [written(tmp_path / f"{seed}.zarr", recordings(seed)) for seed in (1, 2)]
    before = store.read_attrs(paths[0])
    with pytest.raises(InputError, match="is one of the stores to join"):
        join_stores(paths, tmp_path / "2.zarr" / ".." / "1.zarr", overwrite=True)
    assert store.read_attrs(paths[0]) == before


def test_the_command_joins_and_never_replaces_what_it_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = (str(written(tmp_path / f"{seed}.zarr", recordings(seed))) for seed in (1, 2))
    out = str(tmp_path / "both.zarr")
    assert main.main(["join", first, second, "-o", out, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["taken"] == {first: 3, second: 3}
    third = str(written(tmp_path / "third.zarr", recordings(1)))
    assert main.main(["join", first, second, third, "-o", out, "--overwrite"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("6 recordings in ")
    assert "third.zarr (3 exact copies left out)" in said
    for words, sentence in (
        ([first, second, "-o", out], "--overwrite"),
        ([first, second, "-o", second, "--overwrite"], "is to be written and is used as stores"),
        ([first, str(tmp_path / "none.zarr"), "-o", out], "none.zarr does not exist"),
        ([first, "-o", str(tmp_path / "x.zarr")], "at least two stores to join, not 1"),
        (["-o", out], "join"),
    ):
        assert main.main(["join", *words]) == 2
        assert sentence in capsys.readouterr().err
    assert len(store.read_recordings(Path(second))) == 3


def test_the_card_of_a_joined_store_says_what_was_simulated(tmp_path: Path) -> None:
    """All trials were called recorded."""
    origins: list[dict[str, Any]] = [{"simulated": {}}, {"simulated": {}}, {"importer": "csv"}, {"joined": []}]
    paths = [written(tmp_path / f"{number}.zarr", recordings(number), **of) for number, of in enumerate(origins)]
    for first, last, said in (
        (0, 2, "6 simulated trials"),
        (1, 3, "6 recorded and simulated trials"),
        (2, 4, "6 trials"),
    ):
        out = tmp_path / f"{first}-{last}.zarr"
        join_stores(paths[first:last], out)
        text = card(load(out), "")
        assert f"6 recordings of {said}, " in text
        assert ("Whether the trials were recorded or simulated is not known." in text) == (said == "6 trials")
