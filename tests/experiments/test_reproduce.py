"""``make reproduce`` names every experiment, skips what is there, goes on where it was interrupted, and compares."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import rcbht_jax
from experiments import reproduce
from experiments._lib import agreement, checkpointed_rows, results_io
from experiments._lib.catalogue import EXPERIMENTS, Experiment
from experiments._lib.report_rows import NAME
from experiments.classification import table1_ours
from experiments.reproduce import Form, Spent

ROOT = Path(__file__).resolve().parents[2]
MODULES = {
    ".".join(path.relative_to(ROOT / "experiments").with_suffix("").parts): path.read_text(encoding="utf-8")
    for path in (ROOT / "experiments").rglob("*.py")
}
RESULTS = sorted(path for path in (ROOT / "experiments" / "results").glob("*.json") if path.stem != NAME)


def test_the_table_names_every_module_that_writes_a_result() -> None:
    writing = {name for name, text in MODULES.items() if re.search(r"\b(write_result|Rows)\(", text)}
    assert {experiment.module for experiment in EXPERIMENTS} >= {name for name in writing if "_lib" not in name}
    assert {experiment.module for experiment in EXPERIMENTS} <= set(MODULES)
    assert len({(experiment.module, experiment.options) for experiment in EXPERIMENTS}) == len(EXPERIMENTS)


NOT_NAMED = {"only", "parts", "tasks", "methods", "checkpoint", "gradient"}  # they choose rows, or a file


@pytest.mark.parametrize("module", sorted({experiment.module for experiment in EXPERIMENTS}))
def test_a_result_names_every_option_that_made_it(module: str) -> None:
    by_program = re.search(r"\b(given|command_of)\(", MODULES[module])
    for function in ast.walk(ast.parse(MODULES[module])):
        if isinstance(function, ast.FunctionDef) and function.name == "main" and not by_program:
            known = function.args.args[len(function.args.args) - len(function.args.defaults) :]
            options = {one.arg.replace("_", "-") for one in known}
            assert options - NOT_NAMED <= set(re.findall(r"--([a-z-]+) {", MODULES[module]))


def test_options_of_a_command_are_those_that_are_not_the_defaults() -> None:
    def main(folder: Path, trials: int = 6, store: Path | None = None, stands: bool = False) -> None: ...

    defaults = results_io.defaults_of(main)
    assert results_io.given({**defaults, "folder": Path("a")}, defaults) == ""
    values = {"trials": 3, "store": Path("/here/x.zarr"), "stands": True}
    assert results_io.given(values, defaults) == " --trials 3 --store FOLDER --stands"


def test_the_command_of_rows_has_every_option_but_their_choice() -> None:
    values = {"folder": Path("a"), "repeats": 3, "seed": 0, "only": ("A to B",)}
    command = checkpointed_rows.command_of(table1_ours.main, values, "FOLDER")
    assert command == "python -m experiments.classification.table1_ours FOLDER --repeats 3 --seed 0"


@pytest.mark.parametrize("path", RESULTS, ids=lambda path: path.stem)
def test_every_committed_result_has_a_command_that_exists(path: Path) -> None:
    record = json.loads(path.read_text(encoding="utf-8"))
    module = re.match(r"python -m experiments\.([\w.]+)", record["command"])
    assert module is not None
    assert module[1] in MODULES
    its = [experiment for experiment in EXPERIMENTS if experiment.module == module[1]]
    assert any(path.stem in experiment.names or path.stem.startswith(experiment.name) for experiment in its)


def test_what_is_run_here_takes_less_than_two_hours() -> None:
    here = [Form(one, bool(one.shorter), Path()) for one in EXPERIMENTS if not one.elsewhere]
    together, alone = (sum(f.minutes for f in here if f.experiment.alone == kind) for kind in (False, True))
    assert together / 2 + alone <= 120  # two at a time
    assert all(0 < form.minutes <= form.experiment.minutes for form in here)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder for results, and one experiment that writes there."""
    for module in (reproduce, results_io):
        monkeypatch.setattr(module, "RESULTS", tmp_path)
    monkeypatch.setattr(reproduce, "COMMITTED", tmp_path)
    monkeypatch.setattr(reproduce, "EXPERIMENTS", (Experiment("some", "some", 1),))
    return tmp_path


def write(folder: Path, version: str = rcbht_jax.__version__, **result: Any) -> None:
    record = {"rcbht_jax_version": version, "result": result}
    (folder / "some.json").write_text(json.dumps(record), encoding="utf-8")


def test_finished_is_of_this_version_complete_and_not_interrupted(place: Path) -> None:
    some = Form(Experiment("some", "some", 1), False, place)
    assert not some.finished()
    write(place, complete=False)
    assert not some.finished()
    write(place, "0.0.1", complete=True)
    assert not some.finished()
    write(place, rows={})
    assert some.finished()
    some.begun.touch()
    assert not some.finished()


def call(monkeypatch: pytest.MonkeyPatch, place: Path, *words: str, status: int = 0, makes: Any = None) -> list[Any]:
    """Run ``main`` with a process that only takes note, writes ``makes`` as its result, and ends with ``status``."""
    called: list[Any] = []

    def process(words: list[str], environment: Any = None, *_: Any) -> Spent:
        called.append(words)
        if makes is not None:
            folder = Path(environment["RCBHT_RESULTS"])
            folder.mkdir(exist_ok=True)
            write(folder, **makes)
        return Spent(status, 2.0, 1.0, 0.5)

    monkeypatch.setattr(reproduce, "call", process)
    monkeypatch.setattr(sys, "argv", ["reproduce", str(place / "work"), *words])
    with pytest.raises(SystemExit) as end:
        reproduce.main()
    assert end.value.code == bool(status and called)
    return called


def test_what_is_there_is_skipped_and_forced_if_asked(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(place)
    assert call(monkeypatch, place) == []
    assert call(monkeypatch, place, "--force") == [[sys.executable, "-m", "experiments.some"]]
    assert not (place / "some.json").exists()
    kept = json.loads((place / "work" / "reproduce.json").read_text())["experiments"]["some"]
    assert (kept["minutes"], kept["cpu_minutes"], kept["shorter form"]) == (2.0, 1.0, False)


def test_a_shorter_form_leaves_the_whole_result_alone(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    some = Experiment("some", "some", 200, ("--all",), shorter=("--few",), shorter_minutes=1)
    monkeypatch.setattr(reproduce, "EXPERIMENTS", (some,))
    committed = {"a": {"mean": 0.5, "low": 0.4, "high": 0.6}, "b": {"accuracy": 0.9, "interval": [0.8, 1.0]}}
    write(place, **committed)
    before = (place / "some.json").read_bytes()
    assert call(monkeypatch, place) == []  # the whole one is there
    made = {"a": {"mean": 0.7, "low": 0.6, "high": 0.8}, "b": {"accuracy": 0.7, "interval": [0.6, 0.79]}}
    assert call(monkeypatch, place, "--force", makes=made)[0][-2:] == ["--all", "--few"]
    assert (place / "some.json").read_bytes() == before
    said = capsys.readouterr().out
    assert "some: a shorter form (--few); the 95 % intervals of 1 of 2 scores overlap the committed ones" in said
    assert "apart: b: 0.700 (0.600 to 0.790), committed 0.900 (0.800 to 1.000)" in said
    (place / "some.json").unlink()
    assert call(monkeypatch, place) == []  # the shorter one is there
    assert call(monkeypatch, place, "--long", makes=committed)[0][-1] == "--all"
    assert (place / "some.json").exists()


def test_the_time_of_a_process_is_its_own() -> None:
    busy = "import time\nend = time.process_time() + 0.3\nwhile time.process_time() < end: pass"
    spent = reproduce.call([sys.executable, "-c", f"{busy}\nraise SystemExit(3)"])
    idle = reproduce.call([sys.executable, "-c", "pass"])
    assert spent.status == 3
    assert 0.3 / 60 <= spent.cpu_minutes <= 2 / 60
    assert idle.cpu_minutes < spent.cpu_minutes
    assert spent.minutes >= 0.3 / 60


def test_memory_is_that_of_the_process() -> None:
    # Until it runs its own program a process counts the memory of the one that began it, so a small one begins it.
    big = "import sys; from experiments.reproduce import call; words = [sys.executable, '-c', "
    big += "\"x = b'x' * 600_000_000\"]; print(call(words).memory_gb)"
    said = subprocess.run([sys.executable, "-c", big], capture_output=True, text=True, check=True)
    assert 0.6 <= float(said.stdout) < 0.8


def test_what_is_shared_is_made_first_and_speed_is_measured_last(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = Experiment("speed", "speed", 1, (reproduce.MODEL,), alone=True), Experiment("some", "some", 1)
    monkeypatch.setattr(reproduce, "EXPERIMENTS", (first, second))
    called = call(monkeypatch, place, "--jobs", "2")
    assert [words[3] for words in called[:2]] == ["import", "train-online"]
    assert [words[2] for words in called[2:]] == ["experiments.some", "experiments.speed"]
    assert called[1][-1] == called[3][-1] == str(place / "work" / "online.model")


def test_a_failure_is_told_and_tried_again(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(call(monkeypatch, place, status=1)) == 1
    write(place, rows={})
    assert len(call(monkeypatch, place)) == 1  # the first run did not end
    assert call(monkeypatch, place) == []


def test_what_cannot_run_says_why(place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(reproduce, "DATA", tmp_path / "none")
    assert "RCBHT_DATA" in reproduce.lacking(Experiment("some", "some", 1, needs=("data",)), None)
    assert "make peers" in reproduce.lacking(Experiment("some", "some", 1, needs=("peers",)), None)
    assert reproduce.lacking(Experiment("some", "some", 1, elsewhere="no"), None) == "no"
    assert reproduce.lacking(Experiment("some", "some", 1), None) == ""


def test_differences() -> None:
    first = {"a": [0.5, {"b": 1}], "seconds": 3}
    assert agreement.largest_difference(first, {"a": [0.75, {"b": 1}], "seconds": 9}) == (0.25, "a > 0")
    assert agreement.largest_difference(first, first) == (0.0, "")
    assert agreement.largest_difference(first, {"a": [0.5]})[0] == float("inf")


@pytest.mark.parametrize(
    ("key", "compared"),
    [
        ("seconds", False), ("compile_seconds", False), ("seconds to simulate", False), ("libraries", False),
        ("physics steps per second", False), ("trials_of_15_s_per_minute", False), ("microseconds_in_scan", False),
        ("words per second", True), ("time", True), ("untimed", True), ("detected | elapsed time", True),
    ],
)  # fmt: skip
def test_times_are_not_compared_but_rows_whose_names_speak_of_them_are(key: str, compared: bool) -> None:
    assert bool(agreement.largest_difference({key: 1.0}, {key: 2.0})[0]) == compared


@pytest.mark.parametrize("key", ["first second alone", "every tenth of a second", "median noise of 3 seconds"])
def test_a_score_is_compared_whatever_its_row_is_called(key: str) -> None:
    one, other = ({key: {"accuracy": {"mean": mean}, "seconds": mean}} for mean in (0.5, 0.75))
    assert agreement.largest_difference(one, other) == (0.25, f"{key} > accuracy > mean")


def test_a_shorter_form_without_intervals() -> None:
    said = agreement.shorter("some", {"a": 0.5, "b": 2}, {"a": 0.75, "c": 1}, "--few")
    assert said.endswith("no interval to compare; largest difference of 1 numbers 0.25 a")
    made, committed = {"a": {"mean": 0.60049}}, {"a": {"mean": 0.5, "interval": [0.4, 0.6]}}
    made_with_interval = {"a": made["a"] | {"low": 0.6004, "high": 0.7}}
    assert agreement.apart(made_with_interval, committed) == (1, [])  # results are rounded
    assert agreement.apart(made, committed) == (0, [])  # a score without an interval is another kind of number


def test_rows_go_on_and_start_anew_when_made_differently(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write_result(name: str, command: str, result: Any, seed: int, show: bool) -> None:
        record = {"rcbht_jax_version": rcbht_jax.__version__, "seed": seed, "result": result}
        (place / f"{name}.json").write_text(json.dumps(record))

    monkeypatch.setattr(checkpointed_rows, "write_result", write_result)
    made: list[str] = []

    def make(row: str) -> Any:
        return lambda: made.append(row) or {"score": len(made)}

    def fill(wanted: list[str], about: int = 0, only: str = "") -> dict[str, Any]:
        table = checkpointed_rows.Rows("some", "command", {"about": (about,)}, seed=0)
        table.fill({row: make(row) for row in wanted}, [only])
        return json.loads((place / "some.json").read_text())["result"]

    assert fill(["a", "b"], only="a") == {"about": [0], "complete": False, "rows": {"a": {"score": 1}}}
    assert fill(["b", "a"])["complete"]
    assert list(fill(["b", "a"])["rows"]) == ["b", "a"]
    assert made == ["a", "b"]
    assert fill(["a"])["rows"] == {"a": {"score": 1}}
    assert fill(["a"], about=1)["rows"] == {"a": {"score": 3}}
