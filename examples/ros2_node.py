"""A ROS 2 node: words and beliefs of a force/torque sensor, as JSON in std_msgs/String.

    python examples/ros2_node.py --ros-args -p topic:=/wrench -p robot:=auto
    python examples/ros2_node.py --ros-args -p topic:=/wrench -p model:=/home/me/states.model
    python examples/ros2_node.py --ros-args -p topic:=/wrench -p monitor:=/home/me/skill.monitor

Subscribes to geometry_msgs/WrenchStamped on ``topic`` and to std_msgs/String on ``~/control``, whose data "begin"
begins a sub-task and "reset" a trial. Publishes on ``~/words``, ``~/beliefs``, ``~/scores`` and ``~/events`` (alarms,
sub-tasks, irregularities of the stream). Each message is one event of rcbht_jax.events as a JSON object.

Everything but ``main`` runs without ROS, and is tested so.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from rcbht_jax.calibration.rest import auto_thresholds
from rcbht_jax.encoding.limit_files import read_limits, taken_from_start
from rcbht_jax.encoding.rules import AnyLimits, config_of, limits_for
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.events import AnomalyScore, Belief, Event, Word
from rcbht_jax.introspection import nominal_file, segmenter_file
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import load
from rcbht_jax.introspection.nominal_watch import NominalWatch
from rcbht_jax.introspection.opening import READINGS, Elapsed, read_opening
from rcbht_jax.introspection.segmenter_stream import SegmenterStream
from rcbht_jax.introspection.session import Session
from rcbht_jax.introspection.together import Together
from rcbht_jax.introspection.words import WordIntrospector
from rcbht_jax.io.messages import Begin, Message, Reset, Silence, sample_of
from rcbht_jax.labels import AXES, UNITS

PARAMETERS: dict[str, Any] = {
    "topic": "/wrench",  # geometry_msgs/WrenchStamped
    "model": "",  # file of "rcbht train-online"; "" = words alone
    "robot": "auto",  # preset of the thresholds, for words alone; auto = from rest, in the first readings
    "thresholds": "",  # file of "rcbht calibrate", in place of the preset
    "rate": 0.0,  # Hz of the samples, for words alone; 0 = by their time stamps
    "window": 5,  # samples per straight line, for words alone
    "rule": "paper",  # of the words, paper or fit, for words alone
    "tolerance": 0.0,  # of rule:=fit, N and Nm; 0 = from the first readings
    "lead": 10.0,  # s at the beginning from which robot:=auto takes the thresholds, and rule:=fit the tolerances
    "monitor": "",  # file of "rcbht monitor fit", for scores and alarms beside words and beliefs
    "false_alarms": 0.05,  # of the monitor: share of nominal recordings that may raise an alarm
    "segmenter": "",  # file of "rcbht segment --write-model", for the phase of the newest sample among the beliefs
    "timeout": 1.0,  # s without a message that are reported as silence
}
TOPICS: dict[type[Event], str] = {Word: "words", Belief: "beliefs", AnomalyScore: "scores"}  # all others: events
CONTROL: dict[str, Message] = {"begin": Begin(), "reset": Reset()}


class Bridge:
    """Takes messages of a wrench topic, gives events as JSON.

    Args:
        parameters: see ``PARAMETERS``.
        publish: called with a topic (words, beliefs, scores or events) and a JSON object for each event.
    """

    def __init__(self, parameters: dict[str, Any], publish: Callable[[str, str], None]) -> None:
        self._parameters, self._publish = {**PARAMETERS, **parameters}, publish
        self._early: list[Message] = []  # until rate and thresholds are known
        self._elapsed = Elapsed(self._parameters["rate"])
        self._lead = 0.0 if self._parameters["model"] else self._seconds()
        self._latest = 0.0  # s, when the latest message was received
        self.session: Session | None = None
        self._readers: list[NominalWatch | SegmenterStream] = []
        if path := self._parameters["monitor"]:
            self._readers.append(NominalWatch(nominal_file.load(path), self._parameters["false_alarms"]))
        if path := self._parameters["segmenter"]:
            self._readers.append(SegmenterStream(segmenter_file.load(path)))
        if self._parameters["model"]:
            model = load(Path(self._parameters["model"]))
            model.check_wrench("A wrench of ROS")
            self._open(Introspector(model, words=True))

    def wrench(self, message: Any, received: float) -> None:
        """A geometry_msgs/WrenchStamped that was received at some time, s."""
        self._latest = received
        self._feed(sample_of(message, round(received * 1e9)))

    def control(self, word: str) -> None:
        """ "begin" or "reset"; anything else is ignored."""
        if word in CONTROL:
            self._feed(CONTROL[word])

    def watch(self, now: float) -> None:
        """Report silence; to be called now and then with the present time, s."""
        if self._latest and now - self._latest > self._parameters["timeout"]:
            self._feed(Silence(self._parameters["timeout"]))

    def finish(self) -> None:
        """Publish the words still held, also of a stream that ends before its thresholds are known."""
        if self.session is None and self._elapsed.readings > 1:
            self._begin()
        if self.session is not None:
            self._emit(self.session.finish())

    def _feed(self, message: Message) -> None:
        if self.session is not None:
            self._emit(self.session.feed(message))
            return
        self._early.append(message)
        self._elapsed.feed(message)
        if self._elapsed.readings >= READINGS and self._elapsed.seconds >= self._lead:
            self._begin()

    def _begin(self) -> None:
        early, self._early = self._early, []
        self._open(self._words(early))
        for message in early:
            self._feed(message)

    def _seconds(self) -> float:
        """How long readings are collected, from which limits are taken."""
        taken = taken_from_start(*(self._parameters[name] for name in ("rule", "robot", "thresholds", "tolerance")))
        return float(self._parameters["lead"]) if taken else 0.0

    def _words(self, early: list[Message]) -> WordIntrospector:
        opening = read_opening(iter(early), self._lead)
        own = 1 / self._readers[0].dt if self._readers else 0.0
        rate, window = self._parameters["rate"] or own or opening.rate(), self._parameters["window"]
        recordings = opening.recordings(rate, AXES)
        thresholds: AnyLimits
        if self._parameters["thresholds"]:
            thresholds, _ = read_limits(self._parameters["thresholds"], AXES, UNITS, self._parameters["rule"])
        elif self._parameters["robot"] == "auto":
            thresholds = auto_thresholds(recordings, window, self._parameters["rule"])
        else:
            thresholds = preset(self._parameters["robot"], AXES)
        config, tolerance = config_of(self._parameters["rule"], window, 1 / rate), self._parameters["tolerance"] or None
        limits = limits_for(config, thresholds, tolerance, recordings.wrench, recordings.length)
        return WordIntrospector(config, limits, AXES)

    def _open(self, introspector: Introspector | WordIntrospector) -> None:
        both = Together(introspector, readers=self._readers)
        both.warm_up()
        self.session = Session(both)

    def _emit(self, events: Iterable[Event]) -> None:
        for event in events:
            topic = next((topic for kind, topic in TOPICS.items() if isinstance(event, kind)), "events")
            self._publish(topic, json.dumps(event.to_json(), allow_nan=False))


def main() -> None:
    """Run the node until it is stopped."""
    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from rcl_interfaces.msg import ParameterDescriptor
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import String

    rclpy.init()
    node = rclpy.create_node("rcbht")
    any_type = ParameterDescriptor(dynamic_typing=True)  # else ROS refuses "rate:=200", which is no double
    parameters = {
        name: type(value)(node.declare_parameter(name, value, any_type).value) for name, value in PARAMETERS.items()
    }
    publishers = {name: node.create_publisher(String, f"~/{name}", 100) for name in (*TOPICS.values(), "events")}
    bridge = Bridge(parameters, lambda topic, text: publishers[topic].publish(String(data=text)))

    def now() -> float:
        return float(node.get_clock().now().nanoseconds) * 1e-9

    # Deep, so that what arrives while the encoder compiles is not lost.
    sensor = QoSProfile(depth=20_000, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(WrenchStamped, parameters["topic"], lambda message: bridge.wrench(message, now()), sensor)
    node.create_subscription(String, "~/control", lambda message: bridge.control(message.data), 10)
    node.create_timer(0.5, lambda: bridge.watch(now()))
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        bridge.finish()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
