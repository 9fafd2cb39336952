"""Tables of the physics engines: parity, speed, synthesis."""

from __future__ import annotations

from typing import Any

from experiments.tables.cells import NONE, markdown, table

WORDS_SAME = "same primitive / composition / behaviour, % of time"
DEVICES = ("engines_gpu", "engines")
Result = dict[str, Any]


def _runs(gpu: Result, cpu: Result, part: str) -> Result:
    """One part of the measurements on a GPU, by preset and engine, and of those on a CPU where they have it."""
    runs = {
        f"{preset}: `{engine}`, one {measured['card']}": measured[engine].get(part)
        for preset, measured in gpu["presets"].items()
        for engine in ("warp", "mjx")
    }
    runs[f"{cpu['preset']}: `mjx`, 2 CPU cores"] = cpu["mjx"].get(part)
    return {name: run for name, run in runs.items() if run is not None}


MOTIONS = ("free", "contact")


@table("parity", *DEVICES)
def parity(gpu: Result, cpu: Result) -> str:
    """The device engines against C MuJoCo."""
    lines = []
    for engine, measured in _runs(gpu, cpu, "parity").items():
        wrench = [measured[f"{what}_until_contact"] for what in ("force", "moment")]
        words = " / ".join(f"{100 * share:.1f}" for share in measured["labels"].values())
        contact = f"{wrench[0]:.3f} N, {wrench[1]:.4f} Nm"
        rest = (f"{measured['force_after_contact']:.3f} N", words, f"{100 * measured['states']:.2f}")
        lines.append((engine, str(measured["trials"]), contact, *rest, f"{100 * measured['same_outcome']:.1f}"))
    head = ("engine", "trials", "largest difference until contact", "median force difference after it", WORDS_SAME)
    return markdown((*head, "same state, % of time", "same outcome, % of trials"), lines)


@table("parity-floor", "parity_floor")
def parity_floor(result: Result) -> str:
    """C MuJoCo against itself after minimal changes."""
    lines = []
    for change, measured in result["rows"].items():
        words = " / ".join(f"{100 * share:.1f}" for share in measured["labels"].values())
        lines.append((change, f"{measured['force_until_contact']:.3f} N", words))
    return markdown(("change", "largest difference until contact", WORDS_SAME), lines)


@table("hook-forces", "hook_bench")
def hook_forces(result: Result) -> str:
    """Snap hooks on the bench: measured mating and separation forces, and those of the formulas."""
    lines = []
    for name, row in result["parts"].items():
        theory = (row["mating force of a tab"], row["separation force of a tab"])
        lines.append((name, *(f"{force:.2f}" for force in (row["press"], theory[0], row["pull"], theory[1]))))
    return markdown(("", "press, N", "formula for one tab", "pull, N", "formula for one tab "), lines)


@table("snap-needs", "snap_needs")
def snap_needs(result: Result) -> str:
    """Passes of the rear hooks of hooked-B, with one thing changed at a time."""
    medians = ("s after mating began", "release, N", "fall, N")
    lines = []
    for name, row in result["rows"].items():
        cells = (f"{row[key]:.2f}" if key in row else "–" for key in medians)
        lines.append((name, str(row["trials"]), str(row["seated"]), str(row["fall of 7 N in mating"]), *cells))
    return markdown(("", "trials", "seated", "fall of 7 N in mating", *medians), lines)


@table("driven-fit", "driven_fit")
def driven_fit(result: Result) -> str:
    """Share of recorded wrenches that parts explain along the recorded motion, before and after the fit."""
    lines = []
    for name, fitted in result["scores"]["fitted"].items():
        before = result["scores"]["presets"][name]
        pairs = [
            f"{one['explained'][axis]:.2f} → {two['explained'][axis]:.2f}"
            for one, two, axis in ((before, fitted, at) for at in (0, 1, 2, 4))
        ]
        lines.append((name, str(fitted["trials"]), f"{before['loss']:.2f} → {fitted['loss']:.2f}", *pairs))
    return markdown(("", "trials", "not explained", "Fx", "Fy", "Fz", "My"), lines)


@table("driven-starts", "driven_starts", "driven_starts_mating", "driven_starts_loads")
def driven_starts(*searches: Result) -> str:
    """Share of session B's wrenches that parts explain along its motion, and the place of their load at mating."""
    best = "from many starts"
    rows = [
        ("4 s", searches[0], {"presets": "presets", "driven_fit": "fitted from the presets", best: "best of 7 starts"}),
        ("16 s", searches[1], {"presets": "presets", best: "best of 14 starts"}),
        ("16 s", searches[2], {best: "best of 14 starts, loads counted"}),
    ]
    lines = [("recorded", *[NONE] * 6, *_loads(searches[0]["loads"]["recorded"]))]
    for mating, result, names in rows:
        for name, title in names.items():
            scores = result["scores"][name]
            left = [f"{scores[part]['loss']:.2f}" for part in ("seen", "held")]
            axes = [f"{scores['held']['explained'][axis]:.2f}" for axis in (0, 2, 4)]
            lines.append((title, mating, *left, *axes, *_loads(result["loads"][name])))
    head = ("", "mating", "not explained, seen", "not seen", "Fx", "Fz", "My", "load, mm forward", "moves forward")
    return markdown(head, lines)


def _loads(load: Result) -> tuple[str, str]:
    return f"{load['before'][0]:.0f} → {load['after'][0]:.0f}", f"{load['to the front']} of {load['trials']}"


@table("snap-creep", "snap_creep")
def snap_creep(result: Result) -> str:
    """Time until the rear hooks of hooked-B pass, by the creep of contacts and by their overlap."""
    overlaps = tuple(next(iter(result["sweep"].values())))
    lines = []
    for impratio, row in result["sweep"].items():
        lines.append((impratio, *(_waits(row[overlap]) for overlap in overlaps)))
    return markdown(("`impratio`", *(f"{overlap} mm" for overlap in overlaps)), lines)


def _waits(row: Result) -> str:
    seconds = f"{row['s after mating began']:.2f} s" if row["seated"] else "–"
    return f"{seconds} ({row['seated']} of {row['trials']})"


@table("snap-holds", "snap_creep")
def snap_holds(result: Result) -> str:
    """Gate, outcomes and last snaps of hooked-B with contacts that creep less, means over seeds."""
    measures = ("coverage", "W1/sd", "DTW/sd", "snaps")
    head = ("", *measures, "lowest and highest share of snaps", "outcomes as recorded", "last snap, s, quartiles")
    lines = []
    for name, row in result["gate"].items():
        means = [f"{row[each]['mean']:.3f}" for each in measures]
        ends = f"{row['snaps']['lowest']:.2f}, {row['snaps']['highest']:.2f}"
        lines.append((name, *means, ends, f"{row['outcomes as recorded']['mean']:.2f}", _quartiles(row)))
    return markdown(head, [*lines, ("recorded", *[NONE] * 6, _quartiles(result["recorded"]))])


def _quartiles(row: Result) -> str:
    return ", ".join(f"{time:.2f}" for time in row["last snap, s, quartiles"]) or NONE


GATE = ("coverage", "W1/sd", "DTW/sd", "AUC", "spread", "first impact", "snaps")


@table("gate", "fidelity_gate")
def fidelity_gate(result: Result) -> str:
    """Measures of the gate for presets, null models and recordings; those beyond their limits are in bold."""
    lines = []
    for session, rows in result["rows"].items():
        for name, row in rows.items():
            cells = [_measure(row["checks"].get(each)) for each in GATE]
            signs = row["checks"]["wrong signs"]
            cells.insert(4, str(int(signs["value"])) if signs["holds"] else f"**{int(signs['value'])}**")
            verdicts = ("yes" if row[each] else "no" for each in ("passes", "passed before"))
            lines.append((f"{session}: {name}", *cells, *verdicts))
    return markdown(("", *GATE[:4], "wrong signs", *GATE[4:], "passes", "passed the former gate"), lines)


@table("separability", "separability")
def separability(result: Result) -> str:
    """AUC between the halves of a session's recordings, one of them moved."""
    rows = result["recordings"]
    forces = list(next(iter(rows.values()))["moved by N"])
    lines = [
        (
            name, f"{result['asked'][name]:.2f}", f"{row['spread of forces, N, least, median, most'][1]:.2f}",
            f"{row['not moved']:.2f}", *(f"{row['moved by N'][force]:.2f}" for force in forces),
            *(f"{area:.2f}" for area in row["moved by sd"].values()),
        )
        for name, row in rows.items()
    ]  # fmt: skip
    shares = [f"{share} sd" for share in next(iter(rows.values()))["moved by sd"]]
    return markdown(("", "asked", "sd, N, median", "not moved", *(f"{force} N" for force in forces), *shares), lines)


def _measure(check: Result | None) -> str:
    if check is None or check["value"] is None:
        return "–"
    return f"{check['value']:.2f}" if check["holds"] else f"**{check['value']:.2f}**"


ENCODED = ("time first", "row by row", "compact", "scan")
SYNTHESIS = (  # measures and their digits
    ("utilisation", 2), ("host_memory_peak_GB", 1), ("host_memory_with_writers_GB", 1), ("store_GB", 1),
)  # fmt: skip


@table("solver", *DEVICES)
def solver(gpu: Result, cpu: Result) -> str:
    """Effect of the number of iterations of the device engines' solver."""
    lines = []
    for engine, rows in _runs(gpu, cpu, "solver").items():
        for row in sorted(rows, key=lambda row: -row["steps_per_s"]):
            middle, most = (row[f"{what}_force_difference_after_contact"] for what in ("median", "p99"))
            limits = "/".join(str(limit) for limit in row["solver"])
            lines.append((engine, limits, f"{middle:.4f} N", f"{most:.2f} N", f"{row['steps_per_s'] / 1e6:.2f}"))
    head = ("engine", "iterations / line search", "median force difference", "99 %", "million steps per second")
    return markdown(head, lines)


@table("speed", *DEVICES)
def speed(gpu: Result, cpu: Result) -> str:
    """Physics steps per second with everything inside, by engine and batch."""
    lines = []
    for kind in ("speed", "sweep"):
        for engine, measured in _runs(gpu, cpu, kind).items():
            for run in measured if isinstance(measured, list) else [measured]:
                millions, memory = run["steps_per_s"] / 1e6, run["memory_peak_GB"]
                lines.append(
                    (engine, f"{run['batch']:,}", f"{millions:.2f}", f"{run['compile_s']:.0f}", f"{memory:.1f}")
                )
    return markdown(("engine", "trials at once", "million steps per second", "compilation, s", "memory, GB"), lines)


@table("synthesis", "simulate_gpu")
def synthesis(result: Result) -> str:
    """Stores of labelled trials from GPUs, from the command to the last byte."""
    lines = []
    for name, row in result["rows"].items():
        rest = [f"{row[key]:.{digits}f}" if key in row else "–" for key, digits in SYNTHESIS]
        lines.append((name, row["card"], f"{row['seconds']:.0f}", f"{row['trials'] / row['seconds']:.0f}", *rest))
    head = ("", "GPU", "seconds", "trials a second", "lanes busy", "host memory, GB", "with writers, GB", "store, GB")
    return markdown(head, lines)


@table("native-cores", "native_cores")
def native_cores(result: Result) -> str:
    """The native engine on many cores, by processes and their threads."""
    keys = (
        ("processes", ",d"), ("threads", ",d"), ("trials", ",d"), ("seconds", ".2f"), ("processor_seconds", ".2f"),
        ("trials_of_15_s_per_minute", ",.0f"),
    )  # fmt: skip
    lines = [tuple(format(row[key], form) for key, form in keys) for row in result["rows"]]
    head = ("processes", "threads of each", "trials", "seconds", "processor seconds", "trials of 15 s a minute")
    return markdown(head, lines)


@table("scaling", "scaling")
def scaling(result: Result) -> str:
    """All devices of a machine against one."""
    places = {"": result} | {f"{place}: ": other for place, other in result.get("other machines", {}).items()}
    lines = [line for place, part in places.items() for line in _shared(place, part)]
    return markdown(("", "one GPU, s", "all, s", "of linear", "same bits"), lines)


def _shared(place: str, part: Result) -> list[tuple[str, ...]]:
    """Rows of the work that the devices of one machine shared."""
    lines, shared = list[tuple[str, ...]](), []
    if simulated := part.get("simulation"):
        counts = [f"{simulated[which]['trials']:,}" for which in ("one", "all")]
        seconds = [f"{simulated[which]['of_work']:.1f}" for which in ("one", "all")]
        title = f"{place}trials of {simulated['preset']} with labels, stored: {counts[0]}, {counts[1]}"
        lines.append((title, *seconds, f"{simulated['of linear']:.2f}", "–"))
    if found := part.get("search"):
        shared.append((f"search: {found['candidates']:,} thresholds on {found['trials']} trials", found))
    for row in part.get("labels", []):
        kind = "compact labels" if "compact" in row else "dense labels"
        both = dict.fromkeys(f"{row[which]:,}" for which in ("recordings", "together"))
        flight = f", {row['calls']} calls in flight" if row.get("calls", 1) > 1 else ""
        shared.append((f"{kind}: {', '.join(both)} recordings, window {row['window']}{flight}", row))
    for title, row in shared:
        bits = {True: "yes", False: "no", None: "–"}[row.get("same bits")]
        times = [f"{row[which]:.4f}" for which in ("seconds_one", "seconds_all")]
        lines.append((place + title, *times, f"{row['of linear']:.2f}", bits))
    return lines


@table("repeatability", "repeatability")
def repeatability(result: Result) -> str:
    """The same trials simulated twice on a GPU."""
    lines = []
    for name, rows in result["engines"].items():
        engine, _, options = name.partition(", ")
        for how, row in rows.items():
            counts = (str(row[key]) for key in ("trials", "equal", "same_outcome", "same_length"))
            title = ", ".join(filter(None, (f"`{engine}`", options, how)))
            lines.append((title, *counts, f"{row['largest_difference']:.1f} N"))
    return markdown(("", "trials", "same bytes", "same outcome", "same length", "largest difference"), lines)


@table("encoder-speed", "encoder_speed")
def encoder_speed(result: Result) -> str:
    """The encoder on a GPU, by number of recordings and window."""
    lines = []
    for window, rows in result["windows"].items():
        for count, row in rows.items():
            cells = [f"{row[how]['samples_per_s'] / 1e9:.2f}" if how in row else "–" for how in ENCODED]
            lines.append((f"{int(count):,}", window.removeprefix("W"), *cells, f"{row['time first']['compile_s']:.0f}"))
    head = (
        "recordings", "window", "billion samples a second", "with a transposition", "compact", "former scan",
        "compilation, s",
    )  # fmt: skip
    return markdown(head, lines)


@table("step", "step_profile")
def step(result: Result) -> str:
    """A physics step of Warp by the number of lanes."""
    lines = []
    for count, row in result["lanes"].items():
        times = [f"{row[f'{how}_ms']:.2f}" for how in MOTIONS]
        lines.append((f"{int(count):,}", *times, *(f"{row[f'{how}_steps_per_s'] / 1e6:.1f}" for how in MOTIONS)))
    head = ("lanes", "a step in free motion, ms", "in contact, ms", "million steps per second, free", "in contact")
    return markdown(head, lines)


@table("step-kernels", "step_profile")
def step_kernels(result: Result) -> str:
    """Kernels of a physics step by what they do."""
    free, contact = (result[f"traced_{how}"]["kinds"] for how in MOTIONS)
    lines = [
        (kind, f"{free[kind]['us']:.0f}", f"{row['us']:.0f}", f"{row['share']:.3f}", f"{row['launches']:.0f}")
        for kind, row in contact.items()
    ]
    return markdown(("kernels", "free motion, µs", "in contact, µs", "share", "launches"), lines)


@table("large-store-read", "large_store")
def large_store_read(result: Result) -> str:
    """Describing a store and reading one of its recordings, by the number of recordings."""
    keys = (("store_GB", 1), ("info_s", 2), ("one_trial_ms", 0), ("one_trial_p95_ms", 0))
    lines = [
        (f"{int(count):,}", *(f"{row[key]:.{digits}f}" for key, digits in keys))
        for count, row in result["read"].items()
    ]
    return markdown(("recordings", "store, GB", "`rcbht info`, s", "one recording, ms", "95th percentile, ms"), lines)


@table("large-store-worked", "large_store")
def large_store_worked(result: Result) -> str:
    """Encoding and classifying a whole store, by the number of recordings."""
    keys = ("encode_s", "encode_GB", "classify_s", "classify_GB")
    lines = [(f"{int(count):,}", *(f"{row[key]:.2f}" for key in keys)) for count, row in result["worked"].items()]
    return markdown(("recordings", "encode, s", "encode, GB", "classify, s", "classify, GB"), lines)
