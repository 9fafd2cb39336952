"""Tables of how well and how soon words describe the signal."""

from __future__ import annotations

from typing import Any

from experiments.tables.cells import NONE, Lines, ends, score, table

TARGET = "0.01"  # residual at which methods are compared
APPROACH = ("approach_constant", "approach_constant_inside", "approach_fixed_inside")
AGREEMENT = {"kept": "stays", "edit": "edit distance", "time": "equal time"}
LAYERS = {"primitive": "primitives", "mc": "compositions", "llb": "behaviours"}


@table("fit-lines", "fit_quality")
def lines(result: dict[str, Any]) -> Lines:
    """R2 of the lines of primitives by axis, the interval of the lowest, and words for each recording."""
    axes = next(iter(result["sets"].values()))["axes"]
    yield ("", "rule", *axes, "interval of the lowest", "primitives")
    for name, found in result["sets"].items():
        for rule, row in found["rows"].items():
            low, high = (row["lowest"]["r2"][end] for end in ("low", "high"))
            each = (f"{value:.4f}" for value in row["r2"])
            yield (name, rule, *each, f"{low:.4f} to {high:.4f}", f"{row['all_words']['primitive']:.0f}")


@table("fit-words", "fit_quality")
def words(result: dict[str, Any]) -> Lines:
    """Primitives for each recording by axis, and the least share of the approach that is constant, ends in and out."""
    axes = next(iter(result["sets"].values()))["axes"]
    share = "share of the approach that is constant, worst axis"
    fixed = "the same, of behaviours that are fixed"
    yield ("", "rule", *axes, share, "without 0.25 s at either end", fixed)
    for name, found in result["sets"].items():
        for rule, row in found["rows"].items():
            counts = (f"{value:.0f}" for value in row["words"])
            yield (name, rule, *counts, *(score(row["lowest"][key]) for key in APPROACH))


@table("external-rest", "external_rest")
def external_rest(result: dict[str, Any]) -> Lines:
    """Least share of the rest of other robots, over the axes, that each layer calls constant or fixed."""
    yield ("", "rule: rest", *LAYERS.values())
    for name, found in result["sets"].items():
        for how, row in found["rows"].items():
            yield (name, how, *(score(row[layer]["least"]) for layer in LAYERS))


@table("fit-latency", "fit_quality")
def latency(result: dict[str, Any]) -> Lines:
    """Median, 95th percentile and largest latency of every layer, s."""
    yield ("", "rule", *LAYERS.values())
    for name, found in result["sets"].items():
        for rule, row in found["rows"].items():
            if rule in ("paper", "fit x1", "fit x1, W=2"):
                seconds = (row["latency"][layer].values() for layer in LAYERS)
                yield (name, rule, *(" / ".join(f"{value:.2f}" for value in values) for values in seconds))


@table("fit-running", "fit_latency")
def running(result: dict[str, Any]) -> Lines:
    """Words before their publication: contacts detected in time, and revised labels."""
    head = ("rule", "contacts", "seen within 50 ms")
    ages = tuple(f"newest {name}, p95 s" for name in LAYERS.values())
    yield (*head, *ages, *(f"{name} revised" for name in LAYERS.values()))
    for rule, row in result["rows"].items():
        age = (f"{row['newest_published_age'][layer][1]:.1f}" for layer in LAYERS)
        revised = (score(row["revised"][layer]) for layer in LAYERS)
        yield (rule, str(row["contacts"]), score(row["contacts_seen_within_50_ms"]), *age, *revised)


@table("fit-provisional", "fit_latency")
def provisional(result: dict[str, Any]) -> Lines:
    """Share of provisional labels that are revised, by method."""
    yield from _by_way(result, "revised", *(f"{name} revised" for name in LAYERS.values()))


@table("fit-provisional-right", "fit_latency")
def provisional_right(result: dict[str, Any]) -> Lines:
    """Share of all the time in which provisional labels are right, by method."""
    yield from _by_way(result, "right", *(f"{name} right" for name in LAYERS.values()))


@table("fit-provisional-moving", "fit_latency")
def provisional_moving(result: dict[str, Any]) -> Lines:
    """Share of the time in which the right label is not that of rest, by method."""
    head = (f"{name} right where it moves" for name in LAYERS.values())
    yield from (row for row in _by_way(result, "right_where_it_moves", *head) if row[1] != "always constant")


def _by_way(result: dict[str, Any], key: str, *head: str) -> Lines:
    yield ("", "label", *head)
    for name, ways in result["labels"].items():
        for way, found in ways.items():
            yield (name, way, *(score(found[layer][key]) for layer in LAYERS))


@table("fit-classes", "fit_classification")
def classes(result: dict[str, Any]) -> Lines:
    """Accuracy of sentences of both rules."""
    sets = list(result["benchmarks"])
    names = list(dict.fromkeys(row.split(" | ")[1] for row in result["rows"]))
    yield ("", *sets)
    for name in names:
        found = [result["rows"].get(f"{one} | {name}") for one in sets]
        yield (name, *(score(row and row["accuracy"]) for row in found))


@table("fit-streamed", "detected_starts")
def streamed(result: dict[str, Any]) -> Lines:
    """Step accuracy of streamed states by words of both rules."""
    ways = {"onsets given": "given", "onsets detected": "detected", "the detected state": "filter alone"}
    kinds = dict.fromkeys(name.split(" | ")[1] for name in result["rows"])
    sets = ("REAL", "SIM1")
    yield ("words", *(f"{one}, {way}" for one in sets for way in ways))
    for kind in kinds:
        rows = [result["rows"][f"{one} | {kind}"] for one in sets]
        yield (kind, *(score(row[f"macro step accuracy, {key}"]) for row in rows for key in ways.values()))


@table("fit-transfer", "fit_sim_to_real")
def transfer(result: dict[str, Any]) -> Lines:
    """States of recorded trials by words alone, learned from simulated ones."""
    yield "words", "4 states, A", "4 states, B", "4 states, both", "3 states, both"
    for kind, row in result["rows"].items():
        four, three = row["harmonised"], row["merged"]
        yield (kind, *(score(four[one]) for one in ("A", "B", "A+B")), score(three["A+B"]))


@table("words-rate", "rate_distortion")
def rate(result: dict[str, Any]) -> Lines:
    """Words per second and axis at a residual of 1 %, of every method and set."""
    yield ("", "decides from", *result["sets"])
    for method, (when, _) in result["kinds"].items():
        found = [result["rows"].get(f"rate | {name} | {method}") for name in result["sets"]]
        yield (method, when, *(_needed(row) if row else NONE for row in found))


def _needed(row: dict[str, Any]) -> str:
    value, interval = (row[key].get(TARGET) for key in ("words per second at residual", "interval of words per second"))
    return NONE if value is None else f"{value:.2f}" + (ends(*interval, digits=2) if interval else "")


@table("words-defaults", "rate_distortion")
def defaults(result: dict[str, Any]) -> Lines:
    """The default tolerance: words per second, residual, and that of the bottom-up lines of the same number."""
    yield "", "window", "words per second", "residual of fit", "of bottom-up, as many"
    for name in result["sets"]:
        for suffix in ("", ", small window"):
            curves = (f"rate | {name} | {method}{suffix}" for method in ("fit", "bottom-up, as many as fit"))
            ours, best = (_default(result["rows"][curve]["points"]) for curve in curves)
            window = result["sets"][name]["windows of fit"][bool(suffix)]
            values = (f"{ours['words per second']:.2f}", f"{ours['residual']:.4f}", f"{best['residual']:.4f}")
            yield (name, str(window), *values)


def _default(points: list[dict[str, Any]]) -> dict[str, Any]:
    return next(point for point in points if point["at"].endswith(" x1"))


@table("words-noise", "rate_distortion")
def noise(result: dict[str, Any]) -> Lines:
    """Share of long primitives that stay, edit distance and equal time under noise."""
    return _stability(result, "noise", "noise, tolerances", ("0.125", "0.5", "1"))  # of which the picture has more


@table("words-resampled", "rate_distortion")
def resampled(result: dict[str, Any]) -> Lines:
    """The same between a recording and its copy at another rate."""
    return _stability(result, "resampled", "Hz", ("40", "100", "500", "1000"))


def _stability(result: dict[str, Any], kind: str, what: str, levels: tuple[str, ...]) -> Lines:
    rows = {name: row for name, row in result["rows"].items() if name.startswith(f"{kind} | ")}
    yield ("", "words", what, *AGREEMENT.values())
    for name, row in rows.items():
        _, of, rule = name.split(" | ")
        for level in levels:
            yield (of, rule, level, *(_agreed(row[level]["primitive"], key) for key in AGREEMENT))


def _agreed(found: dict[str, Any], key: str) -> str:
    if found[key] is None:
        return NONE
    interval = found.get(f"{key} interval")
    return f"{found[key]:.2f}" + (ends(*interval, digits=2) if interval else "")


@table("snap-events", "snaps")
def snap_events(result: dict[str, Any]) -> Lines:
    """Passes found in time and false events, by words and by the baseline."""
    yield "", "by", "trials", "passes", "found in time", "events", "false", "recall", "precision", "ms after, 95 %"
    for name, kinds in result["rows"].items():
        for kind, row in kinds.items():
            if "share" in kind:  # in the result
                continue
            delays = row["ms after the pass, 5 50 95 %"]
            late = NONE if delays is None else f"{delays[2]:.0f}"
            found = (row[which] for which in ("recall", "precision"))
            counts = (str(row[what]) for what in ("trials", "passes", "found in time", "seen", "false"))
            yield (name, kind.replace("|F|", "all force"), *counts, *map(score, found), late)
