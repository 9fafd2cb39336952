"""Tables of what is believed while a stream goes on, and how soon."""

from __future__ import annotations

from typing import Any

from experiments._lib.peer_rows import result
from experiments.tables.cells import NONE, markdown, score


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


WARNED = ("with contact", "at the boundary of success")


def faults(way: str) -> str:
    """Simulated faults noticed in time, by session."""
    presets = result("faults_online")["presets"]
    lines = []
    for kind in next(iter(presets.values()))["kinds"]:
        for part, title in zip(WARNED, (kind.replace("-", " "), "those at the boundary of success"), strict=True):
            cells = [found["kinds"][kind][part] for found in presets.values()]
            if kind != "missing-tab" or part == WARNED[0]:
                lines.append((title, *(_counted(cell) for cell in cells)))
    lines.append(("false alarms per nominal trial", *(_false(found) for found in presets.values())))
    return markdown(("noticed before the failing sub-task ends", *presets), lines)


def faults_apart(way: str) -> str:
    """What the first table leaves out: faults without contact, and early stops by the words alone."""
    presets = result("faults_online")["presets"]
    lines = []
    for kind in ("wedging", "moved-part", "early-stop"):
        cells = [found["kinds"][kind]["without contact"] for found in presets.values()]
        lines.append((f"{kind.replace('-', ' ')} without contact", *(_counted(cell) for cell in cells)))
    stops = [found["kinds"]["early-stop"]["with contact"] for found in presets.values()]
    for title, name in (("by the words", "by the words"), ("before the clock", "by the words, before the clock")):
        said = (f"{cell[name]} of {cell['failures streamed']}" for cell in stops)
        lines.append((f"early stop with contact, {title}", *said))
    for kind in ("jamming", "wedging", "moved-part", "early-stop"):
        cells = [found["kinds"][kind]["with contact"] for found in presets.values()]
        said = (f"{cell['of them alarmed']} of {cell['seated all the same']}" for cell in cells)
        lines.append((f"{kind.replace('-', ' ')} that seats all the same, alarmed", *said))
    return markdown(("", *presets), lines)


def faults_across(way: str) -> str:
    """Simulated faults noticed by monitors that saw others; a cell has a share per session."""
    presets = result("faults_across")["presets"]
    ways = next(iter(presets.values()))
    lines = []
    for kind in ways["own"]["kinds"]:
        cells = [[found[one]["kinds"][kind]["share detected"] for found in presets.values()] for one in ways]
        lines.append((kind.replace("-", " "), *(_means(row) for row in cells)))
    calm = [
        [found[one].get("false alarms per nominal trial") or _worst(found[one]) for found in presets.values()]
        for one in ways
    ]
    lines.append(("false alarms per nominal trial", *(_means(row) for row in calm)))
    return markdown((f"sessions {', '.join(presets)}", *ways), lines)


def _worst(found: dict[str, Any]) -> dict[str, float]:
    """Most false alarms of the monitors that each lack a kind."""
    shares = [kind["false alarms per nominal trial"] for kind in found["kinds"].values()]
    return max(shares, key=lambda share: share["mean"])


def _means(shares: list[dict[str, float] | None]) -> str:
    return ", ".join(NONE if share is None else f"{share['mean']:.3f}" for share in shares)


def _counted(cell: dict[str, Any]) -> str:
    if not cell["failures streamed"]:
        return NONE
    return f"{score(cell['share detected'])}; {cell['detected']} of {cell['failures streamed']}"


def _false(found: dict[str, Any]) -> str:
    alarms, trials = (found[name] for name in ("false alarms in each repeat", "nominal trials streamed in each repeat"))
    return f"{score(found['false alarms per nominal trial'])}; {sum(alarms)} of {sum(trials)}"


TABLES = {
    "online": online,
    "faults": faults,
    "faults-apart": faults_apart,
    "faults-across": faults_across,
    "latency": latency,
}
