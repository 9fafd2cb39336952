"""Tables of streamed beliefs about whole trials: detected onsets, success or failure, kinds of failure."""

from __future__ import annotations

from typing import Any

from experiments.tables.cells import Lines, streamed_score, table


@table("detected", "detected_starts")
def detected(result: dict[str, Any]) -> Lines:
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
            *(streamed_score(rows[name][f"macro step accuracy, {key}"]) for name in ("REAL | paper", "SIM1 | paper")),
        )


@table("abnormal", "abnormal_real")
def abnormal(result: dict[str, Any]) -> Lines:
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
            moments = (streamed_score(scores[key]) for key in ("every tenth of a second", "after 1 s", "at 100%"))
            # Two sessions of successes contain no failure to raise an alarm about.
            alarms = "" if name == "sessions" else f"{scores['successes alarmed']['mean']:.0%}"
            yield (title + addition, *moments, alarms)


@table("failure-types", "failure_types_online")
def failure_types(result: dict[str, Any]) -> Lines:
    """Failure types of the authors' simulation from the stream."""
    parts = ("half of the record", "three quarters", "all of it", "all of it, pairwise votes")
    yield ("accuracy", *parts, "calibration error, steps")
    keys = ("at 50%", "at 75%", "at 100%", "at 100%, votes of pairs", "calibration error of steps")
    for name, row in result["rows"].items():
        yield (name, *(streamed_score(row[key]) for key in keys))
    yield ("the most frequent class", *[f"{result['most frequent class']:.3f}"] * 4, "")
