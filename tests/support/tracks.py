"""Published words of label tracks, as tests compare them."""

from __future__ import annotations

import numpy as np

from rcbht_jax.types import LabelTrack, LabelTracks

FIELDS = ("label", "t0", "t1", "emit", "vmax", "vmin", "avg", "grad")


def published(track: LabelTrack, lane: tuple[int, ...]) -> list[tuple[float, ...]]:
    """The words of one lane, each as its FIELDS."""
    used = np.asarray(track.label)[lane] > 0
    return list(zip(*(np.asarray(getattr(track, name))[lane][used].tolist() for name in FIELDS), strict=True))


def layers(tracks: LabelTracks) -> tuple[LabelTrack, ...]:
    return tracks.primitive, tracks.mc, tracks.llb
