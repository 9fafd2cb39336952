"""Tables of the physics engines: parity, speed, synthesis."""

from __future__ import annotations

from typing import Any

from experiments.tables.cells import NONE, Lines, ends, formatted, table

WORDS_SAME = "same primitive / composition / behaviour, % of time"
DEVICES = ("engines_gpu", "engines")
Result = dict[str, Any]


def _runs(gpu: Result, cpu: Result, part: str) -> Result:
    """One part of the measurements on a GPU, by preset and engine, and of those on a CPU where they have it."""
    runs = {
        f"{preset}: `{engine}`, one {measured['machine'].split('NVIDIA ')[1].split()[0]}": measured.get(part)
        for preset, engines in gpu["presets"].items()
        for engine, measured in engines.items()
    }
    runs[f"{cpu['preset']}: `mjx`, 2 CPU cores"] = cpu["mjx"].get(part)
    return {name: run for name, run in runs.items() if run is not None}


MOTIONS = ("free", "contact")


@table("parity", *DEVICES)
def parity(gpu: Result, cpu: Result) -> Lines:
    """The device engines against C MuJoCo."""
    head = ("engine", "trials", "largest difference until contact", "median force difference after it", WORDS_SAME)
    yield (*head, "same state, % of time", "same outcome, % of trials")
    for engine, measured in _runs(gpu, cpu, "parity").items():
        wrench = [measured[f"{what}_until_contact"] for what in ("force", "moment")]
        words = " / ".join(f"{100 * share:.1f}" for share in measured["labels"].values())
        contact = f"{wrench[0]:.3f} N, {wrench[1]:.4f} Nm"
        rest = (f"{measured['force_after_contact']:.3f} N", words, f"{100 * measured['states']:.2f}")
        yield (engine, str(measured["trials"]), contact, *rest, f"{100 * measured['same_outcome']:.1f}")


@table("parity-floor", "parity_floor")
def parity_floor(result: Result) -> Lines:
    """C MuJoCo against itself after minimal changes."""
    yield "change", "largest difference until contact", WORDS_SAME
    for change, measured in result["rows"].items():
        words = " / ".join(f"{100 * share:.1f}" for share in measured["labels"].values())
        yield change, f"{measured['force_until_contact']:.3f} N", words


@table("hook-forces", "hook_bench")
def hook_forces(result: Result) -> Lines:
    """Snap hooks on the bench: measured mating and separation forces, and those of the formulas."""
    yield "", "press, N", "formula for one tab", "pull, N", "formula for one tab "
    for name, row in result["parts"].items():
        theory = (row["mating force of a tab"], row["separation force of a tab"])
        yield (name, *(f"{force:.2f}" for force in (row["press"], theory[0], row["pull"], theory[1])))


@table("snap-needs", "snap_needs")
def snap_needs(result: Result) -> Lines:
    """Passes of the rear hooks of hooked-B, with one thing changed at a time."""
    medians = dict.fromkeys(("s after mating began", "release, N", "fall, N"), ".2f")
    yield ("", "trials", "seated", "fall of 7 N in mating", *medians)
    for name, row in result["rows"].items():
        counts = (str(row[key]) for key in ("trials", "seated", "fall of 7 N in mating"))
        yield (name, *counts, *formatted(row, medians))


@table("driven-fit", "driven_fit")
def driven_fit(result: Result) -> Lines:
    """Share of recorded wrenches that parts explain along the recorded motion, before and after the fit."""
    yield "", "trials", "not explained", "Fx", "Fy", "Fz", "My"
    for name, fitted in result["scores"]["fitted"].items():
        before = result["scores"]["presets"][name]
        pairs = [
            f"{one['explained'][axis]:.2f} → {two['explained'][axis]:.2f}"
            for one, two, axis in ((before, fitted, at) for at in (0, 1, 2, 4))
        ]
        yield (name, str(fitted["trials"]), f"{before['loss']:.2f} → {fitted['loss']:.2f}", *pairs)


@table("driven-starts", "driven_starts", "driven_starts_mating", "driven_starts_loads")
def driven_starts(*searches: Result) -> Lines:
    """Share of session B's wrenches that parts explain along its motion, and the place of their load at mating."""
    best = "from many starts"
    rows = [
        ("4 s", searches[0], {"presets": "presets", "driven_fit": "fitted from the presets", best: "best of 7 starts"}),
        ("16 s", searches[1], {"presets": "presets", best: "best of 14 starts"}),
        ("16 s", searches[2], {best: "best of 14 starts, loads counted"}),
    ]
    yield "", "mating", "not explained, seen", "not seen", "Fx", "Fz", "My", "load, mm forward", "moves forward"
    yield ("recorded", *[NONE] * 6, *_loads(searches[0]["loads"]["recorded"]))
    for mating, result, names in rows:
        for name, title in names.items():
            scores = result["scores"][name]
            left = [f"{scores[part]['loss']:.2f}" for part in ("seen", "held")]
            axes = [f"{scores['held']['explained'][axis]:.2f}" for axis in (0, 2, 4)]
            yield (title, mating, *left, *axes, *_loads(result["loads"][name]))


def _loads(load: Result) -> tuple[str, str]:
    return f"{load['before'][0]:.0f} → {load['after'][0]:.0f}", f"{load['to the front']} of {load['trials']}"


@table("snap-creep", "snap_creep")
def snap_creep(result: Result) -> Lines:
    """Time until the rear hooks of hooked-B pass, by the creep of contacts and by their overlap."""
    overlaps = tuple(next(iter(result["sweep"].values())))
    yield ("`impratio`", *(f"{overlap} mm" for overlap in overlaps))
    for impratio, row in result["sweep"].items():
        yield (impratio, *(_waits(row[overlap]) for overlap in overlaps))


def _waits(row: Result) -> str:
    seconds = f"{row['s after mating began']:.2f} s" if row["seated"] else NONE
    return f"{seconds} ({row['seated']} of {row['trials']})"


@table("snap-holds", "snap_creep")
def snap_holds(result: Result) -> Lines:
    """Gate, outcomes and last snaps of hooked-B with contacts that creep less, means over seeds."""
    measures = ("coverage", "W1/sd", "DTW/sd", "snaps")
    yield ("", *measures, "outcomes as recorded", "last snap, s, quartiles")
    for name, row in result["gate"].items():
        means = [f"{row[each]['mean']:.3f}" for each in measures]
        means[-1] += ends(*row["snaps"]["interval"], digits=2)
        outcomes = row["outcomes as recorded"]
        yield (name, *means, f"{outcomes['mean']:.1f}{ends(*outcomes['interval'], digits=1)}", _quartiles(row))
    yield ("recorded", *[NONE] * 5, _quartiles(result["recorded"]))


def _quartiles(row: Result) -> str:
    return ", ".join(f"{time:.2f}" for time in row["last snap, s, quartiles"]) or NONE


GATE = ("coverage", "W1/sd", "DTW/sd", "AUC", "spread", "first impact", "snaps")


@table("gate", "fidelity_gate")
def fidelity_gate(result: Result) -> Lines:
    """Measures of the gate for presets, null models and recordings; those beyond their limits are in bold."""
    yield ("", *GATE[:4], "wrong signs", *GATE[4:], "passes", "passed the former gate")
    for session, rows in result["rows"].items():
        for name, row in rows.items():
            cells = [_measure(row["checks"].get(each)) for each in GATE]
            signs = row["checks"]["wrong signs"]
            cells.insert(4, str(int(signs["value"])) if signs["holds"] else f"**{int(signs['value'])}**")
            verdicts = ("yes" if row[each] else "no" for each in ("passes", "passed before"))
            yield (f"{session}: {name}", *cells, *verdicts)


@table("gate-intervals", "fidelity_gate")
def gate_intervals(result: Result) -> Lines:
    """Measures of the presets and of recordings against each other, with their intervals."""
    yield ("", *GATE[:5])
    for session, rows in result["rows"].items():
        for name in ("the preset", "recordings: one half against the other"):
            checks, intervals = rows[name]["checks"], rows[name]["intervals"]
            cells = (f"{checks[each]['value']:.2f}{ends(*intervals[each], digits=2)}" for each in GATE[:5])
            yield (f"{session}: {name}", *cells)


@table("separability", "separability")
def separability(result: Result) -> Lines:
    """AUC between the halves of a session's recordings, one of them moved."""
    rows = result["recordings"]
    forces = list(next(iter(rows.values()))["moved by N"])
    shares = [f"{share} sd" for share in next(iter(rows.values()))["moved by sd"]]
    columns = (*(f"{force} N" for force in forces), *shares)
    yield ("", "asked", "sd, N, median", "not moved", *columns, "largest standard error")
    for name, row in rows.items():
        areas = (row["not moved"], *(row["moved by N"][force] for force in forces), *row["moved by sd"].values())
        spread, error = row["spread of forces, N, least, median, most"][1], row["largest standard error of these means"]
        values = (result["asked"][name], spread, *areas, error)
        yield (name, *(f"{value:.2f}" for value in values))


def _measure(check: Result | None) -> str:
    if check is None or check["value"] is None:
        return NONE
    return f"{check['value']:.2f}" if check["holds"] else f"**{check['value']:.2f}**"


ENCODED = ("time first", "row by row", "compact", "scan")
SYNTHESIS = {
    "utilisation": ".2f", "host_memory_peak_GB": ".1f", "host_memory_with_writers_GB": ".1f", "store_GB": ".1f",
}  # fmt: skip


@table("solver", *DEVICES)
def solver(gpu: Result, cpu: Result) -> Lines:
    """Effect of the number of iterations of the device engines' solver."""
    yield "engine", "iterations / line search", "median force difference", "99 %", "million steps per second"
    for engine, rows in _runs(gpu, cpu, "solver").items():
        for row in sorted(rows, key=lambda row: -row["steps_per_s"]):
            middle, most = (row[f"{what}_force_difference_after_contact"] for what in ("median", "p99"))
            limits = "/".join(str(limit) for limit in row["solver"])
            yield engine, limits, f"{middle:.4f} N", f"{most:.2f} N", f"{row['steps_per_s'] / 1e6:.2f}"


@table("speed", *DEVICES)
def speed(gpu: Result, cpu: Result) -> Lines:
    """Physics steps per second with everything inside, by engine and batch."""
    yield "engine", "trials at once", "million steps per second", "compilation, s", "memory, GB"
    for kind in ("speed", "sweep"):
        for engine, measured in _runs(gpu, cpu, kind).items():
            for run in measured if isinstance(measured, list) else [measured]:
                millions, memory = run["steps_per_s"] / 1e6, run["memory_peak_GB"]
                yield engine, f"{run['batch']:,}", f"{millions:.2f}", f"{run['compile_s']:.0f}", f"{memory:.1f}"


@table("synthesis", "simulate_gpu")
def synthesis(result: Result) -> Lines:
    """Stores of labelled trials from GPUs, from the command to the last byte."""
    yield "", "GPU", "seconds", "trials a second", "lanes busy", "host memory, GB", "with writers, GB", "store, GB"
    for name, row in result["rows"].items():
        rate = f"{row['trials'] / row['seconds']:.0f}"
        yield (name, row["card"], f"{row['seconds']:.0f}", rate, *formatted(row, SYNTHESIS))


@table("native-cores", "native_cores")
def native_cores(result: Result) -> Lines:
    """The native engine on many cores, by processes and their threads."""
    forms = {
        "processes": ",d", "threads": ",d", "trials": ",d", "seconds": ".2f", "processor_seconds": ".2f",
        "trials_of_15_s_per_minute": ",.0f",
    }  # fmt: skip
    yield "processes", "threads of each", "trials", "seconds", "processor seconds", "trials of 15 s a minute"
    for row in result["rows"]:
        yield formatted(row, forms)


@table("scaling", "scaling")
def scaling(result: Result) -> Lines:
    """All devices of one machine against one of them."""
    yield "", "one GPU, s", "all, s", "of linear", "same bits"
    simulated, found = result["simulation"], result["search"]
    counts = ", ".join(f"{simulated[which]['trials']:,}" for which in ("one", "all"))
    seconds = [f"{simulated[which]['of_work']:.1f}" for which in ("one", "all")]
    title = f"trials of {simulated['preset']} with labels, stored: {counts}"
    yield (title, *seconds, f"{simulated['of linear']:.2f}", NONE)
    shared = [(f"search: {found['candidates']:,} thresholds on {found['trials']} trials", found)]
    for row in result["labels"]:
        kind = "compact labels" if "compact" in row else "dense labels"
        both = ", ".join(f"{row[which]:,}" for which in ("recordings", "together"))
        flight = f", {row['calls']} calls in flight" if row.get("calls", 1) > 1 else ""
        shared.append((f"{kind}: {both} recordings, window {row['window']}{flight}", row))
    for title, row in shared:
        times = [f"{row[which]:.4f}" for which in ("seconds_one", "seconds_all")]
        yield title, *times, f"{row['of linear']:.2f}", "yes" if row["same bits"] else "no"


@table("repeatability", "repeatability")
def repeatability(result: Result) -> Lines:
    """The same trials simulated twice on a GPU."""
    yield "", "trials", "same bytes", "same outcome", "same length", "largest difference"
    for name, rows in result["engines"].items():
        engine, _, options = name.partition(", ")
        for how, row in rows.items():
            counts = (str(row[key]) for key in ("trials", "equal", "same_outcome", "same_length"))
            title = ", ".join(filter(None, (f"`{engine}`", options, how)))
            yield (title, *counts, f"{row['largest_difference']:.1f} N")


@table("encoder-speed", "encoder_speed")
def encoder_speed(result: Result) -> Lines:
    """The encoder on a GPU, by number of recordings and window."""
    how = ("billion samples a second", "with a transposition", "compact", "former scan")
    yield ("recordings", "window", *how, "compilation, s")
    for window, rows in result["windows"].items():
        for count, row in rows.items():
            cells = [f"{row[how]['samples_per_s'] / 1e9:.2f}" if how in row else NONE for how in ENCODED]
            yield (f"{int(count):,}", window.removeprefix("W"), *cells, f"{row['time first']['compile_s']:.0f}")


@table("step", "step_profile_fused", "step_profile")
def step(fused: Result, warp: Result) -> Lines:
    """A physics step of the fused kernel and of Warp's by the number of lanes."""
    yield (
        "engine",
        "lanes",
        "a step in free motion, ms",
        "in contact, ms",
        "million steps per second, free",
        "in contact",
    )
    for engine, card, result in (("fused", "H200", fused), ("warp", "H100", warp)):
        for count, row in result["lanes"].items():
            times = [f"{row[f'{how}_ms']:.2f}" for how in MOTIONS]
            speeds = (f"{row[f'{how}_steps_per_s'] / 1e6:.1f}" for how in MOTIONS)
            yield (f"`{engine}`, one {card}", f"{int(count):,}", *times, *speeds)


@table("step-kernels", "step_profile")
def step_kernels(result: Result) -> Lines:
    """Kernels of a physics step by what they do."""
    free, contact = (result[f"traced_{how}"]["kinds"] for how in MOTIONS)
    yield "kernels", "free motion, µs", "in contact, µs", "share", "launches"
    for kind, row in contact.items():
        yield kind, f"{free[kind]['us']:.0f}", f"{row['us']:.0f}", f"{row['share']:.3f}", f"{row['launches']:.0f}"


@table("large-store-read", "large_store")
def large_store_read(result: Result) -> Lines:
    """Describing a store and reading one of its recordings, by the number of recordings."""
    forms = {"store_GB": ".1f", "info_s": ".2f", "one_trial_ms": ".0f", "one_trial_p95_ms": ".0f"}
    yield "recordings", "store, GB", "`rcbht info`, s", "one recording, ms", "95th percentile, ms"
    for count, row in result["read"].items():
        yield (f"{int(count):,}", *formatted(row, forms))


@table("large-store-worked", "large_store")
def large_store_worked(result: Result) -> Lines:
    """Encoding and classifying a whole store, by the number of recordings."""
    forms = dict.fromkeys(("encode_s", "encode_GB", "classify_s", "classify_GB"), ".2f")
    yield "recordings", "encode, s", "encode, GB", "classify, s", "classify, GB"
    for count, row in result["worked"].items():
        yield (f"{int(count):,}", *formatted(row, forms))
