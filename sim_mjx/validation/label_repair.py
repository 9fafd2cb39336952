"""Label tracks of a store encoded again, as they were made, from its wrenches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.rules import encoder_of
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.label_store import copy_tracks, list_tracks, own_attrs, replace_batches, verify_tracks
from rcbht_jax.io.store_schema import HASH, LABELS
from rcbht_jax.reference.dataset import encode_dataset
from rcbht_jax.types import LabelTracks, Recordings
from sim_mjx.synthesis.draft import CREATED
from sim_mjx.synthesis.plan import SynthesisConfig, label_attrs


def made_how(path: Path, name: str) -> dict[str, Any] | None:
    """The attributes of damaged label tracks, if they say how to make them again and by which checksum to know them."""
    try:
        attrs = own_attrs(path, name)  # the checksum of labels of other recordings is of no use
        _encoder(attrs)
    except (InputError, KeyError, TypeError, ValueError):
        return None
    return attrs if {HASH, "rows", "part_rows", "created"} <= set(attrs) else None


def simulated_how(path: Path, job: SynthesisConfig) -> dict[str, Any] | None:
    """The attributes of the label tracks that a simulation makes, for a store that lacks them."""
    attrs = store.read_attrs(path)
    if not {"rows", "part_rows"} <= set(attrs):
        return None
    return {**label_attrs(job), "rows": attrs["rows"], "part_rows": attrs["part_rows"], "created": CREATED}


def encode_again(path: Path, name: str, attrs: dict[str, Any], progress: Callable[[int], object]) -> None:
    """Encode the recordings of a store again and put the labels in the place of damaged or missing ones.

    Args:
        path: of the store.
        name: of the label tracks.
        attrs: how they were made: of :func:`made_how` or :func:`simulated_how`.
        progress: called with the number of samples done since the last call.

    Raises:
        InputError: the installed versions make other labels than those whose checksum is kept.
    """
    encode = _encoder(attrs)

    def tracks() -> Iterator[LabelTracks]:
        for part in store.read_batches(path):
            yield encode(part)
            progress(int(part.length.sum()))

    replace_batches(path, name, tracks(), attrs)


def keep_tracks(path: Path, again: Path) -> None:
    """Copy the label tracks of a damaged store to its recordings that were simulated again.

    Damaged ones are copied too, unless the simulation has made them again.

    Args:
        path: of the damaged store.
        again: its recordings, simulated again.

    Raises:
        InputError: the recordings have come out otherwise, so that the label tracks would be lost.
    """
    names, made = list_tracks(path), list_tracks(again)
    if store.read_attrs(path)[HASH] == store.read_attrs(again)[HASH]:
        for name in names:
            if name not in made or _is_whole(path, name):
                copy_tracks(path, again, name)
    elif lost := [name for name in names if name not in made]:
        raise InputError(
            f"{path} is left as it is: its recordings come out otherwise when they are simulated again, and label "
            f"tracks {', '.join(lost)} would be lost; move these out of {path / LABELS} to have it made without them."
        )


def _is_whole(path: Path, name: str) -> bool:
    try:
        verify_tracks(path, name)
    except InputError:
        return False
    return True


def _encoder(attrs: dict[str, Any]) -> Callable[[Recordings], LabelTracks]:
    """What made labels of these attributes."""
    if attrs["semantics"] == "offline":
        return partial(encode_dataset, **attrs["config"])
    config, limits = encoder_of(attrs)
    return lambda part: encode_batch(config, limits, part.wrench, part.length)
