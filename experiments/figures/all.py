"""Figures of the committed results, written to docs/images; nothing is measured here.

Run: python -m experiments.figures.all
PICTURES names the commands that draw the other pictures there. Their stores and models come from::

    rcbht import hiro FOLDER hiro.zarr; rcbht encode hiro.zarr --rule fit
    rcbht train-online hiro.zarr --session B --detect -o b.model
    rcbht simulate hooked.zarr --preset hooked-B --trials 5
    rcbht simulate clip.zarr --assembly clip --robot ur5e --trials 20  # peg-in-hole and plug: --robot panda
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments._lib.results_io import committed
from experiments._lib.scores import of_peers, of_probes, of_table1
from experiments.figures import calibration_curves, driven, early, faults, hook, online, sim_to_real, words
from experiments.figures.style import DPI, IMAGES, LINES, OURS, PEER, PROBE, plain
from rcbht_jax.plots import save
from rcbht_jax.plots.canvas import new_figure

COLORS, MARKS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#999999"), "osD^vP"
KINDS = {"ours": (OURS, "words"), "peer": (PEER, "other methods, raw wrench"), "probe": (PROBE, "probes")}


def rows_of(name: str) -> dict[str, Any]:
    return committed(name)["rows"]


def peers() -> Figure:
    """One panel per benchmark: accuracy of every method with its interval, best on top."""
    facts = committed("peers")["benchmarks"]
    figure = new_figure((12.5, 9.4), DPI)
    measured = of_peers(*map(committed, ("peers", "grammar")))
    for number, (benchmark, methods) in enumerate(measured.items()):
        ax = figure.add_subplot(2, len(facts) // 2, number + 1)
        rows = {method: row for method, row in methods.items() if method != "majority"}
        order = sorted(rows, key=lambda method: rows[method]["accuracy"]["mean"])
        for place, method in enumerate(order):
            bar(ax, place, rows[method])
        ax.set_yticks(range(len(order)), [short(method) for method in order])
        if chance := methods.get("majority"):
            ax.axvline(chance["accuracy"]["mean"], color="0.3", linestyle=":", linewidth=1)
        ax.set_xlim(0, 1.02)
        about = facts[benchmark]
        ax.set_title(f"{benchmark}\n{len(about['classes'])} classes, {about['items']} items", fontsize=9)
        plain(ax)
    handles = [figure.axes[0].barh(np.nan, 0, color=color, label=label) for color, label in KINDS.values()]
    figure.legend(handles=handles, loc="lower center", ncols=3, frameon=False, fontsize=9)
    figure.supxlabel(
        "accuracy; line: 95 % interval; dots: most frequent class; relative: neither duration nor offset",
        fontsize=9,
        y=0.045,
    )
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    return figure


def bar(ax: Axes, place: int, row: dict[str, Any]) -> None:
    score = row["accuracy"]
    ax.barh(place, score["mean"], color=KINDS[row["kind"]][0], height=0.75)
    ax.plot([score["low"], score["high"]], [place, place], color="black", linewidth=1.2)


def short(method: str) -> str:
    """A name that fits on one line."""
    for part in (" + SVM", " + ridge"):
        method = method.replace(part, "")
    return method.replace(", without duration and offset", ", relative").replace(", offset removed", ", no offset")


def curves() -> Figure:
    """Accuracy over the number of training trials, one panel per set."""
    rows = rows_of("curves")
    names = list(dict.fromkeys(name.split(" | ")[0] for name in rows))
    figure = new_figure((10.0, 4.0), DPI)
    for number, name in enumerate(names):
        ax = figure.add_subplot(1, len(names), number + 1)
        result = {key.split(" | ")[2]: row for key, row in rows.items() if key.startswith(f"{name} | curve")}
        for color, (features, row) in zip(LINES, result.items(), strict=False):
            sizes = [int(size) for size in row]
            mean, low, high = np.array(list(row.values())).T
            ax.plot(sizes, mean, color=color, marker="o", markersize=3.5, label=features)
            ax.fill_between(sizes, low, high, color=color, alpha=0.15, linewidth=0)
        ax.set_ylim(0.4, 1.01)
        ax.set_title(name, fontsize=10)
        ax.set_xlabel("training trials", fontsize=9)
        ax.grid(alpha=0.3)
        plain(ax)
    figure.axes[0].set_ylabel("accuracy on all other trials", fontsize=9)
    figure.axes[-1].legend(fontsize=8, frameon=False, loc="lower right")
    figure.tight_layout()
    return figure


def grids() -> Figure:
    """Accuracy over kernel and cost, one panel per set and kind of features."""
    result = committed("curves")
    rows = {name: row for name, row in result["rows"].items() if " | grid | " in name}
    figure = new_figure((11.0, 4.2), DPI)
    for number, (name, row) in enumerate(rows.items()):
        ax = figure.add_subplot(2, 2, number + 1)
        values = np.array(list(row.values()))
        ax.imshow(values, vmin=0.25, vmax=1, cmap="viridis", aspect="auto")
        for (y, x), value in np.ndenumerate(values):
            color = "white" if value < 0.7 else "black"
            ax.text(x, y, f"{value:.2f}", ha="center", va="center", fontsize=8, color=color)
        ax.set_yticks(range(len(row)), list(row))
        ax.set_xticks(range(values.shape[1]), [f"{cost:g}" for cost in result["costs"]])
        ax.set_title(name.replace(" | grid | ", ": "), fontsize=9)
        ax.tick_params(labelsize=8)
    figure.supxlabel("cost C", fontsize=9)
    figure.supylabel("kernel", fontsize=9)
    figure.tight_layout()
    return figure


def confidence() -> Figure:
    """Belief in the true class over the course of a sub-task: a row per set, a column per class."""
    rows = rows_of("confidence")
    figure = new_figure((10.5, 2.3 * len(rows) + 0.4), DPI)
    for number, (name, row) in enumerate(rows.items()):
        for place, (state, belief) in enumerate(row["belief"].items()):
            ax = figure.add_subplot(len(rows), len(row["belief"]), number * len(row["belief"]) + place + 1)
            mean, low, high = (np.array(belief[kind], float) for kind in ("mean", "low", "high"))
            at = (np.arange(len(mean)) + 0.5) * 100 / len(mean)
            seen = ~np.isnan(mean)
            ax.axhspan(0, 0.5, color="0.93", linewidth=0)
            ax.axhline(0.7, color="0.4", linestyle=":", linewidth=1)
            ax.fill_between(at[seen], low[seen], high[seen], color=OURS, alpha=0.2, linewidth=0)
            ax.plot(at[seen], mean[seen], color=OURS, linewidth=1.8)
            ax.set_xlim(0, 100)
            ax.set_ylim(0, 1.02)
            seconds = row["seconds of a sub-task, median"][place]
            ax.set_title(f"{name}, {state} ({seconds:.1f} s)", fontsize=9)
            plain(ax)
    figure.supxlabel("elapsed part of the sub-task, %", fontsize=9)
    figure.supylabel("probability of the true class", fontsize=9)
    figure.tight_layout()
    return figure


Score = Mapping[str, float]  # mean, low, high


def dots(rows: Mapping[str, Mapping[str, Score]], what: str, ticks: Mapping[str, float] | None = None) -> Figure:
    """Dots per row and kind, and short grey lines (``ticks``) for other scores of some rows."""
    kinds = list(dict.fromkeys(kind for row in rows.values() for kind in row))
    figure = new_figure((10.0, 0.38 * len(rows) + 1.5), DPI)
    ax = figure.subplots()
    for number, (kind, color, mark) in enumerate(zip(kinds, COLORS, MARKS, strict=False)):
        place = np.arange(len(rows)) + 0.7 * ((number + 0.5) / len(kinds) - 0.5)
        for at, row in zip(place, rows.values(), strict=True):
            if kind in row:
                ax.plot([row[kind]["low"], row[kind]["high"]], [at, at], color=color, linewidth=1.1, alpha=0.6)
        known = [(row[kind]["mean"], at) for at, row in zip(place, rows.values(), strict=True) if kind in row]
        ax.plot(*np.array(known).T, mark, color=color, markersize=4.5, label=kind, linestyle="none")
    for at, name in enumerate(rows):
        if ticks and name in ticks:
            ax.plot([ticks[name]] * 2, [at - 0.4, at + 0.4], color="0.35", linewidth=1.6)
    if ticks:
        ax.plot([], [], color="0.35", linewidth=1.6, label="paper, mean")
    ax.set_yticks(range(len(rows)), list(rows))
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xlabel(what, fontsize=9)
    ax.grid(axis="y", alpha=0.25)
    plain(ax)
    figure.legend(loc="lower center", ncols=len(kinds) + bool(ticks), frameon=False, fontsize=8)
    figure.tight_layout(rect=(0, 0.35 / figure.get_figheight(), 1, 1))
    return figure


def table1() -> Figure:
    """Table I of the paper on our labels, with the scores of duration alone and those printed in the paper."""
    result = committed("table1_ours")
    rows, printed = {}, {}
    for name, scores in of_table1(result).items():
        title, paper = name.replace(" | ", ", "), result["rows"][name]["paper"]
        rows[title] = {kind.removesuffix(", nested, grouped"): score for kind, score in scores.items()}
        if paper is not None:
            printed[title] = paper[1]
    return dots(rows, "accuracy, grouped by trial, kernel and cost selected in nested folds", printed)


def probes() -> Figure:
    """Scores of probes that separate failure, success and session without any assembly."""
    return dots(of_probes(committed("probes")), "balanced accuracy")


def failure_types() -> Figure:
    """Confusion of the authors' failure types by the best of the streamed heads."""
    result = committed("failure_types_online")
    at = "at 100%, votes of pairs"
    name, row = max(result["rows"].items(), key=lambda item: item[1][at]["mean"])
    title = f"{name}: {row[at]['mean']:.3f} of {result['trials']} failures, streamed, trials not trained on"
    return faults.failure_types(list(result["classes"]), row[f"true and said {at}"], title)


FIGURES = {
    "table1": table1,
    "probes": probes,
    "peers": peers,
    "training-size": curves,
    "kernel-cost": grids,
    "confidence": confidence,
    "online-reliability": lambda: online.reliability(rows_of("table2")),
    "online-early": lambda: online.early(rows_of("table2")),
    "early-failures": lambda: early.draw(committed("external_early")),
    "online-faults": lambda: faults.faults(committed("faults_online")["presets"]),
    "failure-types": failure_types,
    "sim-to-real": lambda: sim_to_real.draw(rows_of("sim_to_real"), sim_to_real.STORY),
    "sim-to-real-all": lambda: sim_to_real.draw(rows_of("sim_to_real")),
    "rate-distortion": lambda: words.rate_distortion(committed("rate_distortion")),
    "word-stability": lambda: words.stability(committed("rate_distortion")),
    "snap-events": lambda: words.snaps(committed("snaps")),
    "driven-fit": lambda: driven.draw(committed("driven_fit")),
    "driven-loads": lambda: driven.loads(committed("driven_starts_loads")),
    "snap-hook": lambda: hook.bench(committed("hook_bench")),
    "calibration-curves": lambda: calibration_curves.draw(rows_of("calibration_curves")),
}
# Pictures of trials and of experiments that draw while they measure, and the command of each, without -o.
REAL = "REAL_HIRO_ONE_SA_SUCCESS"
PICTURES = {
    "trial": "rcbht plot trial hiro.zarr 20121127-HIROSA-S-13 --tracks online-W5-fit",
    "label-map": f"rcbht plot map hiro.zarr --source {REAL} --by state",
    "online-beliefs": "rcbht plot beliefs hiro.zarr 20121127-HIROSA-S-13 --model b.model",
    "live-page": "rcbht serve hiro.zarr --trial 20121127-HIROSA-S-13 --model b.model --speed 1",
    "assembly-peg": "rcbht view peg.zarr sim-peg-in-hole-panda-000000",
    "assembly-clip": "rcbht view clip.zarr sim-clip-ur5e-000000",
    "assembly-plug": "rcbht view plug.zarr sim-plug-panda-000000",
    "view-hooked": "rcbht view hooked.zarr sim-hooked-B-000004",
    "labels-primitive": "python -m tools.docs_pictures",
    "labels-mc": "python -m tools.docs_pictures",
    "labels-llb": "python -m tools.docs_pictures",
    "one-or-two": "python -m tools.docs_pictures",
    "two-arm-right": "python -m experiments.classification.two_arm",
    "two-arm-left": "python -m experiments.classification.two_arm",
    "success-map": "python -m experiments.simulation.success",
}


def main() -> None:
    for name, draw in FIGURES.items():
        save(draw(), IMAGES / f"{name}.png")


if __name__ == "__main__":
    main()
