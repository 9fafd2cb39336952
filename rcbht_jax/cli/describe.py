"""``rcbht describe``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from rcbht_jax.cli.command import Command, OneArm, SourcePrefix, Store, Trial, option
from rcbht_jax.cli.readers import SnapSize, detector_of


@dataclass(frozen=True)
class Describe(Command):
    """Describe a trial in sentences: which axes rise, fall or ring, when, by how much and how fast, and what snaps.

    The store needs no labels: the lines of the fit rule are computed here. A rise or fall is given in full; its
    duration is the time from a tenth to nine tenths of it, and its sentence begins at the tenth.

    Without --snap, a snap is a force that falls within 40 ms by at least the smallest reported change of the force that
    changes most; at 12.5 samples per second or less, none can be seen. Its size is how far the force had fallen along
    the words that published it, which may be half of the fall; the sentence of the fall has all of it. Use "rcbht
    import --tare": a constant offset counts as a load, and a brief contact can look like its release. A size larger
    than the load is marked as such.

    Example: rcbht describe hiro.zarr 20121127-HIROSA-S-05
    """

    store: Store
    """Store of recordings; label tracks are not needed."""
    trial: Trial
    arm: OneArm = None
    source: SourcePrefix = ""
    task: Annotated[str, option("Track of annotations to name.", "the first, or its corrected variant")] = ""
    snap: SnapSize = ()
    least: Annotated[
        float,
        option(
            "Smallest change to report, as a share of the usual range of its axis; changes as small as its noise are "
            "never reported."
        ),
    ] = 0.2

    def run(self) -> dict[str, Any]:
        from rcbht_jax.cli.plot import find_recording
        from rcbht_jax.introspection.description import describe_recording
        from rcbht_jax.io.store import read_recordings

        recordings = read_recordings(self.store)
        index = find_recording(recordings, self.trial, self.arm, self.source)
        snaps = detector_of(self.snap, 1 / recordings.dt)
        sentences = describe_recording(recordings, index, self.least, self.task, snaps)
        return {"trial": self.trial, "sentences": [{"seconds": seconds, "text": text} for seconds, text in sentences]}

    def text(self, result: dict[str, Any]) -> str:
        rows = result["sentences"]
        if not rows:
            return f"{result['trial']}: nothing changes."
        return "\n".join(f"{row['seconds']:7.2f} s  {row['text']}" for row in rows)
