"""Checks of recordings before they are stored."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from rcbht_jax._util.untrusted import MAX_PADDED, MAX_RATIO, MAX_VALUES
from rcbht_jax._util.values import LARGEST, expect, usable
from rcbht_jax.errors import InputError
from rcbht_jax.types import Recordings

# Variable of the store, which is the field of Recordings -> dtype.
VARIABLES: dict[str, str] = {
    "wrench": "float32", "length": "int32", "trial": "string", "arm": "string", "source": "string",
    "session": "string", "outcome": "string", "note": "string",
}  # fmt: skip
SHORTEST, LONGEST = 1e-9, 1e6  # s between samples: beyond these it is another unit
NAME = re.compile(r"[^\W\d][\w.-]*")  # of a column
LONGEST_NAME = 200  # bytes of a column's name in UTF-8: it is that of a folder
RESERVED = ("zarr.json", "part_sha256")  # names of Zarr's and of the store's own files beside the columns


def validate(recordings: Recordings, gaps: bool = False) -> None:
    """Check that the fields of recordings agree with each other.

    Args:
        recordings: to be stored.
        gaps: allow recordings of length 0, which keep a place.

    Raises:
        InputError: there is no recording, a shape or dtype is wrong, a text is not valid Unicode, a length exceeds the
            array or is far from filling it, a sample is not finite within the length or not zero beyond it, or an
            annotation is about no recording.
    """
    expect("The data set", recordings, Recordings)
    wrench = np.asarray(recordings.wrench)
    if wrench.ndim != 3 or 0 in (wrench.shape[::2] if gaps else wrench.shape):
        raise InputError(f"wrench has shape {wrench.shape}; expected [recordings, samples, axes], none of them 0.")
    _check_shapes(recordings, len(wrench))
    if not SHORTEST <= recordings.dt <= LONGEST:
        raise InputError(f"dt is {recordings.dt}; expected {SHORTEST:g} to {LONGEST:g} s.")
    axes = (recordings.axes, recordings.units)
    if any(len(names) != wrench.shape[2] for names in axes) or len(set(recordings.axes)) < wrench.shape[2]:
        raise InputError(
            f"axes {axes[0]} have units {axes[1]}; expected {wrench.shape[2]} different names, with units."
        )
    check_padding(wrench.shape[1], int(recordings.length.max(initial=0)))
    for row, samples in enumerate(recordings.length):
        where = f"recording {row} ({recordings.trial[row]})"
        if not (0 if gaps else 1) <= samples <= wrench.shape[1]:
            raise InputError(f"{where}: length is {samples}; expected 1 to {wrench.shape[1]} samples.")
        if not usable(wrench[row, :samples]):
            raise InputError(
                f"{where}: the wrench is not finite everywhere, or beyond {LARGEST:g}; expected numbers whose sums are "
                "finite in single precision."
            )
        if wrench[row, samples:].any():
            raise InputError(f"{where}: the wrench beyond its length is not zero; expected zero padding.")
    recordings.annotations.check(len(recordings))


def check_padding(padded: int, longest: int) -> None:
    """Raise an error for recordings padded to far more samples than the longest has: a store only declares padding.

    Raises:
        InputError: there are too many padded samples.
    """
    most = min(MAX_VALUES, max(MAX_PADDED, MAX_RATIO * longest))
    if padded > most:
        raise InputError(
            f"the wrench has {padded} samples, and the longest recording {longest}; expected at most {most}. Cut what "
            "lies beyond."
        )


def check_text(what: str, texts: Iterable[str]) -> None:
    """Raise an error for a text of a recording that cannot be written as UTF-8; ``what`` names the column."""
    for row, text in enumerate(texts):
        try:
            text.encode()
        except UnicodeEncodeError:
            raise InputError(f"{what} of recording {row} is {text!r}, which is not valid Unicode; rename it.") from None


def _check_shapes(recordings: Recordings, count: int) -> None:
    for name, dtype in VARIABLES.items():
        array = np.asarray(getattr(recordings, name))
        shape = recordings.wrench.shape if name == "wrench" else (count,)
        matches = array.dtype.kind == "U" if dtype == "string" else array.dtype == dtype
        if array.shape != shape or not matches:
            raise InputError(f"{name} is {array.dtype} of shape {array.shape}; expected {dtype} of shape {shape}.")
        if dtype == "string":
            check_text(name, array.tolist())
    for name, values in recordings.columns.items():
        kind = np.asarray(values).dtype
        if np.shape(values) != (count,) or kind.kind not in "Ubiuf" or (kind.kind == "f" and kind.itemsize > 8):
            raise InputError(
                f"column {name} is {values.dtype} of shape {values.shape}; expected text or numbers of at most "
                f"64 bits [{count}]."
            )
        if not NAME.fullmatch(name) or name in VARIABLES:
            raise InputError(f"{name!r} is not a name for a column; expected letters, digits and _ - . only.")
        if len(name.encode()) > LONGEST_NAME or name in RESERVED:
            raise InputError(
                f"{name[:40]!r} is not a name for a column; expected at most {LONGEST_NAME} bytes, and not "
                f"{' or '.join(RESERVED)}."
            )
        if np.asarray(values).dtype.kind == "U":
            check_text(f"column {name}", values.tolist())
