"""Bags and MCAP files whose messages are not those of a wrench topic of ROS 2."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Mapping
from rcbht_jax.io.rosbags import WRENCH, McapWriter, open_bag

MAGIC = b"\x89MCAP0\r\n"


def test_a_wrench_within_another_message_keeps_its_stamps(tmp_path: Path) -> None:
    store, kind = get_typestore(Stores.ROS2_HUMBLE), "my_msgs/msg/State"
    store.register(get_types_from_msg("int32 mode\ngeometry_msgs/WrenchStamped ft\n", kind))
    types, rng = store.types, np.random.default_rng(0)
    vector = types["geometry_msgs/msg/Vector3"]
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/state", kind, typestore=store)
        for k in range(60):
            stamp = types["builtin_interfaces/msg/Time"](sec=100, nanosec=k * 10_000_000)
            wrench = types["geometry_msgs/msg/Wrench"](force=vector(k, 1, 2), torque=vector(3, 4, -k))
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            ft = types["geometry_msgs/msg/WrenchStamped"](header=header, wrench=wrench)
            late = round((100.5 + k * 0.01 + rng.uniform(0, 0.004)) * 1e9)
            writer.write(connection, late, store.serialize_cdr(types[kind](mode=1, ft=ft), kind))
    recordings = read_source(tmp_path / "run", mapping=Mapping(topic="/state")).recordings
    assert (recordings.dt, recordings.note.tolist()) == (0.01, [""])
    np.testing.assert_array_equal(recordings.wrench[0, :, 0], np.arange(60))


def record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def text(word: str) -> bytes:
    return struct.pack("<I", len(word)) + word.encode()


@pytest.mark.parametrize(
    ("profile", "schema", "encoding"),
    [
        ("", "jsonschema", "json"),
        ("ros2", "jsonschema", "json"),
        ("ros2", "protobuf", "protobuf"),
        ("ros1", "ros1msg", "ros1"),
    ],
)
def test_an_mcap_of_other_messages_is_refused_with_what_to_do(
    profile: str, schema: str, encoding: str, tmp_path: Path
) -> None:
    records = [
        record(1, text(profile) + text("")),
        record(3, struct.pack("<H", 1) + text("Wrench") + text(schema) + text("{}")),
        record(4, struct.pack("<HH", 1, 1) + text("/w") + text(encoding) + struct.pack("<I", 0)),
        *(record(5, struct.pack("<HIQQ", 1, k, k, k) + json.dumps({"force": k}).encode()) for k in range(9)),
        record(15, bytes(4)),
        record(2, bytes(20)),
    ]
    (tmp_path / "run.mcap").write_bytes(MAGIC + b"".join(records) + MAGIC)
    with pytest.raises(InputError, match=r"messages that are not of ROS 2, .* or the wrench as CSV or JSON lines"):
        read_source(tmp_path / "run.mcap")


def test_topics_of_ros_2_are_read_beside_others(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    definition, _ = store.generate_msgdef(WRENCH[0], ros_version=2)
    records = [
        record(1, text("") + text("")),
        record(3, struct.pack("<H", 1) + text("Step") + text("jsonschema") + text("{}")),
        record(4, struct.pack("<HH", 1, 1) + text("/steps") + text("json") + struct.pack("<I", 0)),
        record(3, struct.pack("<H", 2) + text(WRENCH[0]) + text("ros2msg") + text(definition)),
        *(
            record(4, struct.pack("<HH", channel, 2) + text("/wrench") + text("cdr") + struct.pack("<I", 0))
            for channel in (2, 3)  # two publishers
        ),
    ]
    with McapWriter(tmp_path / "plain.mcap") as out:
        for k in range(60):
            out.wrench(0.01 * k, (float(k), 1.0, 2.0, 3.0, 4.0, 5.0))
    with open_bag(tmp_path / "plain.mcap") as reader:
        for k, (_, time, raw) in enumerate(reader.messages()):
            records.append(record(5, struct.pack("<HIQQ", 2 + k % 2, k, time, time) + raw))
            records.append(record(5, struct.pack("<HIQQ", 1, k, time, time) + b"{}"))
    (tmp_path / "run.mcap").write_bytes(
        MAGIC + b"".join([*records, record(15, bytes(4)), record(2, bytes(20))]) + MAGIC
    )
    recordings = read_source(tmp_path / "run.mcap").recordings
    assert recordings.note.tolist() == [""]
    np.testing.assert_array_equal(recordings.wrench[0, :, 0], np.arange(60))
    with pytest.raises(
        InputError, match=r"its topics are /wrench\. Messages in other encodings than that of ROS 2 are"
    ):
        read_source(tmp_path / "run.mcap", mapping=Mapping(topic="/steps"))
