"""Tables of beliefs about trials as a whole: beginnings that nobody tells, success or failure, kinds of failure."""

from __future__ import annotations

from experiments._lib.peer_rows import result
from experiments.tables.cells import markdown


def detected(way: str) -> str:
    """Who says when a sub-task begins."""
    rows = result("detected_starts")["rows"]
    ways = {
        "beginnings given (harmonised)": "given",
        'beginnings noticed by the head "phase"': "noticed",
        "the state that was noticed, itself": "filter alone",
        'the head "phase" itself': "phase alone",
    }
    lines = [
        (said, *(f"{rows[name][f'macro step accuracy, {key}']['mean']:.3f}" for name in ("REAL", "SIM1")))
        for said, key in ways.items()
    ]
    return markdown(("step accuracy (mean of classes)", "real trials", "SIM one arm"), lines)


def abnormal(way: str) -> str:
    """Success or failure of real trials."""
    rows = result("abnormal_real")["rows"]
    names = {
        "mixed": "all sessions mixed",
        "held out": "successes of a session that was not trained on",
        "sessions": "the same machine tells A from B, both successes",
    }
    moments = {
        "every tenth of a second": ".3f",
        "after 1 s": ".3f",
        "at 100%": ".3f",
        "successes alarmed": ".0%",
    }
    lines = []
    for name, title in names.items():
        found = rows[name]["all features"]
        # Between two sessions of successes there is nothing to raise an alarm about.
        told = {key: "" if (name, key) == ("sessions", "successes alarmed") else form for key, form in moments.items()}
        cells = (format(found[key]["mean"], form) if form else "" for key, form in told.items())
        lines.append((title, *cells))
    head = ("every tenth of a second", "after 1 s, before any contact", "at the end", "successes that raise the alarm")
    return markdown(("mean recall", *head), lines)


def failure_types(way: str) -> str:
    """Failure types of the authors' simulation from the stream."""
    found = result("failure_types_online")
    lines = [
        (
            name,
            *(f"{row[key]['mean']:.3f}" for key in ("at 50%", "at 75%", "at 100%", "at 100%, votes of pairs")),
            f"{row['calibration error of steps']['mean']:.3f}",
        )
        for name, row in found["rows"].items()
    ]
    lines.append(("the most frequent class", *[f"{found['most frequent class']:.3f}"] * 4, ""))
    head = ("half of the record", "three quarters", "all of it", "all of it, most votes", "calibration error, steps")
    return markdown(("accuracy", *head), lines)


TABLES = {"detected": detected, "abnormal": abnormal, "failure-types": failure_types}
