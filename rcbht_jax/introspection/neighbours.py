"""Distances of a moment to nominal recordings at about the same time, channel by channel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy.typing import NDArray

LEAST_SCALE = 0.05  # of the standard deviation of a feature over all nominal moments
LEAST_REFERENCE = 0.5  # of the median nominal distance of a channel
AROUND = 5  # moments before and after over which the usual distance is taken
FEWEST_GROUPS = 3  # from which on differences between groups are known
FARTHEST = 1e18  # of a scaled feature: single precision holds the squares
READ = (3, 0, 2, 1)  # order in memory of a bank's axes: distances are quick along the recordings
OFFSET = 0.5  # of the differences within groups: a larger one between groups is a bias


@dataclass(frozen=True)
class Bank:
    """Features of nominal recordings, and the usual distances between them.

    Padding: a recording that has ended stays as it ended; times before the beginning are infinite.
    """

    described: Float32[np.ndarray, "_ recording channel kind"]  # [reach + moment + reach, ...], in units of the scale
    scale: Float[np.ndarray, "channel kind"]  # of each feature
    reference: Float[np.ndarray, "moment channel"]  # usual distance of a held-out nominal recording
    reach: int  # longest time, in moments, by which a neighbour may be early or late
    slack: float  # moments
    drift: float  # share of the elapsed time
    neighbours: int

    def take(self, recordings: Int[np.ndarray, " some"]) -> Bank:
        """Some of the recordings, with the scales and usual distances of all."""
        kept = np.ascontiguousarray(np.transpose(self.described, READ)[..., recordings])
        return replace(self, described=np.transpose(kept, np.argsort(READ)))


def make_bank(
    described: list[Float[np.ndarray, "_ channel kind"]],
    groups: Int[np.ndarray, " recording"],
    slack: float,
    drift: float,
    neighbours: int,
) -> Bank:
    """The bank of nominal recordings that a monitor compares with.

    Args:
        described: two or more nominal recordings ``[time, channel, kind]``.
        groups: of each; a feature is scaled by its differences between groups. A single group = one per recording.
        slack: moments by which a neighbour may be early or late.
        drift: the same, as a share of the elapsed time.
        neighbours: nearest recordings whose distance is averaged.
    """
    groups = groups if len(np.unique(groups)) > 1 else np.arange(len(described))
    held = of_one_length(described)
    time = held.shape[1]
    squares = [
        np.mean((held[groups == name] - np.median(held[groups != name], 0)) ** 2, (0, 1)) for name in np.unique(groups)
    ]
    spread = held.std((0, 1))
    scale = np.maximum(np.sqrt(np.mean(squares, 0)), LEAST_SCALE * spread)
    scale = np.where(scale > 0, scale, 1.0)  # a feature that never changes
    reach = int(np.ceil(slack + drift * time))
    scaled = np.moveaxis(held / scale, 0, 1)
    edges = np.full_like(scaled[:1], np.inf), scaled[-1:]
    padded = np.concatenate([edges[0].repeat(reach, 0), scaled, edges[1].repeat(reach, 0)]).astype(np.float32)
    padded = np.transpose(np.ascontiguousarray(np.transpose(padded, READ)), np.argsort(READ))
    bank = Bank(padded, scale, np.ones((time, held.shape[2])), reach, slack, drift, neighbours)
    return replace(bank, reference=_reference(bank, described, groups))


def unbiased(parts: list[Float[np.ndarray, "_ axis"]], groups: Int[np.ndarray, " recording"]) -> tuple[int, ...]:
    """Axes that have the same zero in all groups; none if there are fewer than three groups of several recordings.

    The offset of a group is the mean over time of its median recording minus that of the others. It must be smaller, in
    the root mean square over groups, than half of what recordings differ from the median one of their own group.

    Args:
        parts: nominal recordings ``[time, axis]``.
        groups: of each.

    Example:
        >>> days, rng = np.repeat(np.arange(3), 4), np.random.default_rng(0)
        >>> parts = [rng.normal([0.0, 5.0 * day], 1.0, (20, 2)) for day in days]
        >>> unbiased(parts, days)
        (0,)
    """
    names, counts = np.unique(groups, return_counts=True)
    if (counts > 1).sum() < FEWEST_GROUPS:
        return ()
    held = of_one_length(parts)
    medians = np.stack([np.median(held[groups == name], 0) for name in names])
    others = np.stack([np.median(held[groups != name], 0) for name in names])
    offset = np.sqrt(((medians - others).mean(1) ** 2).mean(0))
    several = np.isin(groups, names[counts > 1])
    within = held[several] - medians[np.searchsorted(names, groups[several])]
    return tuple(np.flatnonzero(offset < OFFSET * np.sqrt((within**2).mean((0, 1)))).tolist())


def of_one_length(parts: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Recordings ``[recording, time, ...]`` of one length: those that have ended stay as they ended."""
    time = np.arange(max(len(part) for part in parts))
    return np.stack([part[np.minimum(time, len(part) - 1)] for part in parts])


def distances(
    bank: Bank, described: Float[np.ndarray, "time channel kind"], time: Int[np.ndarray, " time"]
) -> Float32[np.ndarray, "time recording channel"]:
    """Distance to the nearest moment of each nominal recording, root mean square over the kinds of features.

    Args:
        bank: the nominal recordings.
        described: moments of a recording, not scaled.
        time: of each, in moments since the beginning.
    """
    near = np.clip(described / bank.scale, -FARTHEST, FARTHEST)
    scaled = np.moveaxis(near.astype(np.float32), 2, 0)[..., None]  # [kind, time, channel, 1]
    kinds = np.transpose(bank.described, READ)
    now = np.minimum(time, len(bank.reference) - 1) + bank.reach
    allowed = np.minimum(bank.slack + bank.drift * time, bank.reach)
    least, square, difference = np.full((3, len(time), *kinds.shape[2:]), np.inf, np.float32)
    for offset in range(-bank.reach, bank.reach + 1):
        rows = np.s_[np.searchsorted(allowed, abs(offset)) :]  # times rise, and with them what is allowed
        square[rows] = 0
        for known, wanted in zip(kinds, scaled, strict=True):  # the sum does not depend on how many moments there are
            np.take(known, now[rows] + offset, 0, out=difference[rows], mode="clip")
            difference[rows] -= wanted[rows]
            difference[rows] *= difference[rows]
            square[rows] += difference[rows]
        np.minimum(least[rows], square[rows], out=least[rows])
    return np.moveaxis(np.sqrt(least / np.float32(len(kinds))), 1, 2)


def nearest(
    distance: Float32[np.ndarray, "time recording channel"], neighbours: int
) -> Float[np.ndarray, "time channel"]:
    """Mean of the smallest distances over the recordings, as many as there are if there are fewer."""
    count = min(neighbours, distance.shape[1])
    return np.sort(distance, 1)[:, :count].mean(1, dtype=np.float64)


def _reference(
    bank: Bank, described: list[NDArray[np.float64]], groups: NDArray[np.int64]
) -> Float[np.ndarray, "moment channel"]:
    """Median distance of nominal recordings to those of other groups, around each time."""
    time = len(bank.reference)
    usual = np.full((len(described), time, bank.reference.shape[1]), np.nan)
    for row, part in enumerate(described):
        others = distances(bank, part, np.arange(len(part)))[:, groups != groups[row]]
        usual[row, : len(part)] = nearest(others, bank.neighbours)
    at_times = [np.nanmedian(usual[:, max(moment - AROUND, 0) : moment + AROUND + 1], (0, 1)) for moment in range(time)]
    least = LEAST_REFERENCE * np.nanmedian(usual, (0, 1))
    return np.maximum(np.stack(at_times), np.where(least > 0, least, 1.0))
