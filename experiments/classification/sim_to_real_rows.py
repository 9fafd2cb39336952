"""Rows of ``experiments.classification.sim_to_real``: training sets, feature families, labelling."""

from __future__ import annotations

from dataclasses import dataclass, replace

from experiments.classification.sim_to_real_sets import PRESETS
from rcbht_jax.features.recipes import PLAIN, SIGNAL, UNTIMED

# Families of features that selection may choose from, simple ones first: ties go to the earlier.
CANDIDATES = {
    "histogram": ("histogram",),
    "course": ("course",),
    "edges": ("edges",),
    "words": PLAIN,
    "lines": SIGNAL,
    "values": ("attributes", "course", "offset", "edges"),
    "words and course": (*PLAIN, "course"),
    "all but duration and absolute level": (*PLAIN, "course", *SIGNAL),
    "all but duration": UNTIMED,
    "all": (*UNTIMED, "duration"),
}
CHOICE = tuple(name for name in CANDIDATES if name != "all")  # duration is a confound
FIXED = ("all but duration",)  # where a single set trains, which cannot show what transfers
EVERY = 10_000  # trials: all


@dataclass(frozen=True)
class Row:
    """The training and test sets and the options of one row."""

    train: tuple[str, ...]  # names of sets
    test: tuple[str, ...] = ("A", "B", "C")
    trials: int = EVERY  # of each training set, at most
    draw: int = 0  # which of them
    candidates: tuple[str, ...] = CHOICE
    window: int = 5  # samples
    tare: bool = True
    thresholds: str = "preset"
    learner: str = "words"  # or "duration", "statistics" (of the raw wrench)
    rule: str = "paper"
    weighing: tuple[str, ...] = ()  # of labels in the family histogram
    factors: tuple[float, ...] = (1.0,)  # on the tolerance of the fit rule, which is learned from training trials


def _of(level: str, *presets: str) -> tuple[str, ...]:
    return tuple(f"{level} {preset}" for preset in presets)


ALL = Row(_of("wide", *PRESETS))
FEW = replace(ALL, trials=64)  # of each set, for comparisons in which each set must have as many


def _rows() -> dict[str, Row]:
    rows = {
        "main | all presets": ALL,
        "main | without preset A": Row(_of("wide", "B", "C", "openhrp")),
        "main | without preset B": Row(_of("wide", "A", "C", "openhrp")),
        "main | without presets A and B": Row(_of("wide", "C", "openhrp")),
        "main | without presets B and C": Row(_of("wide", "A", "openhrp")),
        "baseline | recorded OpenHRP trials": Row(("SIM1",), candidates=FIXED),
        "baseline | recorded OpenHRP trials, values": Row(("SIM1",), candidates=("values",)),
        "baseline | duration alone": replace(ALL, learner="duration"),
        "baseline | statistics of the raw wrench, random forest": replace(ALL, learner="statistics"),
        "baseline | statistics, without presets A and B": Row(_of("wide", "C", "openhrp"), learner="statistics"),
        "baseline | statistics, recorded OpenHRP trials": Row(("SIM1",), learner="statistics"),
    }
    rows |= {f"one preset | {preset}": Row(_of("wide", preset), candidates=FIXED) for preset in PRESETS}
    for level in ("none", "mild", "wide"):
        rows[f"randomisation | {level}, all presets"] = replace(FEW, train=_of(level, *PRESETS))
        rows[f"randomisation | {level}, without A and B"] = replace(FEW, train=_of(level, "C", "openhrp"))
    ideal = (*_of("wide", "A", "B", "C"), "ideal openhrp")
    rows["sensor | all presets wear a robot's"] = FEW
    rows["sensor | the OpenHRP preset's is free of noise"] = replace(FEW, train=ideal)
    rows["mating | 1 to 20 s"] = FEW
    rows["mating | 1 to 20 s, without A and B"] = replace(FEW, train=_of("wide", "C", "openhrp"))
    rows["mating | each preset's own time"] = replace(FEW, train=_of("own-end", *PRESETS))
    rows["mating | own time, without A and B"] = replace(FEW, train=_of("own-end", "C", "openhrp"))
    for trials, draws in ((4, 3), (16, 3), (64, 1), (128, 1)):
        for draw in range(draws):
            name = f"amount | {trials * len(PRESETS)} trials" + f", draw {draw + 1}" * (draws > 1)
            rows[name] = replace(ALL, trials=trials, draw=draw)
    others = replace(FEW, train=_of("wide", "C", "openhrp"))
    rows |= {f"features | {name}": replace(FEW, candidates=(name,)) for name in CANDIDATES}
    rows |= {f"features, without A and B | {name}": replace(others, candidates=(name,)) for name in CANDIDATES}
    rows |= {f"window | {samples} samples": replace(FEW, window=samples) for samples in (5, 10, 20)}
    rows |= {f"tare | {word}": replace(FEW, tare=tare) for word, tare in (("first second", True), ("none", False))}
    for thresholds in ("preset", "context", "context, own axes", "search", "gradient"):
        for features in ("words", "all but duration")[: 1 if thresholds == "gradient" else 2]:
            name = f"thresholds | {thresholds}, {features}"
            rows[name] = replace(FEW, thresholds=thresholds, candidates=(features,))
            if thresholds != "search":  # takes longest
                rows[f"thresholds, without A and B | {thresholds}, {features}"] = replace(
                    others, thresholds=thresholds, candidates=(features,)
                )
    for level in ("mild", "wide"):
        rows[f"reverse | recorded A and B to {level}"] = Row(("A", "B"), _of(level, *PRESETS), candidates=FIXED)
    return rows


ROWS = _rows()
