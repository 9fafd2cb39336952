"""Every reader of files of strangers: how a good file is made and attacked, and what must hold of what is read."""

from __future__ import annotations

import gzip
import json
import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from rcbht_jax._util import checkpoint
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.limit_files import read_limits, write_limits
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.features import FeatureSpec
from rcbht_jax.features.online import names
from rcbht_jax.introspection import model as models
from rcbht_jax.introspection.chain import FeatureView
from rcbht_jax.introspection.model import Head, IntrospectionModel
from rcbht_jax.io.hiro.dat import read_timed
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Channel, Mapping, read_mapping, write_mapping
from rcbht_jax.io.messages import Malformed, Sample
from rcbht_jax.io.rosbags import McapWriter, read_bag
from rcbht_jax.io.store import read_recordings, read_table, verify, write_recordings
from rcbht_jax.learning import model_io
from rcbht_jax.learning.probability import ProbabilisticSvm
from rcbht_jax.learning.svm import SvmSpec, fit
from rcbht_jax.report.results import SCHEMA, read_results
from sim_mjx.presets import preset as preset_of
from sim_mjx.randomization import overrides
from sim_mjx.randomization.trials import DomainRandomization, sample
from tests.attacks import mutations
from tests.support.store_cases import simple

Damage = Callable[[random.Random, bytes], bytes]


@dataclass(frozen=True)
class Reader:
    """One reader.

    ``judge`` gets what was read of the good file and of the attacked one, and says what is wrong with that; "" =
    nothing. Where ``damage`` is None the good file is a folder.
    """

    name: str
    make: Callable[[Path], None]
    read: Callable[[Path], Any]
    damage: Damage | None
    judge: Callable[[Any, Any], str] = lambda good, found: ""


def attack(reader: Reader, seed: str, good: Path, folder: Path) -> str:
    """Attack one reader once; "" or "refused" = as it should be, else what is wrong.

    Args:
        reader: which.
        seed: of the damage.
        good: what :attr:`Reader.make` made.
        folder: an empty one, to work in.
    """
    rng, path = random.Random(seed), folder / good.name
    if reader.damage is None:
        shutil.copytree(good, path)
        mutations.damage_tree(rng, path)
    else:
        path.write_bytes(reader.damage(rng, good.read_bytes()))
    try:
        found = reader.read(path)
    except InputError as error:
        text = str(error)
        return "refused" if text.endswith(".") or len(text) > 10 else f"the sentence is {text!r}"
    return reader.judge(_read_good(reader, good), found)


@cache
def _read_good(reader: Reader, good: Path) -> Any:
    return reader.read(good)


def numbers_of(value: Any) -> Iterator[float]:
    """All numbers in nested values; a text that could not be written counts as NaN."""
    if isinstance(value, dict):
        for one in (*value, *value.values()):
            yield from numbers_of(one)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from numbers_of(one)
    elif isinstance(value, np.ndarray):
        if value.dtype.kind == "f":
            yield from value.ravel().tolist()
    elif isinstance(value, float):
        yield value
    elif isinstance(value, str):
        yield float("nan") if any("\ud800" <= letter <= "\udfff" for letter in value) else 0.0
    elif hasattr(value, "__dataclass_fields__"):
        yield from numbers_of({name: getattr(value, name) for name in value.__dataclass_fields__})


def finite(_: Any, found: Any) -> str:
    """No number that was read is NaN or infinite, and no text half a surrogate pair."""
    return "" if np.isfinite(list(numbers_of(found))).all() else "a number is not finite, or a text not Unicode"


def equal(good: Any, found: Any) -> str:
    """What has checksums is read as it was written, or refused."""
    return "" if json.dumps(good) == json.dumps(found) else "damage was read without a word"


def _told(good: list[Any], found: list[Any]) -> str:
    """Readings of a bag are those that were written, and what is missing is told."""
    told = [one.text for one in found if isinstance(one, Malformed)]
    readings = [(one.time, one.wrench) for one in found if isinstance(one, Sample)]
    written = [(one.time, one.wrench) for one in good if isinstance(one, Sample)]
    # The checksum of a chunk that was cut off is missing: of two damages at once, one may be read.
    if not set(readings) <= set(written) and not any("cut off" in text for text in told):
        return "a reading was never written"
    if len(readings) > len(written):
        return "readings came twice"
    return "" if told or readings == written else "readings are missing without a word"


def _make_model(path: Path) -> None:
    spec = FeatureSpec(families=("histogram",))
    x, y = np.random.default_rng(0).normal(size=(20, len(names(spec, 6)))), np.arange(20) % 2
    machine = ProbabilisticSvm(fit(x + y[:, None], y, ("a", "b"), SvmSpec("rbf", 1.0, True)), np.array([[-1.0, 0.0]]))
    heads = (Head("states", "subtask", FeatureView(spec), machine),)
    models.save(path, IntrospectionModel(EncoderConfig(), np.asarray(preset().limits), heads, "abc"))


def _make_classifier(path: Path) -> None:
    x, y = np.random.default_rng(0).normal(size=(20, 3)), np.arange(20) % 2
    svm, spec = fit(x + y[:, None], y, ("a", "b"), SvmSpec("linear", 1.0)), FeatureSpec()
    signal = {"axes": ("Fz",), "units": ("N",)}  # a file without them is an older one, which gives a warning
    task, encoder = {"task": "states"}, {"window": 5}
    model_io.save(path, model_io.TrainedModel(svm, spec, ("a", "b", "c"), task, encoder, "abc", **signal))


def _make_mcap(path: Path) -> None:
    with McapWriter(path) as out:
        for k in range(60):
            out.wrench(0.01 * k, (float(k), 1.0, 2.0, 3.0, 4.0, 5.0))


def _make_results(path: Path) -> None:
    path.mkdir()
    row = {
        "group": "g", "what": "w", "paper": "", "ours": 0.5, "interval": [0.1, 0.9], "duration": None, "flags": ["f"],
        "peer": {"name": "p", "mean": 0.5, "interval": [0.1, 0.9]}, "source": "a.json",
    }  # fmt: skip
    sources = [{"file": "a.json", "command": "c", "date": "d", "machine": "m"}]
    (path / "a.json").write_text(json.dumps({"schema": SCHEMA, "rows": [row], "notes": {"f": "n"}, "sources": sources}))


def _store(path: Path) -> list[Any]:
    recordings = read_recordings(path)
    verify(path)
    return [recordings.wrench.tolist(), recordings.trial.tolist(), recordings.length.tolist(), len(read_table(path))]


def _table(kind: str) -> Callable[[Path], Any]:
    return lambda path: read_source(path, kind).recordings.wrench


def _rows() -> tuple[list[str], np.ndarray[Any, Any]]:
    time = np.arange(40) * 0.01
    columns = [time, *(np.sin(time + k) for k in range(6))]
    return ["t", "Fx", "Fy", "Fz", "Mx", "My", "Mz"], np.stack(columns, 1)


def _make_json_lines(path: Path) -> None:
    _, rows = _rows()
    lines = [{"reset": True}, *({"t": row[0], "wrench": row[1:], "who": "ann"} for row in rows.tolist())]
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))


def _make_json(path: Path) -> None:
    _, rows = _rows()
    path.write_text(json.dumps({"t": rows[:, 0].tolist(), "wrench": rows[:, 1:].tolist(), "who": "ann"}))


def _make_packed(path: Path) -> None:
    _make_csv(path)
    path.write_bytes(gzip.compress(path.read_bytes()))


def _make_csv(path: Path) -> None:
    header, rows = _rows()
    path.write_text(
        "\n".join([",".join(header), *(",".join(f"{value:.6f}" for value in row) for row in rows.tolist())])
    )


def _make_npz(path: Path) -> None:
    _, rows = _rows()
    np.savez(path, t=rows[:, 0], wrench=rows[:, 1:])


def _make_hdf5(path: Path) -> None:
    import h5py

    _, rows = _rows()
    with h5py.File(path, "w") as file:
        file["t"], file["wrench"] = rows[:, 0], rows[:, 1:]


def _make_matlab(path: Path) -> None:
    from scipy.io import savemat

    _, rows = _rows()
    savemat(path, {"t": rows[:, 0], "wrench": rows[:, 1:]})


def _make_parquet(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    header, rows = _rows()
    pq.write_table(pa.table(dict(zip(header, rows.T, strict=True))), path)


def _make_dat(path: Path) -> None:
    path.write_text("\n".join("\t".join(f"{value:.6f}" for value in row) for row in _rows()[1].tolist()) + "\n")


def _simulated(path: Path) -> Any:
    """What parameters of a file make of a trial."""
    physical = overrides.read(path)
    scenario, _ = sample(preset_of("A"), 0, 0, DomainRandomization(physical=physical))
    return [list(physical), np.asarray(scenario.sensor.delay)]


PHYSICAL = {"parts.tab_stiffness": 1.0, "sensor.delay": 6.0}
READERS = (
    Reader("model", _make_model, models.load, mutations.damaged_archive, finite),
    Reader("classifier", _make_classifier, model_io.load, mutations.damaged_archive, finite),
    Reader("thresholds.json", lambda path: write_limits(path, preset(), {}), read_limits, mutations.damaged_json_text,
           finite),
    Reader("mapping.toml", lambda path: write_mapping(path, Mapping((Channel("Fz", unit="N"),), time="t")),
           read_mapping, mutations.damaged_text),
    Reader("checkpoint.json", lambda path: checkpoint.save(path, {"seed": 1}, [1.0, None]),
           lambda path: checkpoint.load(path, {"seed": 1}), mutations.damaged_json_text),
    Reader("physical.json", lambda path: overrides.write(path, PHYSICAL, {}), _simulated, mutations.damaged_json_text,
           finite),
    Reader("results", _make_results, read_results, None, finite),
    Reader("store.zarr", lambda path: write_recordings(path, simple(3, 30), {}), _store, None, equal),
    Reader("bag.mcap", _make_mcap, lambda path: list(read_bag(path)), mutations.damaged, _told),
    Reader("R_Torques.dat", _make_dat, lambda path: read_timed(path, "wrench").values, mutations.damaged_text, finite),
    Reader("table.csv", _make_csv, _table("csv"), mutations.damaged_text, finite),
    Reader("table.csv.gz", _make_packed, _table("csv"), mutations.damaged, finite),
    Reader("table.json", _make_json, _table("json"), mutations.damaged_json_text, finite),
    Reader("table.jsonl", _make_json_lines, _table("jsonl"), mutations.damaged_text, finite),
    Reader("table.npz", _make_npz, _table("npz"), mutations.damaged_archive, finite),
    Reader("table.h5", _make_hdf5, _table("hdf5"), mutations.damaged, finite),
    Reader("table.mat", _make_matlab, _table("matlab"), mutations.damaged, finite),
    Reader("table.parquet", _make_parquet, _table("parquet"), mutations.damaged, finite),
)  # fmt: skip
