"""Facts about wrenches that learning needs besides labels, small enough to keep for a data set larger than memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8
from numpy.typing import NDArray

from rcbht_jax._util.digest import data_hash, wrench_digests
from rcbht_jax.types import Recordings


@dataclass(frozen=True)
class WrenchFacts:
    """Digests and beginnings of wrenches, of recordings in memory or read in batches.

    Attributes:
        data_hash: digest of the data set, which its models hold (:func:`rcbht_jax._util.digest.data_hash`).
        digests: SHA-256 of each recording's samples: equal ones are copies.
        opening: mean of the first second, or of all of a shorter recording, in the units of the axes.
    """

    data_hash: str
    digests: UInt8[np.ndarray, "recording byte"]
    opening: Float32[np.ndarray, "recording axis"]

    @staticmethod
    def of(recordings: Recordings, batches: Iterable[Recordings] | None = None, samples: int = 0) -> WrenchFacts:
        """Read all wrenches once.

        Args:
            recordings: the data set; where ``batches`` are given, its own wrenches do not matter.
            batches: all of its recordings in their order, where they are not in memory.
            samples: to which all are padded for the digest, where ``batches`` are given
                (:func:`rcbht_jax.io.store.longest_of`).

        Example:
            >>> whole = Recordings.example()
            >>> halves = [whole.take(range(4)), whole.take(range(4, 8))]
            >>> WrenchFacts.of(whole, halves, 300).data_hash == WrenchFacts.of(whole).data_hash
            True
        """
        digests: list[NDArray[np.uint8]] = []
        opening: list[NDArray[np.float32]] = []
        second = max(1, round(1 / recordings.dt))

        def seen(parts: Iterable[Recordings]) -> Iterator[NDArray[np.float32]]:
            for part in parts:
                digests.append(wrench_digests(part.wrench, part.length))
                ends = np.clip(part.length, 1, second).tolist()
                # Row by row: a mean over several recordings at once might add in another order.
                opening.extend(row[:end].mean(0) for row, end in zip(part.wrench, ends, strict=True))
                yield part.wrench

        if batches is None:
            batches, samples = [recordings], recordings.wrench.shape[1]
        found = data_hash(recordings, seen(batches), samples)
        return WrenchFacts(found, np.concatenate(digests), np.stack(opening))
