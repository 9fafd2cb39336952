"""Recordings of other robots (RCBHT_EXTERNAL), read by the mappings of the examples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from experiments._lib.catalogue import EXTERNAL
from rcbht_jax.io.importing.importer import read_source
from rcbht_jax.io.importing.mapping import Channel, read_mapping
from rcbht_jax.types import Recordings

MAPPINGS = Path(__file__).resolve().parents[2] / "examples" / "mappings"
KITTING = {  # name of a channel -> its column
    "force": "robotiq_force_sensor.wrench.force.norm",
    "torque": "robotiq_force_sensor.wrench.torque.norm",
    "speed": "baxter_enpoint_pose.twist.linear.norm",
    "rotation": "baxter_enpoint_pose.twist.angular.norm",
    "left": "tactile_static_data.left.std",
    "right": "tactile_static_data.right.std",
}


def of_other_robot(
    source: str, mapping: str, channels: Mapping[str, str] | None = None, kind: str = "csv", keep_copies: bool = False
) -> Recordings:
    """The recordings of a file or folder, with the channels (name -> column) of the mapping or those given."""
    read = read_mapping(MAPPINGS / f"{mapping}.toml")
    if channels is not None:
        read = replace(read, channels=tuple(Channel(column, name) for name, column in channels.items()))
    return read_source(EXTERNAL / source, kind, read, keep_copies=keep_copies).recordings
