"""A part that is refused changes nothing, and ``rcbht info --check`` reads all of a store."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from rcbht_jax.io import store, store_writer
from tests.support.parted_stores import add, begun, finish, ragged, tree, trimmed, truth


@pytest.fixture
def parted(tmp_path: Path) -> Path:
    path = begun(tmp_path / "parts.zarr")
    for number in (0, 1, 2):
        add(path, number)
    return finish(path)


def test_a_refused_part_changes_nothing(parted: Path) -> None:
    before = tree(parted)
    with pytest.raises(InputError, match=r"of shape \(3,\); expected string of shape \[4\]"):
        store_writer.write_part(
            str(parted), 0, trimmed(ragged().take([0, 1, 2])), {k: v[:3] for k, v in truth().items()}
        )
    assert store_writer.has_part(str(parted), 0)
    assert tree(parted) == before
    store.verify(str(parted))


@pytest.mark.parametrize("small", [True, False])
def test_info_check_reads_all_of_a_store_of_any_size(
    parted: Path, small: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not small:
        monkeypatch.setattr(store, "SMALL_BYTES", 1)
    assert main(["info", str(parted), "--check"]) == 0
    assert "every checksum is right" in capsys.readouterr().out
    shutil.copy(parted / "part_summary" / "c" / "1", parted / "part_summary" / "c" / "0")
    assert main(["info", str(parted), "--check"]) == 2
    assert "the summary of part 0 is not that of its recordings" in capsys.readouterr().err


def test_what_differs_between_the_simulations_of_two_parts_is_named(tmp_path: Path) -> None:
    path, part = begun(tmp_path / "x.zarr"), ragged().take(np.arange(4))
    some = {name: values[:4] for name, values in truth().items()}
    name = next(name for name, values in some.items() if values.dtype.kind in "iuf")
    for changed, words in (
        (
            some | {name: some[name].astype(np.float16)},
            f"Part 0 has simulation/{name} of type float16 .*; all parts of",
        ),
        (some | {"more": np.zeros(4)}, r"has simulation/more of type float64 \[\]; .* have no simulation/more\.$"),
        (
            {one: some[one] for one in some if one != name},
            f"has no simulation/{name}; .* have simulation/{name} of type",
        ),
    ):
        with pytest.raises(InputError, match=words):
            store_writer.write_part(path, 0, part, changed)
