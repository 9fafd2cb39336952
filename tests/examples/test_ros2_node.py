"""The ROS 2 node without ROS: its callbacks with messages of a recorded bag, its main with a stand-in for rclpy."""

from __future__ import annotations

import json
import runpy
import sys
from collections import Counter
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import rcbht_jax as rj
from rcbht_jax.calibration.rest import auto_thresholds
from rcbht_jax.encoding.thresholds import write_thresholds
from rcbht_jax.errors import InputError
from rcbht_jax.introspection import model as model_files
from rcbht_jax.introspection import nominal_file, segmenter_file
from rcbht_jax.introspection.nominal import NominalMonitor
from rcbht_jax.introspection.opening import read_opening
from rcbht_jax.introspection.segmenter import WrenchSegmenter
from rcbht_jax.io.messages import Sample
from rcbht_jax.io.rosbags import messages, open_bag
from rcbht_jax.labels import LAYERS
from tests.support.introspection_models import model, trial

NODE = runpy.run_path(str(Path(__file__).resolve().parents[2] / "examples/ros2_node.py"))
Bridge = NODE["Bridge"]


class Heard:
    """What was published, by topic."""

    def __init__(self) -> None:
        self.events: dict[str, list[dict[str, Any]]] = {name: [] for name in ("words", "beliefs", "scores", "events")}

    def __call__(self, topic: str, text: str) -> None:
        self.events[topic].append(json.loads(text))


def stamped(row: list[float], seconds: float) -> Any:
    """A message like a geometry_msgs/WrenchStamped."""
    force, torque = (SimpleNamespace(**dict(zip("xyz", part, strict=True))) for part in (row[:3], row[3:]))
    stamp = SimpleNamespace(sec=int(seconds), nanosec=round(seconds % 1 * 1e9))
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp), wrench=SimpleNamespace(force=force, torque=torque))


@pytest.mark.parametrize("options", [{}, {"rule": "fit", "tolerance": 0.25}])
def test_words_of_a_topic_are_those_of_the_recording(options: dict[str, Any]) -> None:
    heard = Heard()
    bridge = Bridge({"robot": "hiro", **options}, heard)
    wrench = trial(2, 7, 300)
    for k, row in enumerate(wrench.tolist()):
        bridge.wrench(stamped(row, 1000 + 0.005 * k), 2000.0)
    bridge.finish()
    tracks = rj.encode(wrench, rate=200, **options)
    counts = Counter(word["layer"] for word in heard.events["words"])
    assert counts == {layer: int(np.count_nonzero(getattr(tracks, layer).label)) for layer in LAYERS}
    assert {word["axis"] for word in heard.events["words"]} == set(rj.labels.AXES)
    assert min(word["start"] for word in heard.events["words"]) == pytest.approx(1000)
    assert heard.events["beliefs"] == heard.events["events"] == []


def test_beliefs_sub_tasks_and_silence(tmp_path: Path) -> None:
    model_files.save(tmp_path / "m", model())
    heard = Heard()
    bridge = Bridge({"model": str(tmp_path / "m")}, heard)
    bridge.watch(5.0)  # nothing was ever received
    for k, row in enumerate(trial(1, 8, 200).tolist()):
        if k == 100:
            bridge.control("begin")
            bridge.control("nonsense")
        bridge.wrench(stamped(row, 10 + 0.005 * k), 10 + 0.005 * k)
    bridge.wrench(object(), 11.0)
    bridge.watch(11.5)
    bridge.watch(12.5)
    bridge.watch(13.0)
    kinds = [event.get("kind", event["event"]) for event in heard.events["events"]]
    alarms = {"AnomalyRaised", "AnomalyCleared", "FailureType"}  # a push is a failure to this model
    assert alarms & {*kinds}
    assert [kind for kind in kinds if kind not in alarms] == ["SubtaskStarted", "malformed", "silent"]
    assert Counter(belief["head"] for belief in heard.events["beliefs"])["states"] == 10
    assert heard.events["words"]


def test_scores_of_a_monitor_and_labels_of_a_segmenter(tmp_path: Path) -> None:
    monitor = NominalMonitor(rate=200).fit([trial(1, seed, 300) for seed in range(6)])
    nominal_file.save(tmp_path / "n", nominal_file.MonitorFile(monitor, rj.labels.AXES, ()))
    wrench = trial(1, 8, 300) + 50.0 * (np.arange(300) > 200)[:, None]
    heard = Heard()
    data = rj.Recordings.from_arrays([trial(1, seed, 300) for seed in range(3)], 200.0, axes=rj.labels.AXES)
    segmenter = WrenchSegmenter(trees=3).fit(data, [np.arange(300) // 150] * 3)
    segmenter_file.save(tmp_path / "s", segmenter_file.SegmenterFile.of(segmenter, "phase", ("first", "second")))
    files = {"monitor": str(tmp_path / "n"), "segmenter": str(tmp_path / "s")}
    bridge = Bridge({**files, "false_alarms": 0.2, "robot": "hiro"}, heard)
    for k, row in enumerate(wrench.tolist()):
        bridge.wrench(stamped(row, 10 + 0.005 * k), 10 + 0.005 * k)
    scores = monitor.scores(wrench.astype(np.float32))[9::10]
    np.testing.assert_allclose([event["score"] for event in heard.events["scores"]], scores, rtol=1e-5)
    assert [event["event"] for event in heard.events["events"]] == ["AnomalyRaised"]
    assert {(event["head"], event["label"]) for event in heard.events["beliefs"]} >= {("phase", "first")}
    assert len(heard.events["beliefs"]) == 60
    assert heard.events["words"]


def test_thresholds_of_a_file_and_of_the_first_readings(tmp_path: Path) -> None:
    write_thresholds(tmp_path / "t.json", rj.preset(), {})
    found = {}
    for name, parameters in (("file", {"thresholds": str(tmp_path / "t.json")}), ("auto", {"lead": 1.0})):
        heard = Heard()
        bridge = Bridge(parameters, heard)
        for k, row in enumerate((5 * trial(0, 9, 400)).tolist()):
            bridge.wrench(stamped(row, 10 + 0.005 * k), 0.0)
            if k == 150:
                assert (bridge.session is None) == (name == "auto")  # the first second is only collected
        bridge.finish()
        found[name] = sum(word["layer"] == "primitive" for word in heard.events["words"])
    assert found["auto"] < found["file"] / 4  # the preset hears words in this noise


@pytest.mark.parametrize("rule", ["paper", "fit"])
def test_thresholds_of_the_first_readings_are_those_of_the_rule(rule: str, tmp_path: Path) -> None:
    ramp = 10 * np.maximum(np.arange(400) * 0.005 - 1, 0)  # N; rest by one rule's thresholds, a rise by the other's
    rows = (5 * trial(0, 9, 400) + ramp[:, None]).tolist()
    opening = read_opening(iter(Sample(tuple(row), 10 + 0.005 * k) for k, row in enumerate(rows)), 1.0)
    limits = auto_thresholds(opening.recordings(200.0, rj.labels.AXES), 5, rule)
    write_thresholds(tmp_path / "t.json", limits, {})
    found = []
    for parameters in ({}, {"thresholds": str(tmp_path / "t.json")}):
        heard = Heard()
        bridge = Bridge({"rule": rule, "lead": 1.0, **parameters}, heard)
        for k, row in enumerate(rows):
            bridge.wrench(stamped(row, 10 + 0.005 * k), 0.0)
        bridge.finish()
        found.append(heard.events["words"])
    assert found[0] == found[1] != []


def test_limits_of_the_other_rule_are_refused_at_once(tmp_path: Path) -> None:
    """Words by the fit rule had limits of single windows at rest; "rcbht serve -" refused them ten seconds late."""
    write_thresholds(tmp_path / "t.json", rj.preset(), {"method": "rest"})
    with pytest.raises(InputError, match="are for --rule paper"):
        Bridge({"rule": "fit", "thresholds": str(tmp_path / "t.json")}, Heard())


def test_a_recorded_bag(external_dir: Path) -> None:
    heard = Heard()
    bridge = Bridge({"lead": 2.0}, heard)
    bag = next(iter(sorted((external_dir / "bags").glob("*.bag"))))
    with open_bag(bag) as reader:
        chosen = [c for c in reader.connections if c.topic == "/wrench/filtered/right"]
        for _, received, message in islice(messages(reader, chosen), 1500):
            bridge.wrench(message, received * 1e-9)
    bridge.finish()
    assert bridge.session.counts["sample"] == 1500
    assert {word["axis"] for word in heard.events["words"]} == set(rj.labels.AXES)
    assert {word["layer"] for word in heard.events["words"]} == set(LAYERS)


def test_main_connects_the_topics(monkeypatch: pytest.MonkeyPatch) -> None:
    """With modules in the place of ROS: a message on the topic comes out as words."""
    told: dict[str, list[str]] = {}
    taken: dict[str, Callable[[Any], None]] = {}

    class Node:
        def declare_parameter(self, name: str, value: Any, descriptor: Any) -> Any:
            """ROS refuses another type than that of the default, unless the descriptor says otherwise."""
            given = {"robot": "hiro", "rate": 200, "lead": 5}.get(name, value)
            assert type(given) is type(value) or descriptor["dynamic_typing"]
            return SimpleNamespace(value=given)

        def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
            return SimpleNamespace(publish=lambda message: told.setdefault(topic, []).append(message.data))

        def create_subscription(self, kind: Any, topic: str, callback: Callable[[Any], None], quality: Any) -> None:
            taken[topic] = callback

        def create_timer(self, period: float, callback: Callable[[], None]) -> None:
            callback()

        def get_clock(self) -> Any:
            return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=5_000_000_000))

        def destroy_node(self) -> None: ...

    def spin(node: Node) -> None:
        for k, row in enumerate(trial(1, 3, 100).tolist()):
            taken["/wrench"](stamped(row, 1 + 0.005 * k))
        taken["~/control"](SimpleNamespace(data="begin"))
        raise KeyboardInterrupt

    nothing = SimpleNamespace(WrenchStamped=None, ExternalShutdownException=RuntimeError, String=SimpleNamespace)
    nothing.QoSProfile, nothing.ReliabilityPolicy = dict, SimpleNamespace(BEST_EFFORT=1)
    nothing.ParameterDescriptor = dict
    nothing.init, nothing.try_shutdown, nothing.create_node, nothing.spin = list, list, lambda name: Node(), spin
    messages = ("geometry_msgs", "geometry_msgs.msg", "rcl_interfaces", "rcl_interfaces.msg", "std_msgs.msg")
    for name in ("rclpy", "rclpy.executors", "rclpy.qos", *messages):
        module = ModuleType(name)
        module.__dict__.update(vars(nothing))
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setitem(sys.modules, "std_msgs", ModuleType("std_msgs"))
    NODE["main"]()
    assert set(taken) == {"/wrench", "~/control"}
    assert json.loads(told["~/words"][0])["event"] == "Word"
    assert json.loads(told["~/events"][0])["event"] == "SubtaskStarted"


@pytest.mark.parametrize("back", [0.0, 1000.0])
def test_a_beginning_that_is_short_or_whose_clock_is_set_back_is_not_lost(back: float) -> None:
    """A node that was stopped before its lead was over said nothing; one whose clock was set back never began."""
    heard = Heard()
    bridge = Bridge({"lead": 1.0}, heard)
    for k, row in enumerate(trial(2, 7, 250 if back else 150).tolist()):
        bridge.wrench(stamped(row, 5000 + 0.005 * k - (back if k >= 20 else 0)), 0.0)
    assert (bridge.session is None) == (not back)
    bridge.finish()
    assert {word["layer"] for word in heard.events["words"]} == set(LAYERS)
