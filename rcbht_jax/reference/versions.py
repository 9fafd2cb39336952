"""The versions of the original programs, by what they do differently."""

from __future__ import annotations

from dataclasses import dataclass

from rcbht_jax.errors import InputError


@dataclass(frozen=True)
class Version:
    """What one version of the original programs does differently from ``master``.

    Attributes:
        key: name of the version.
        gated: adjustment runs (7.1) are merged only when they end before the last state of the vector.
        amplitude_ends_pass: an amplitude ratio out of range ends passes 7.3 and 7.4, instead of skipping the row.
        time_as_row: when no row ends after the second state, the last time serves as start row (7.0).
        old_ending: the final partial window is tested like any other window, and the tail may be lost.
    """

    key: str
    gated: bool = False
    amplitude_ends_pass: bool = False
    time_as_row: bool = False
    old_ending: bool = False


VERSIONS = {
    version.key: version
    for version in (
        Version("master"),
        Version("a642c8b", gated=True),
        Version("a1ca1d1", gated=True, amplitude_ends_pass=True, time_as_row=True),
        Version("wip", amplitude_ends_pass=True, old_ending=True),
    )
}


def find_version(key: str) -> Version:
    """The version with this key.

    Raises:
        InputError: the version does not exist.
    """
    if key not in VERSIONS:
        raise InputError(f"Version {key!r} does not exist; expected one of {', '.join(VERSIONS)}.")
    return VERSIONS[key]
