"""Tables of streams: states, detected onsets, success or failure, faults, kinds of failure, and latency."""

from __future__ import annotations

from typing import Any

from experiments.tables.cells import NONE, Lines, score, table

Result = dict[str, Any]
FALSE = "false alarms per nominal trial"


@table("online", "table2")
def online(result: Result) -> Lines:
    """States streamed at 10 Hz."""
    rows = result["rows"]
    names = {"REAL": "REAL", "SIM1": "SIM one arm", "SIM2": "SIM two arms (right)"}
    kinds = {"all": "all features", "relative": "relative features"}
    head = ("step accuracy (mean of classes)", "full-sequence accuracy", "OverallPr", "smallest m, own length, k=0.70")
    yield ("", *head, "calibration error, steps", "of full sequences")
    for name, title in names.items():
        for kind, features in kinds.items():
            if scores := rows[f"{name} at 10 Hz"].get(kind):
                keys = ("macro step accuracy", "full-sequence accuracy", "OverallPr", "ECE steps", "ECE full sequences")
                own = min(scores["certainty"]["k=0.70"]["m_own"])
                *right, steps, full = (score(scores[key]) for key in keys)
                yield (f"{title}, {features}", *right, f"{own:.2f}", steps, full)


@table("latency", "stream_speed")
def latency(result: Result) -> Lines:
    """Time from the start, and from a window, to a belief."""
    start, push = result["start"], result["latency"]
    yield "six axes, 2 CPU cores", "time"
    yield "start to first belief, empty compilation cache", f"{start['cold']['wall, s']:.1f} s"
    yield "start to first belief, warm compilation cache", f"{start['warm cache']['wall, s']:.1f} s"
    yield "one window to belief, median", f"{push['median, ms']:.2f} ms"
    yield "one window to belief, 99 %", f"{push['p99, ms']:.2f} ms"


WARNED = ("with contact", "at the boundary of success")


@table("faults", "faults_online")
def faults(result: Result) -> Lines:
    """Simulated faults detected in time, by session."""
    presets = result["presets"]
    yield ("detected before the failing sub-task ends", *presets)
    for kind in next(iter(presets.values()))["kinds"]:
        for part, title in zip(WARNED, (kind.replace("-", " "), "those at the boundary of success"), strict=True):
            cells = [preset["kinds"][kind][part] for preset in presets.values()]
            if kind != "missing-tab" or part == WARNED[0]:
                yield (title, *map(_counted, cells))
    yield (FALSE, *(_false(preset) for preset in presets.values()))


@table("faults-apart", "faults_online")
def faults_apart(result: Result) -> Lines:
    """Cases outside the table of faults: those without contact, and early stops by the words alone."""
    presets = result["presets"]
    yield ("", *presets)
    for kind in ("wedging", "moved-part", "early-stop"):
        cells = [preset["kinds"][kind]["without contact"] for preset in presets.values()]
        yield (f"{kind.replace('-', ' ')} without contact", *map(_counted, cells))
    stops = [preset["kinds"]["early-stop"]["with contact"] for preset in presets.values()]
    for title, name in (("by the words", "by the words"), ("before the clock", "by the words, before the clock")):
        counts = (f"{cell[name]} of {cell['failures streamed']}" for cell in stops)
        yield (f"early stop with contact, {title}", *counts)
    for kind in ("jamming", "wedging", "moved-part", "early-stop"):
        cells = [preset["kinds"][kind]["with contact"] for preset in presets.values()]
        counts = (f"{cell['of them alarmed']} of {cell['seated all the same']}" for cell in cells)
        yield (f"{kind.replace('-', ' ')}, parts seated, alarms", *counts)


@table("faults-across", "faults_across")
def faults_across(result: Result) -> Lines:
    """Simulated faults detected by monitors trained on others, by session."""
    yield ("session", "fault", *(TRAINED[way] for way in next(iter(result["presets"].values()))))
    for session, ways in result["presets"].items():
        for kind in ways["own"]["kinds"]:
            cells = [_counted(row["kinds"][kind]) for row in ways.values()]
            yield (session, kind.replace("-", " "), *cells)
        yield (session, FALSE, *(_false(_most(row)) for row in ways.values()))


# Ways of training in faults_across.json -> their column titles.
TRAINED = {
    "own": "same session", "kind never seen": "same session, without this kind",
    "others, own calm": "others' faults, own nominal trials", "others": "other sessions",
}  # fmt: skip


def _most(row: dict[str, Any]) -> dict[str, Any]:
    """False alarms of a way of training; of monitors that each lack a kind, those of the one with most."""
    if FALSE in row:
        return row
    return max(row["kinds"].values(), key=lambda kind: kind[FALSE]["mean"])


def _counted(cell: dict[str, Any]) -> str:
    if not cell["failures streamed"]:
        return NONE
    return f"{score(cell['share detected'])}; {cell['detected']} of {cell['failures streamed']}"


def _false(preset: dict[str, Any]) -> str:
    alarms, trials = sum(preset["false alarms in each repeat"]), sum(preset["nominal trials streamed in each repeat"])
    return f"{score(preset[FALSE])}; {alarms} of {trials}"


@table("detected", "detected_starts")
def detected(result: Result) -> Lines:
    """Step accuracy with given and with detected onsets."""
    rows = result["rows"]
    ways = {
        "onsets given (harmonised)": "given",
        'onsets detected by the classifier "phase"': "detected",
        "the detected state itself": "filter alone",
        'the belief of the classifier "phase" itself': "phase alone",
    }
    yield "step accuracy (mean of classes)", "real trials", "SIM one arm"
    for title, key in ways.items():
        yield (
            title,
            *(score(rows[name][f"macro step accuracy, {key}"]) for name in ("REAL | paper", "SIM1 | paper")),
        )


@table("abnormal", "abnormal_real")
def abnormal(result: Result) -> Lines:
    """Success or failure of real trials."""
    names = {
        "mixed": "all sessions mixed",
        "held out": "successes of a session not trained on",
        "sessions": "control: success in A or success in B",
    }
    head = ("every tenth of a second", "after 1 s, before any contact", "at the end", "false alarms, % of successes")
    yield ("mean recall", *head)
    for name, title in names.items():
        for kind, addition in (("all features", ""), ("time alone", ": elapsed time alone")):
            scores = result["rows"][name][kind]
            moments = (score(scores[key]) for key in ("every tenth of a second", "after 1 s", "at 100%"))
            # Two sessions of successes contain no failure to raise an alarm about.
            alarms = "" if name == "sessions" else f"{scores['successes alarmed']['mean']:.0%}"
            yield (title + addition, *moments, alarms)


@table("failure-types", "failure_types_online")
def failure_types(result: Result) -> Lines:
    """Failure types of the authors' simulation from the stream."""
    parts = ("half of the record", "three quarters", "all of it", "all of it, pairwise votes")
    yield ("accuracy", *parts, "calibration error, steps")
    keys = ("at 50%", "at 75%", "at 100%", "at 100%, votes of pairs", "calibration error of steps")
    for name, row in result["rows"].items():
        yield (name, *(score(row[key]) for key in keys))
    yield ("the most frequent class", *[f"{result['most frequent class']:.3f}"] * 4, "")
