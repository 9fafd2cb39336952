"""What is said of the readings of a source."""

from __future__ import annotations

from rcbht_jax.introspection.resampling import Resampler
from rcbht_jax.io.messages import Sample


def test_a_source_too_slow_for_every_gap_is_told_what_helps() -> None:
    def said(bridge: float | None) -> list[str]:
        resampler = Resampler(0.005, bridge, 1)
        found = [resampler.feed(Sample((1.0,), time)) for time in (0.0, 0.005, 0.105, 0.205)]
        return [report.text for one in found for report in one.reports]

    first, second = said(None)
    assert first == "no reading for 0.100 s; everything starts anew"  # a gap of a source that is fast enough
    assert second == first + "; a source that is always so slow needs a longer --max-gap"
    assert not any("anew" in text for text in said(0.2))
