"""Speeds as ratios to a reference measured in the same run, their history in a JSON file, and what has fallen.

Seconds differ from machine to machine and from hour to hour; a ratio of two programs that take turns differs less, and
hardly on one machine.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax._util.untrusted import load_json
from rcbht_jax.errors import InputError

FALL = 0.2  # of a ratio, that is no noise
SIZES = ("device", "trials", "samples")  # what every record has
SAME = ("processor", *SIZES)  # what two records that are compared have in common


class Timing(NamedTuple):
    """Median wall times, s, and how often the first fits into the second."""

    seconds: float
    reference_seconds: float
    ratio: float  # median over the rounds; > 1 = faster than the reference


def interleaved(run: Callable[[], Any], reference: Callable[[], Any], repeats: int = 7) -> Timing:
    """Time two calls in turns, after one of each that compiles.

    Both must have finished when they return (``jax.block_until_ready``).

    >>> found = interleaved(lambda: sum(range(1000)), lambda: sum(range(1000)), repeats=3)
    >>> found.ratio > 0
    True
    """
    times = turns([run, reference], repeats)
    ours, theirs = np.median(times, axis=0).tolist()
    return Timing(ours, theirs, float(np.median(times[:, 1] / times[:, 0])))


def turns(calls: Sequence[Callable[[], Any]], repeats: int) -> NDArray[np.float64]:
    """Wall times ``[round, call]``, s, of calls that take turns, after one of each that compiles.

    >>> turns([lambda: sum(range(1000))], repeats=3).shape
    (3, 1)
    """
    for call in calls:
        call()
    times = np.zeros((repeats, len(calls)))
    for row in times:
        for number, call in enumerate(calls):
            start = time.perf_counter()
            call()
            row[number] = time.perf_counter() - start
    return times


def read_history(path: Path) -> list[dict[str, Any]]:
    """Records of earlier runs, the newest last.

    Raises:
        InputError: the file is missing, or is not such a history.
    """
    try:
        records = load_json(path)
        if not all(isinstance(record["ratios"], dict) and set(SIZES) <= set(record) for record in records):
            raise ValueError(f"a record lacks its ratios or one of {', '.join(SIZES)}")
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); make it with --history {path}.") from error
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f'{path} is not a history of "rcbht bench" ({error}).') from error
    return list(records)


def append_record(path: Path, record: Mapping[str, Any]) -> None:
    """Add a record to a history, which is made if there is none.

    Raises:
        InputError: the file is not such a history.
    """
    records = [*(read_history(path) if path.exists() else []), record]
    with atomic_write(path) as draft:
        draft.write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")


def latest(records: list[dict[str, Any]], like: Mapping[str, Any]) -> dict[str, Any] | None:
    """The newest record of the same device, processor and sizes, as far as ``like`` has them; None = there is none."""
    return next(
        (old for old in reversed(records) if all(old.get(key) == like[key] for key in SAME if key in like)), None
    )


def cpu_model(info: Path = Path("/proc/cpuinfo")) -> str:
    """Model and number of cores of this machine's processor.

    >>> cpu_model(Path("no such file")).endswith("cores")
    True
    """
    with suppress(OSError):
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return f"{line.partition(':')[2].strip()}, {os.cpu_count()} cores"
    return f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores"


def fallen(ratios: Mapping[str, float], earlier: Mapping[str, float]) -> list[str]:
    """A sentence for each ratio that is more than 20 % below an earlier one, or is no longer measured.

    >>> fallen({"encode": 0.7, "step": 0.9}, {"encode": 1.0, "step": 1.0})
    ['The ratio encode is 0.7, 30 % below the earlier 1.']
    """
    sentences = [f"The ratio {name} is no longer measured." for name in earlier if name not in ratios]
    for name, ratio in ratios.items():
        if name in earlier and ratio < (1 - FALL) * earlier[name]:
            below = 1 - ratio / earlier[name]
            sentences.append(f"The ratio {name} is {ratio:.3g}, {below:.0%} below the earlier {earlier[name]:.3g}.")
    return [sentence.replace("%", " %") for sentence in sentences]
