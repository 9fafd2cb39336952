"""Tables of what is believed while a stream goes on, and how soon."""

from __future__ import annotations

from experiments.compared import result
from experiments.tables.cells import markdown


def online(way: str) -> str:
    """States streamed at 10 Hz."""
    rows = result("table2")["rows"]
    names = {"REAL": "REAL", "SIM1": "SIM one arm", "SIM2": "SIM two arms (right)"}
    kinds = {"all": "all features", "relative": "relative features"}
    lines = []
    for name, title in names.items():
        for kind, features in kinds.items():
            if found := rows[f"{name} at 10 Hz"].get(kind):
                means = [found[key]["mean"] for key in ("macro step accuracy", "full-sequence accuracy", "OverallPr")]
                own = min(found["certainty"]["k=0.70"]["m_own"])
                errors = " / ".join(f"{found[f'ECE {part}']['mean']:.3f}" for part in ("steps", "full sequences"))
                lines.append((f"{title}, {features}", *(f"{value:.3f}" for value in means), f"{own:.2f}", errors))
    head = ("step accuracy (mean of classes)", "full-sequence accuracy", "OverallPr", "smallest own-length m at .70")
    return markdown(("", *head, "calibration error, steps / full"), lines)


def latency(way: str) -> str:
    """How soon a stream is answered."""
    found = result("stream_speed")
    start, push = found["start"], found["latency"]
    rows = [
        ("start to first belief, nothing compiled yet", f"{start['cold']['wall, s']:.1f} s"),
        ("start to first belief, compiled programs kept", f"{start['warm cache']['wall, s']:.1f} s"),
        ("one window to belief, median", f"{push['median, ms']:.2f} ms"),
        ("one window to belief, 99 %", f"{push['p99, ms']:.2f} ms"),
    ]
    return markdown(("six axes, 2 CPU cores", "time"), rows)


TABLES = {
    "online": online,
    "latency": latency,
}
