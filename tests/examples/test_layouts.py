"""The layouts for Foxglove and PlotJuggler name fields that "rcbht stream --mcap" really writes."""

from __future__ import annotations

import io
import json
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from rcbht_jax._util import compile_cache
from rcbht_jax.cli.main import main
from rcbht_jax.introspection import model as model_files
from rcbht_jax.introspection import nominal_file
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.labels import AXES
from tests.support.introspection_models import model, trial

LAYOUTS = Path(__file__).resolve().parents[2] / "examples/layouts"
STATES = 4  # of the assembly; the model of this test has fewer


def leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Paths of the numbers and texts in a message, as topic/field/field[index]."""
    if hasattr(value, "__dataclass_fields__"):
        for name in value.__dataclass_fields__:
            if name != "__msgtype__":
                yield from leaves(getattr(value, name), f"{path}/{name}")
    elif isinstance(value, list | np.ndarray):
        for number, item in enumerate(value):
            yield from leaves(item, f"{path}[{number}]")
    else:
        yield path, value


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Fields of a recorded stream and a value of each."""
    folder = tmp_path_factory.mktemp("stream")
    model_files.save(folder / "m", model())
    monitor = NominalMonitor(rate=200).fit([trial(1, seed, 300) for seed in range(6)])
    nominal_file.save(folder / "n", nominal_file.MonitorFile(monitor, AXES, ()))
    wrench = np.concatenate([trial(1, 30, 150), trial(0, 31, 150)])
    rows = [json.dumps({"wrench": row, "time": 1 + 0.005 * k}) for k, row in enumerate(wrench.tolist())]
    text = "\n".join([*rows[:150], '{"begin": true}', *rows[150:]])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compile_cache, "use", lambda folder: None)
        patch.setattr(sys, "stdin", type("Stdin", (), {"buffer": io.BytesIO(text.encode())}))
        words = ["stream", "-", "-m", str(folder / "m"), "--words", "--mcap", str(folder / "o.mcap")]
        words += ["--monitor", str(folder / "n"), "--false-alarms", "0.2"]
        assert main([*words, "-o", str(folder / "o.jsonl")]) == 0
    with AnyReader([folder / "o.mcap"]) as reader:
        fields: dict[str, Any] = {}
        for connection, _, raw in reader.messages():
            fields[connection.topic] = None
            fields |= dict(leaves(reader.deserialize(raw, connection.msgtype), connection.topic))
    return fields


def known(path: str, written: dict[str, Any]) -> bool:
    """Whether a field is written; one of the probabilities counts for all of as many classes as there are states."""
    match = re.fullmatch(r"(.*/probabilities)\[(\d+)\]", path)
    return path in written or (match is not None and int(match[2]) < STATES and f"{match[1]}[0]" in written)


def test_foxglove_names_fields_that_are_written(written: dict[str, Any]) -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text())
    panels = layout["configById"]
    topics = [path for path in written if written[path] is None]
    paths = [entry["value"] for panel in panels.values() for entry in panel.get("paths", ())]
    assert len(paths) > 15
    for path in paths:
        topic = max((topic for topic in topics if path.startswith(topic + ".")), key=len, default="")
        assert topic, path
        assert known(topic + path.removeprefix(topic).replace(".", "/"), written), path
    numbers = [entry["value"] for name in panels if name.startswith("Plot!") for entry in panels[name]["paths"]]
    assert not [path for path in numbers if "name" in path or path.endswith("label")]
    for panel in panels.values():
        assert panel.get("topicPath", "/events") in topics

    def shown(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else shown(node["first"]) + shown(node["second"])

    assert sorted(shown(layout["layout"])) == sorted(panels)


def test_plotjuggler_names_numbers_that_are_written(written: dict[str, Any]) -> None:
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    curves = [str(curve.get("name")) for curve in root.iter("curve")]
    assert len(curves) > 20
    for curve in curves:
        assert known(curve, written), curve
        assert not isinstance(written.get(curve), str), curve
    for splitter in root.iter("DockSplitter"):
        count = len(list(splitter))
        assert splitter.get("count") == str(count) == str(len(str(splitter.get("sizes")).split(";")))


def test_a_wrong_name_is_noticed(written: dict[str, Any]) -> None:
    assert known("/labels/llb[5]", written)
    for wrong in (
        "/labels/llb[6]",
        "/label/llb[0]",
        "/belief/states/probability[0]",
        "/belief/states/probabilities[4]",
    ):
        assert not known(wrong, written)
