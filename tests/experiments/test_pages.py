"""Tables of results on the pages are those of the committed files, and no score is typed in by hand."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments import pages
from experiments._lib import results_io
from experiments._lib.benchmarks import CONFOUNDS
from experiments._lib.report_rows import NAME, report_rows
from experiments.figures.all import FIGURES, PICTURES
from experiments.tables import TABLES
from rcbht_jax.learning.metrics import wilson
from rcbht_jax.report.results import cells, read_results

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "experiments" / "results"
DECIMAL = re.compile(r"(?<![\d.])\d\.\d{2,4}(?!\d)")
SCORE = re.compile(r"(?<![\d.])[01]?\.\d{2,}")
INTERVAL = re.compile(r"([01]\.\d{3}) \(([01]\.\d{3}) to ([01]\.\d{3})\)")
WITH_INTERVALS = (
    "peers-folds", "peers-sessions", "grammar-folds", "grammar-sessions", "calibration", "calibration-near",
    "calibration-bank", "probes", "two-arm", "ablations", "online", "detected", "abnormal", "failure-types",
    "external-kitting", "external-first", "external-caps", "fit-classes", "fit-transfer", "faults-across",
    "types-across-recall", "time-known", "sim-to-real", "sim-to-real-choices", "zero-shot",
)  # fmt: skip
# Pages whose scores are all generated.
BY_HAND = (
    "README.md", "docs/evaluation.md", "docs/measurements/classification.md", "docs/sim_to_real.md", "docs/engines.md",
    "docs/howto/features.md", "docs/concepts.md", "docs/measurements/words.md", "docs/tutorial.md",
    "docs/calibration.md", "docs/online.md", "docs/measurements/streams.md", "docs/measurements/faults.md",
)  # fmt: skip
# One cell of each table, and where its number is: table, first cells of the row, column, format and place.
CELLS = [
    ("fit-lines", "REAL | fit x1", "Fz", ".4f fit_quality > sets > REAL > rows > fit x1 > r2 > 2"),
    ("fit-words", "SIM1 | paper", "Mx", ".0f fit_quality > sets > SIM1 > rows > paper > words > 3"),
    ("external-rest", "caps, 1 kHz, W=25 | fit: annotated", "primitives",
     ".3f external_rest > sets > caps, 1 kHz, W=25 > rows > fit: annotated > primitive > least > mean"),
    ("fit-latency", "two-arm | fit x1", "behaviours",
     ".2f fit_quality > sets > two-arm > rows > fit x1 > latency > llb > median"),
    ("fit-running", "fit", "primitives revised", ".3f fit_latency > rows > fit > revised > primitive > mean"),
    ("fit-provisional", "SIM1 | if it ended now", "behaviours revised",
     ".3f fit_latency > labels > SIM1 > if it ended now > llb > revised > mean"),
    ("fit-provisional-right", "two-arm | shown", "primitives right",
     ".3f fit_latency > labels > two-arm > shown > primitive > right > mean"),
    ("fit-provisional-moving", "REAL, others | shown", "compositions right where it moves",
     ".3f fit_latency > labels > REAL, others > shown > mc > right_where_it_moves > mean"),
    ("snap-events", "plug@panda, seed 7 | words", "false", ".0f snaps > rows > plug@panda, seed 7 > words > false"),
    ("fit-classes", "plain words, fit", "SIM1 states",
     ".3f fit_classification > rows > SIM1 states | plain words, fit > accuracy > mean"),
    ("fit-calibration", "rest", "REAL states, A to B",
     ".3f fit_calibration > rows > REAL states, A to B | rest > accuracy > mean"),
    ("scaling", "search: 65,536 thresholds on 64 trials", "of linear", ".2f scaling > search > of linear"),
    ("words-rate", "optimum", "SIM1",
     ".2f rate_distortion > rows > rate | SIM1 | optimum > words per second at residual > 0.01"),
    ("words-defaults", "SIM1 | 5", "residual of fit",
     ".4f rate_distortion > rows > rate | SIM1 | fit > points > 2 > residual"),
    ("words-noise", "SIM1 | fit | 0.5", "stays",
     ".2f rate_distortion > rows > noise | SIM1 | fit > 0.5 > primitive > kept"),
    ("words-resampled", "two-arm | published rules | 100", "stays",
     ".2f rate_distortion > rows > resampled | two-arm | published rules > 100 > primitive > kept"),
    ("results", "13 failure types of the authors' simulation (confounded: the approach differs)",
     "frozen method, 95 % interval", ".3f headline > rows > failure types | frozen > score > mean"),
    ("all-results", "four states, session A to session B", "frozen method, 95 % interval",
     ".3f headline > rows > REAL states, A to B | frozen > score > mean"),
    ("ablations", "states, real trials, streamed, at their end; beginnings given", "95 % interval",
     ".3f table2 > rows > REAL at 10 Hz > all > full-sequence accuracy > mean"),
    ("causal", "detected | elapsed time", "B to A",
     ".3f causal > rows > B to A > detected | elapsed time > macro step accuracy > mean"),
    ("causal-simulated", "detected | frozen, phase", "simulated and A to B",
     ".3f zero_shot_stream > rows > simulated and A to B > detected | frozen, phase > macro step accuracy > mean"),
    ("zero-shot", "four states | frozen", "A", ".3f zero_shot > rows > four states | frozen > A > mean"),
    ("failure-calibration", "richer words | by progress", "quarter 4",
     ".3f failure_calibration > rows > richer words > by progress > quarter 4 > likeliest"),
    ("time-known", "SIM1", "rotation", ".3f causal > rows > time known, SIM1 > rotation > mean"),
    ("peers-folds", "MiniRocket + ridge", "SIM1 states",
     ".3f peers > rows > SIM1 states | MiniRocket + ridge > accuracy > mean"),
    ("external-failures", "MiniRocket", "LP4", ".3f external_failures > rows > lp4 | MiniRocket > accuracy > mean"),
    ("external-first", "10", "LP1", ".3f external_early > rows > lp1 | first 10 samples > accuracy > mean"),
    ("external-early", "LP4: CALIMERA", "harmonic mean",
     ".3f external_early > rows > lp4 | CALIMERA > harmonic_mean > mean"),
    ("external-caps", "offline", "F1@25", ".3f external_caps > rows > offline > score > f1@25"),
    ("external-kitting", "contact: isolation forest", "skill 7",
     ".3f kitting > rows > contact > isolation forest > skills > 7 > auroc"),
    ("external-kitting-types", "types | majority, a new day", "accuracy",
     ".3f kitting_more > rows > types | majority, a new day > accuracy > mean"),
    ("peers-sessions", "richer words + SVM, all", "REAL states, A to B",
     ".3f grammar > rows > REAL states, A to B | all families > accuracy > mean"),
    ("grammar-folds", "levels alone", "failure types",
     ".3f grammar > rows > failure types | levels alone > accuracy > mean"),
    ("grammar-sessions", "richer words", "REAL states, B to A",
     ".3f grammar > rows > REAL states, B to A | richer words > accuracy > mean"),
    ("table1", "REAL success/failure | online", "words, nested, grouped",
     ".3f table1_ours > rows > REAL success/failure | online > words, nested, grouped > accuracy > mean"),
    ("probes", "REAL success A or success B", "first sample alone",
     ".3f probes > rows > REAL success A or success B | first sample alone > balanced_accuracy > mean"),
    ("two-arm", "trained on `two`, tested on recorded", "words and duration",
     ".3f two_arm_states > trained on two, tested on recorded > words and duration > mean"),
    ("two-arm-fidelity", "`two`, left wrist", "time warping / sd",
     ".3f two_arm > two > signature of trials like the recorded ones > left > dtw_over_sd"),
    ("calibration", "REAL A -> B, harmonised", "context",
     ".3f calibration > real-transfer > A -> B, harmonised > context > words > accuracy > mean"),
    ("calibration-near", "average of all", "REAL B -> A",
     ".3f calibration_near > rows > REAL B -> A | average of all > accuracy > mean"),
    ("calibration-bank", "words: best inside", "REAL A -> B",
     ".3f calibration_bank > rows > words | REAL A -> B | best inside > accuracy > mean"),
    ("calibration-time", "random", "evaluations", "d calibration_curves > rows > random | seed 0 > evaluations"),
    ("calibration-simulated", "hooked-B, search", "the authors' failures, ranks",
     ".3f calibration_transfer > rows > hooked-B, search | ranks > accuracy > mean"),
    ("online", "SIM one arm, relative features", "OverallPr",
     ".3f table2 > rows > SIM1 at 10 Hz > relative > OverallPr > mean"),
    ("latency", "one window to belief, 99 %", "time", ".2f stream_speed > latency > p99, ms"),
    ("faults", "missing tab", "hooked-C",
     ".3f faults_online > presets > hooked-C > kinds > missing-tab > with contact > share detected > mean"),
    ("faults-apart", "jamming, parts seated, alarms", "hooked-A",
     "d faults_online > presets > hooked-A > kinds > jamming > with contact > of them alarmed"),
    ("faults-across", "hooked-B | jamming", "same session, without this kind",
     ".3f faults_across > presets > hooked-B > kind never seen > kinds > jamming > share detected > mean"),
    ("faults-outcome", "hooked-A | wedging", "precision",
     ".3f faults_outcome > sessions > hooked-A > wedging > precision > mean"),
    ("will-it-seat", "hooked-B to hooked-A | belief in the outcome, own nominal", "jamming",
     ".3f will_it_seat > rows > hooked-B to hooked-A | belief in the outcome, own nominal > area > jamming > mean"),
    ("will-it-seat-said", "hooked-B | missing tab", "specificity",
     ".3f will_it_seat > rows > hooked-B | belief in the outcome > said at 0.5 > missing-tab > specificity > mean"),
    ("types-across", "simulated types alone", "loaded to at rest",
     ".3f types_across > rows > begins loaded to begins at rest | simulated types alone > score > mean"),
    ("types-across-recall", "-y", "within loaded", ".3f types_across > rows > within | begins loaded > recall > -y"),
    ("fit-streamed", "fit, tolerance / 4", "SIM1, onsets detected",
     ".3f detected_starts > rows > SIM1 | fit, tolerance / 4 > macro step accuracy, detected > mean"),
    ("fit-transfer", "fit, weighed", "4 states, B",
     ".3f fit_sim_to_real > rows > fit, weighed > harmonised > B > accuracy"),
    ("simulated-draws", "words alone: fit | four states", "draw 2",
     ".3f simulated_draws > rows > fit | draw 2 > four states"),
    ("detected", "the detected state itself", "SIM one arm",
     ".3f detected_starts > rows > SIM1 | paper > macro step accuracy, filter alone > mean"),
    ("abnormal", "successes of a session not trained on", "at the end",
     ".3f abnormal_real > rows > held out > all features > at 100% > mean"),
    ("failure-types", "richer words", "all of it, pairwise votes",
     ".3f failure_types_online > rows > richer words > at 100%, votes of pairs > mean"),
    ("parity", "hooked-B: `mjx`, one H100", "trials", "d engines_gpu > presets > hooked-B > mjx > parity > trials"),
    ("parity-floor", "part moved by 1e-07 m", "largest difference until contact",
     ".3f parity_floor > rows > part moved by 1e-07 m > force_until_contact"),
    ("gate", "B: the preset", "spread", ".2f fidelity_gate > rows > B > the preset > checks > spread > value"),
    ("gate-intervals", "C: the preset", "AUC", ".2f fidelity_gate > rows > C > the preset > checks > AUC > value"),
    ("separability", "openhrp", "0.01 N", ".2f separability > recordings > openhrp > moved by N > 0.01"),
    ("hook-forces", "four tabs, two after two", "press, N",
     ".2f hook_bench > parts > four tabs, two after two > press"),
    ("snap-needs", "seat 0.4 mm higher", "fall, N", ".2f snap_needs > rows > seat 0.4 mm higher > fall, N"),
    ("driven-fit", "B, black cells", "trials", "d driven_fit > scores > fitted > B, black cells > trials"),
    ("driven-starts", "best of 7 starts", "not seen", ".2f driven_starts > scores > from many starts > held > loss"),
    ("driven-starts", "best of 14 starts, loads counted", "My",
     ".2f driven_starts_loads > scores > from many starts > held > explained > 4"),
    ("snap-creep", "3", "0.95 mm", ".2f snap_creep > sweep > 3 > 0.95 > s after mating began"),
    ("snap-holds", "rear lips hold harder", "coverage",
     ".3f snap_creep > gate > rear lips hold harder > coverage > mean"),
    ("solver", "B: `mjx`, one H200 | 6/4", "million steps per second",
     ".2f/1e6 engines_gpu > presets > B > mjx > solver > 0 > steps_per_s"),
    ("speed", "B: `warp`, one H200 | 8,192", "million steps per second",
     ".2f/1e6 engines_gpu > presets > B > warp > speed > steps_per_s"),
    ("native-cores", "32", "trials of 15 s a minute", ", native_cores > rows > 5 > trials_of_15_s_per_minute"),
    ("synthesis", "10,000 trials of hooked-B, one GPU, command, programs in the cache", "seconds",
     ".0f simulate_gpu > rows > 10,000 trials of hooked-B, one GPU, command, programs in the cache > seconds"),
    ("large-store-read", "1,000,000", "`rcbht info`, s", ".2f large_store > read > 1000000 > info_s"),
    ("large-store-worked", "16,000", "encode, GB", ".2f large_store > worked > 16000 > encode_GB"),
    ("repeatability", "`warp`, again", "same outcome", "d repeatability > engines > warp > again > same_outcome"),
    ("step", "`warp`, one H100 | 8,192", "in contact, ms", ".2f step_profile > lanes > 8192 > contact_ms"),
    ("step-kernels", "solver", "in contact, µs", ".0f step_profile > traced_contact > kinds > solver > us"),
    ("encoder-speed", "8,192 | 5", "billion samples a second",
     ".2f/1e9 encoder_speed > windows > W5 > 8192 > time first > samples_per_s"),
    ("sim-to-real", "main: without preset A", "4 states, A",
     ".3f sim_to_real > rows > main | without preset A > harmonised > A > accuracy"),
    ("sim-to-real-choices", "sensor: a robot's in all presets", "training trials",
     "d sim_to_real > rows > sensor | all presets wear a robot's > merged > trials"),
    ("sim-to-real-thresholds", "thresholds: gradient, words", "3 states, B",
     ".3f sim_to_real > rows > thresholds | gradient, words > merged > B > accuracy"),
]  # fmt: skip


def test_every_table_is_shown_somewhere() -> None:
    assert {name for page in pages.pages() for name in pages.tables_of(page)} == set(TABLES)


@pytest.mark.parametrize("page", pages.pages(), ids=lambda page: page.stem)
def test_tables_and_numbers_are_those_of_the_committed_results(page: Path) -> None:
    assert pages.replaced(page) == page.read_text(encoding="utf-8"), "run python -m experiments.pages"


@pytest.fixture
def declared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[float]]:
    """Leaves a table only the results that it declares, and returns their numbers."""

    def leave(name: str) -> list[float]:
        for result in TABLES[name].reads:
            shutil.copy(RESULTS / f"{result}.json", tmp_path)
        monkeypatch.setattr(results_io, "COMMITTED", tmp_path)
        return [number for result in TABLES[name].reads for number in numbers(results_io.committed(result))]

    return leave


@pytest.mark.parametrize("name", TABLES)
def test_every_number_of_a_table_is_in_the_results_that_it_declares(
    name: str, declared: Callable[[str], list[float]]
) -> None:
    values, lines = declared(name), TABLES[name]("").splitlines()
    assert len({line.count("|") for line in lines}) == 1
    held = {f"{abs(value) / unit:.{digits}f}" for value in values for digits in (2, 3, 4) for unit in (1, 1e6, 1e9)}
    if name in ("results", "all-results", "ablations"):  # what the paper prints is text in the rows
        held |= set(DECIMAL.findall((RESULTS / f"{NAME}.json").read_text()))
    printed = DECIMAL.findall(
        INTERVAL.sub(lambda at: at[1 if by_wilson(at[1], at.groups()[1:], values) else 0], "\n".join(lines[2:]))
    )
    assert bool(printed) == (name not in ("experiments", "repeatability", "native-cores"))  # none below ten
    assert set(printed) <= held


def by_wilson(mean: str, ends: tuple[str, ...], values: list[float]) -> bool:
    """Whether an interval as printed is Wilson's of a committed score, by some number of trials."""
    means = {value for value in values if f"{value:.3f}" == mean}
    known = (wilson(value * trials, trials) for value in means for trials in range(1, 400))
    return any((f"{low:.3f}", f"{high:.3f}") == ends for low, high in known)


@pytest.mark.parametrize("name", WITH_INTERVALS)
def test_every_score_has_an_interval(name: str) -> None:
    """Of no mistake, too; but not what guesses the same class always, nor calibration errors and false alarms."""
    head, _, *lines = [line.split(" | ") for line in TABLES[name]("").splitlines()]
    scored = [place for place, title in enumerate(head) if not re.search("error|false alarms|^mean$", title)]
    constant = re.compile("majority|most frequent class")
    cells = [line[place] for line in lines if not constant.search(line[0]) for place in scored]
    scores = [cell.split(";")[0].strip("*| ") for cell in cells if re.match(r"\**[01]\.\d{3}", cell)]
    assert scores
    assert [score for score in scores if not INTERVAL.fullmatch(score)] == []
    assert not re.search(r"\((\d\.\d{3}) to \1\)", " ".join(scores))


def test_intervals_of_a_single_split_count_its_trials() -> None:
    lines = [line.split(" | ") for line in TABLES["peers-sessions"]("").splitlines()]
    (row,) = [line for line in lines if line[0] == "| MultiRocketHydra + ridge"]
    tested = {
        "REAL states, A to B": (1.0, 19),
        "REAL states, B to A": (0.75, 16),
        "REAL merged states, B to A": (0.6667, 16),
    }
    titles = [cell.strip("| ") for cell in lines[0]]
    for title, (share, trials) in tested.items():
        low, high = (round(end, 4) for end in wilson(share * trials, trials))  # as results are stored
        assert row[titles.index(title)].startswith(f"{share:.3f} ({low:.3f} to {high:.3f})")


@pytest.mark.parametrize(("name", "row", "column", "mark"), CELLS, ids=[cell[0] for cell in CELLS])
def test_a_cell_is_the_value_at_its_place(name: str, row: str, column: str, mark: str) -> None:
    head, _, *lines = TABLES[name]("").splitlines()
    (cells,) = [line.split(" | ") for line in lines if line.startswith(f"| {row} |")]
    titles = head.removeprefix("| ").removesuffix(" |").split(" | ")
    shown = re.search(r"[\d,.]+", cells[titles.index(column)].removeprefix("| "))
    assert shown
    assert shown[0].strip(",") == pages.number(*mark.split(" ", 1))


def test_every_table_of_results_has_a_cell_with_its_place() -> None:
    assert {cell[0] for cell in CELLS} == {name for name, table in TABLES.items() if table.reads}


def test_the_rows_of_the_report_are_those_of_the_results() -> None:
    stored = json.loads((RESULTS / f"{NAME}.json").read_text(encoding="utf-8"))
    assert stored == json.loads(json.dumps(report_rows())), "run python -m experiments.pages"
    for row in stored["rows"]:
        values = numbers(results_io.committed(Path(row["source"]).stem))
        if row["source"] in ("grammar.json", "headline.json"):  # whose peer may be a row of peers.json
            values += numbers(results_io.committed("peers"))
        if row["source"] == "headline.json":  # or, of types of failure of another batch, of types_across.json
            values += numbers(results_io.committed("types_across"))
        assert {row["ours"], *([row["duration"]] if row["duration"] else [])} <= set(values)
        peer = row["peer"] or {"mean": row["ours"], "interval": row["interval"]}
        for mean, (low, high) in ((row["ours"], row["interval"]), (peer["mean"], peer["interval"])):
            assert mean in values
            assert {low, high} <= set(values) or by_wilson(f"{mean:.3f}", (f"{low:.3f}", f"{high:.3f}"), values)


def test_rows_of_the_report_have_the_intervals_of_the_pages() -> None:
    rows = read_results(RESULTS).rows
    assert [row.what for row in rows if row.interval is None or row.interval[0] >= row.interval[1]] == []
    assert [row.what for row in rows if row.peer and row.peer.interval[0] >= row.peer.interval[1]] == []
    shown = {
        ("words + SVM, all", benchmark): cell
        for name in ("peers-folds", "peers-sessions")
        for head, _, *lines in [[line.strip("| ").split(" | ") for line in TABLES[name]("").splitlines()]]
        for benchmark, cell in zip(head, next(line for line in lines if line[0] == "words + SVM, all")[1:], strict=True)
    }
    written = {row.what: cells(row) for row in rows if row.group.startswith("Words and other methods")}
    assert len(shown) == 8
    for (method, benchmark), cell in shown.items():
        _, _, ours, interval, *_ = written[f"{benchmark}: {method}"]
        assert f"{ours} ({interval})" == cell
    (moved,) = [row for row in rows if row.what == "trained on two, tested on recorded (13 trials)"]
    assert moved.interval == tuple(round(end, 4) for end in wilson(13 * moved.ours, 13))


@pytest.mark.parametrize("name", ["peers", "probes", "table1"])
def test_pictures_have_the_intervals_of_the_pages(name: str) -> None:
    spans = [np.asarray(line.get_xydata()) for ax in FIGURES[name]().axes for line in ax.lines]
    across = [span[:, 0] for span in spans if len(span) == 2 and span[0, 1] == span[1, 1]]
    assert len(across) > 20
    assert all(low < high for low, high in across)


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict | list):
        parts = value.values() if isinstance(value, dict) else value
        return [number for part in parts for number in numbers(part)]
    return [float(value)] if isinstance(value, int | float) else []


@pytest.mark.parametrize("page", BY_HAND)
def test_no_score_is_typed_in_by_hand(page: str) -> None:
    assert not SCORE.findall(pages.by_hand(ROOT / page))


def test_no_score_is_typed_into_the_confounds_of_the_recorded_data() -> None:
    assert not SCORE.findall(" ".join(CONFOUNDS.values()))


def test_every_picture_has_a_command_that_draws_it() -> None:
    drawn = [*FIGURES, *PICTURES]
    assert sorted(drawn) == sorted(path.stem for path in (ROOT / "docs" / "images").glob("*.png"))
