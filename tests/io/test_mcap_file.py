"""Damaged MCAP files: every reading that comes out is one that was written, and what is lost is told."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from rcbht_jax._util.untrusted import MAX_CHANNELS, MAX_SCHEMA
from rcbht_jax.errors import InputError
from rcbht_jax.io.mcap_file import CHANNEL, CHUNK, MAGIC, SCHEMA, sound
from rcbht_jax.io.messages import Malformed, Sample
from rcbht_jax.io.rosbags import WRENCH, McapWriter, read_bag

READINGS = 12_000  # two chunks of 1 MiB


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "run.mcap"
    with McapWriter(path) as out:
        for k in range(READINGS):
            out.wrench(0.001 * k, (float(k), 1.0, 2.0, 3.0, 4.0, 5.0))
    return path


def read(path: Path) -> tuple[list[float], list[str]]:
    """Fx of all readings, and what was told."""
    found = list(read_bag(path, "/wrench"))
    return [m.wrench[0] for m in found if isinstance(m, Sample)], [m.text for m in found if isinstance(m, Malformed)]


def test_checksums_are_those_of_other_programs(recording: Path) -> None:
    with recording.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages(log_time_order=False)) == READINGS
    assert read(recording) == ([float(k) for k in range(READINGS)], [])
    raw = recording.read_bytes()
    kind, length = struct.unpack("<BQ", raw[-8 - 29 : -8 - 20])
    assert (kind, length) == (2, 20)
    assert all(struct.unpack("<QQI", raw[-28:-8]))  # the checksum of the index among them


def test_a_file_says_its_own_name_and_is_the_same_each_time(tmp_path: Path) -> None:
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        with McapWriter(folder / "run.mcap") as out:
            out.wrench(0.0, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
        assert [path.name for path in folder.iterdir()] == ["run.mcap"]
    one, other = ((tmp_path / name / "run.mcap").read_bytes() for name in "ab")
    assert one == other
    with (tmp_path / "a/run.mcap").open("rb") as file:
        [record] = make_reader(file).iter_metadata()
    assert "relative_file_paths:\n- run.mcap\n" in record.metadata["serialized_metadata"]
    assert "partial" not in record.metadata["serialized_metadata"]


def flip(raw: bytearray, rng: random.Random) -> None:
    raw[rng.randrange(9, len(raw))] ^= 1 << rng.randrange(8)


def overwrite(raw: bytearray, rng: random.Random) -> None:
    at = rng.randrange(9, len(raw) - 300)
    raw[at : at + 300] = rng.randbytes(300)


def cut(raw: bytearray, rng: random.Random) -> None:
    del raw[rng.randrange(1000, len(raw)) :]


def leave_out(raw: bytearray, rng: random.Random) -> None:
    at = rng.randrange(9, len(raw))
    del raw[at : at + rng.randrange(1, 3000)]


@pytest.mark.parametrize("damage", [flip, overwrite, cut, leave_out])
def test_damage_is_told_and_nothing_false_is_read(
    damage: Callable[[bytearray, random.Random], None], recording: Path, tmp_path: Path
) -> None:
    rng, path, halves = random.Random(damage.__name__), tmp_path / "run.mcap", 0
    for _ in range(6):
        raw = bytearray(recording.read_bytes())
        damage(raw, rng)
        path.write_bytes(raw)
        try:
            readings, told = read(path)
        except InputError:  # its header is damaged, or nothing is left
            continue
        assert told or readings == [float(k) for k in range(READINGS)]
        assert len(readings) == len(set(readings))
        assert set(readings) <= set(map(float, range(READINGS)))
        halves += 0 < len(readings) < READINGS
    assert halves


def test_of_a_folder_with_a_file_that_is_cut_off_all_that_is_whole_is_read(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/wrench", WRENCH[1], typestore=store)
        vector, wrench = (store.types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Wrench"))
        for k in range(READINGS):
            message = wrench(force=vector(float(k), 1.0, 2.0), torque=vector(3.0, 4.0, 5.0))
            writer.write(connection, k * 10**6, store.serialize_cdr(message, WRENCH[1]))
    file = tmp_path / "run" / "run.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert read(tmp_path / "run") == read(file)
    readings, told = read(file)
    assert 0 < len(readings) < READINGS
    assert told == ["the bag is damaged (the file is cut off, or damaged in the middle); what is whole of it is read"]


def record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


@pytest.mark.parametrize(
    ("records", "sentence"),
    [
        (record(CHANNEL, b"") * (MAX_CHANNELS + 1), "channels"),
        (record(SCHEMA, bytes(MAX_SCHEMA + 1)), f"describes a message in {MAX_SCHEMA + 1} bytes"),
        (
            record(
                CHUNK,
                struct.pack("<QQQIIQ", 0, 0, MAX_SCHEMA + 10, 0, 0, MAX_SCHEMA + 10)
                + record(SCHEMA, bytes(MAX_SCHEMA + 1)),
            ),
            "describes a message",
        ),
        (record(CHUNK, struct.pack("<QQQII", 0, 0, 2**40, 0, 0) + bytes(8)), "chunk of"),
        (struct.pack("<BQ", CHUNK, 2**27) + bytes(2**27), "record of"),
    ],
)
def test_what_is_too_large_is_refused(records: bytes, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(MAGIC + record(1, bytes(8)) + records + MAGIC)
    with pytest.raises(InputError, match=sentence), sound(path):
        pass
