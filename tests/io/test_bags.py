"""Bags: those of ROS 1 and ROS 2 as messages, and a stream as MCAP."""

from __future__ import annotations

import os
import sqlite3
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.reader import zstd
from rosbags.typesys import Stores, get_typestore

from rcbht_jax.errors import InputError
from rcbht_jax.events import Notice
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.session import Session
from rcbht_jax.io.messages import Malformed, Sample, is_bag
from rcbht_jax.io.rosbags import McapWriter, read_bag
from tests.io.test_stream_sources import samples_of
from tests.support.introspection_models import model, trial

DT = 0.005
ZERO = (0.0,) * 6
WRENCH = "geometry_msgs/msg/WrenchStamped"


def write_bag(
    path: Path, kind: str, wrench: np.ndarray, topics: tuple[str, ...] = ("/wrench",), packed: str = ""
) -> Path:
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    vector, types = store.types["geometry_msgs/msg/Vector3"], store.types
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer = Writer1(path) if kind == "ros1" else Writer(path, version=9, storage_plugin=plugin)
    if packed:
        writer.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
    with writer:
        connections = [writer.add_connection(topic, WRENCH, typestore=store) for topic in topics]
        for k, row in enumerate(wrench.tolist()):
            stamp = types["builtin_interfaces/msg/Time"](sec=100 + k // 200, nanosec=(k % 200) * 5_000_000)
            extra = {"seq": k} if kind == "ros1" else {}
            message = types[WRENCH](
                header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **extra),
                wrench=types["geometry_msgs/msg/Wrench"](force=vector(*row[:3]), torque=vector(*row[3:])),
            )
            raw = store.serialize_ros1(message, WRENCH) if kind == "ros1" else store.serialize_cdr(message, WRENCH)
            for connection in connections:
                writer.write(connection, k * 5_000_000 + 7, raw)
    return path


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap", "file"])
def test_bags(tmp_path, kind):
    wrench = trial(1, 60, 250).astype(np.float64)
    path = write_bag(tmp_path / ("b.bag" if kind == "ros1" else "b"), kind.replace("file", "mcap"), wrench)
    if kind == "file":
        [path] = path.glob("*.mcap")
    assert is_bag(path)
    samples = list(read_bag(path))
    np.testing.assert_array_equal([s.wrench for s in samples], wrench)
    np.testing.assert_allclose([s.time for s in samples], 100 + np.arange(250) * DT, atol=1e-9)
    events = list(Session(Introspector(model())).run(samples))
    assert not [e for e in events if isinstance(e, Notice)]
    assert max(e.sample for e in events) == 240


@pytest.mark.parametrize(("packed", "kind"), [("FILE", "sqlite3"), ("FILE", "mcap"), ("MESSAGE", "sqlite3")])
def test_packed_bags(packed, kind, tmp_path):
    """They are read, and what unpacks to far more than it is costs neither disk nor memory."""
    wrench = trial(1, 60, 50).astype(np.float64)
    path = write_bag(tmp_path / "b", kind, wrench, packed=packed)
    np.testing.assert_array_equal([s.wrench for s in read_bag(path)], wrench)
    bomb = zstd.compress(bytes(300_000_000))
    if packed == "FILE":
        [file] = path.glob("*.zstd")
        file.write_bytes(bomb)
        with pytest.raises(InputError, match=r"declares arrays of \d+; that is not a recording"):
            list(read_bag(path))
        file.write_bytes(bomb[:100])
        with pytest.raises(InputError, match=r"is not a readable bag"):
            list(read_bag(path))
        return
    with closing(sqlite3.connect(next(path.glob("*.db3")))) as table, table:
        table.execute("UPDATE messages SET data = ? WHERE id = 3", (bomb,))
        table.execute("UPDATE messages SET data = ? WHERE id = 5", (b"junk",))
    found = list(read_bag(path))
    assert [one.text.split(" (")[0] for one in found if isinstance(one, Malformed)] == ["a message cannot be read"] * 2
    assert len(found) == 50


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_messages_that_are_packed_one_by_one_need_no_metadata(kind, tmp_path):
    """A file alone, as of a bag whose other files are damaged, had no readable message."""
    wrench = trial(1, 60, 50).astype(np.float64)
    [file] = write_bag(tmp_path / "b", kind, wrench, packed="MESSAGE").glob("b.*")
    np.testing.assert_array_equal([s.wrench for s in read_bag(file)], wrench)


def test_files_of_a_bag_that_are_none_are_not_waited_for(tmp_path):
    """Whatever their names, which the metadata may hold."""
    path = write_bag(tmp_path / "b", "sqlite3", trial(1, 60, 50))
    os.mkfifo(path / "evil")
    with pytest.raises(InputError, match="evil is not a regular file"):
        list(read_bag(path))


def test_bags_that_are_none(tmp_path):
    wrench = trial(1, 60, 50)
    two = write_bag(tmp_path / "two", "mcap", wrench, ("/left", "/right"))
    with pytest.raises(InputError, match="2 topics"):
        list(read_bag(two))
    assert len(list(read_bag(two, "/left"))) == 50
    with pytest.raises(InputError, match="no wrenches on /up"):
        list(read_bag(two, "/up"))
    with McapWriter(tmp_path / "grip.mcap", ("grip", "push"), ("N", "V")) as out:
        out.wrench(0.0, (1.0, 2.0))
    with pytest.raises(InputError, match=r"grip.mcap has no wrenches; its topics are /signal\.$"):
        list(read_bag(tmp_path / "grip.mcap"))
    [file] = two.glob("*.mcap")
    whole = file.read_bytes()
    for cut, sentence in ((0, "is empty"), (5, "is not a readable bag"), (60, "is damaged .*cut off")):
        (tmp_path / "cut.mcap").write_bytes(whole[:cut])
        with pytest.raises(InputError, match=rf"cut.mcap {sentence}"):
            list(read_bag(tmp_path / "cut.mcap", "/left"))
    with pytest.raises(InputError, match="does not exist"):
        list(read_bag(tmp_path / "none.bag"))


def test_mcap_out_can_be_read_back(tmp_path):
    path = tmp_path / "out.mcap"
    session = Session(Introspector(model()))
    with McapWriter(path) as out:
        for message in samples_of(trial(2, 61, 300), (100,)):
            for event in session.feed(message):
                out.event(event)
            if isinstance(message, Sample):
                out.wrench(session.time, message.wrench)
        out.labels(session.time, session.introspector.labels[:, 0])
    with AnyReader([path]) as reader:
        found: dict[str, list[object]] = {}
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    assert {k: len(v) for k, v in found.items()} == {
        "/wrench": 300, "/labels": 1, "/events": 1, "/belief/states": 15, "/belief/outcome": 15,
        "/belief/failure_type": 15,
    }  # fmt: skip
    last = found["/belief/states"][-1]
    belief = session.introspector.latest["states"]
    assert (last.label, last.level, last.probabilities.tolist()) == (
        belief.label, belief.level, list(belief.probabilities),
    )  # fmt: skip
    [labels] = found["/labels"]
    assert labels.primitive.tolist() == session.introspector.labels[0, 0].tolist()
    assert all(name == "-" or name.isalpha() for name in labels.llb_name)
    assert len(list(read_bag(path))) == 300


def test_mcap_out_keeps_what_was_recorded(tmp_path):
    """An interruption costs the rest of a recording, not its beginning; without a beginning the old file stays."""
    path = tmp_path / "out.mcap"
    path.write_text("old")

    def broken(readings: int) -> None:
        with McapWriter(path) as out:
            for k in range(readings):
                out.wrench(k * DT, ZERO)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken(0)
    assert path.read_text() == "old"
    with pytest.raises(KeyboardInterrupt):
        broken(3)
    assert [sample.time for sample in read_bag(path)] == pytest.approx([0, DT, 2 * DT])
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InputError, match="not a folder"):
        McapWriter(tmp_path / "none" / "x.mcap")


@pytest.mark.parametrize(
    ("stamps", "written"),
    [([-1.0, -0.5, 2.0], [0.0, 0.5, 3.0]), ([1.7e12, 1.7e12 + 5], [0.0, 5.0]), ([3.0, 1e18, 1e308, -2.0], None)],
)
def test_stamps_that_ros_cannot_hold(tmp_path, stamps, written):
    """No time of a source ends a recording."""
    with McapWriter(tmp_path / "out.mcap") as out:
        for stamp in stamps:
            out.wrench(stamp, ZERO)
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        found = [received * 1e-9 for _, received, _ in reader.messages()]
    assert sorted(found) == pytest.approx(written or [0.0, 3.0, 2.0**31 - 1, 2.0**31 - 1])


def test_metadata_of_a_bag_that_take_long_are_refused_before(tmp_path):
    """Lists in a list: the YAML parser takes 20 s for each MB of them."""
    path = write_bag(tmp_path / "b", "mcap", np.zeros((3, 6)))
    (path / "metadata.yaml").write_text("[" + "1," * 500_000 + "1]")
    start = time.process_time()
    with pytest.raises(InputError, match=r"metadata\.yaml has 1000003 bytes; expected at most 131072"):
        list(read_bag(path))
    assert time.process_time() - start < 1


def test_a_bag_of_four_hundred_topics_is_read(tmp_path):
    path = write_bag(tmp_path / "b", "mcap", np.zeros((2, 6)), tuple(f"/robot/arm{k}/wrench" for k in range(400)))
    assert (path / "metadata.yaml").stat().st_size > 110_000
    assert len([one for one in read_bag(path, "/robot/arm7/wrench") if isinstance(one, Sample)]) == 2
