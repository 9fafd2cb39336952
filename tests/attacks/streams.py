"""Hostile streams of lines: nothing raises, nothing that is not finite comes out, and every line is accounted for."""

from __future__ import annotations

import io
import json
import random
from collections import Counter

import numpy as np

from rcbht_jax.introspection.resampling import LARGEST, Resampler
from rcbht_jax.io.messages import Begin, Malformed, Reset, Sample, read_lines
from tests.attacks.mutations import VALUES, damaged, damaged_json, damaged_text

DT = 0.005
MOST = 100_000  # samples that a stream of a few hundred lines may become: gaps are bridged for a short time only


def lines(rng: random.Random) -> bytes:
    """A stream of JSON lines whose clock, values, form and bytes are hostile."""
    time, made = rng.choice((0.0, 1.7e9, -5.0, 1e18)), list[bytes]()
    for k in range(rng.randrange(1, 80)):
        time += rng.choice((DT, DT, DT, DT, 0.0, -DT, 3 * DT, 0.4, -2.0, 3600.0, 1e-9))
        message: object = {"wrench": [rng.gauss(0, 5) for _ in range(6)], "time": time}
        if rng.random() < 0.1:
            message = rng.choice(({"begin": True}, {"reset": True}, {"begin": True, "wrench": [0.0] * 6}))
        if rng.random() < 0.2:
            message = damaged_json(rng, message)
        if rng.random() < 0.05:
            message = {"wrench": [rng.choice(VALUES) for _ in range(6)], "time": rng.choice(VALUES)}
        line = json.dumps(message).encode()
        if rng.random() < 0.1:
            line = rng.choice((damaged, damaged_text))(rng, line)
        made.append(line * (1 if k or rng.random() < 0.9 else 2000))
    return b"\n".join(made)


def attack(seed: str) -> str:
    """Read one hostile stream; "" or what is wrong."""
    raw = lines(random.Random(seed))
    resampler, total, counts = Resampler(DT), 0, Counter[str]()
    for message in read_lines(io.BytesIO(raw)):
        counts[type(message).__name__] += 1
        if isinstance(message, Malformed) and not message.text:
            return "a malformed line has no reason"
        if isinstance(message, Reset):
            resampler.finish()
            resampler = Resampler(DT)
        if not isinstance(message, Sample) or len(message.wrench) != 6:
            continue
        found = resampler.feed(message)
        total += len(found.samples)
        if not np.isfinite(found.samples).all() or not np.isfinite(found.time):
            return "a sample is not finite"
        if np.abs(found.samples).max(initial=0) > LARGEST:
            return "a sample is absurd"
        used = len(found.samples) or np.isfinite(message.wrench).all()
        if not used and not found.reports:
            return "a reading was left out without a report"
    if total > MOST:
        return f"{total} samples came of {len(raw)} bytes"
    said = sum(counts.values())
    expected = sum(bool(line.strip()) for line in raw.split(b"\n"))
    known = counts.keys() <= {kind.__name__ for kind in (Begin, Malformed, Reset, Sample)}
    return "" if known and said >= expected else f"{expected} lines gave {said} messages"
