"""``rcbht bench``: lines of numbers, ratios and their history; a fall is found, noise is not."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import pytest

from rcbht_jax._util import ratios
from rcbht_jax.cli import bench
from rcbht_jax.cli.main import main
from rcbht_jax.errors import InputError
from tests.support.command_line import CommandLine
from tests.support.compiler import as_users_compile

SMALL = ("bench", "--trials", "2", "--samples", "40")


@pytest.fixture(scope="module", autouse=True)
def quick() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "_REPEATS", 1)
        step = bench.streaming_step
        patch.setattr(bench, "streaming_step", lambda: step(windows=3))
        patch.setattr(bench, "offline_trial", lambda: 0.1)
        patch.setattr(bench, "peers", lambda *_: {"tslearn SAX": 10.0})
        yield


@pytest.fixture(scope="module")
def measured(quick: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A history of one run."""
    path = tmp_path_factory.mktemp("bench") / "history.json"
    assert main([*SMALL, "--history", str(path)]) == 0
    return path


def test_a_run_is_lines_of_name_value_unit(measured: Path) -> None:
    [record] = json.loads(measured.read_text())
    assert set(record["ratios"]) == {"encode/W=5", "encode/W=20", "fit/encode/W=5", "fit/step", "step", "store/read"}
    assert all(ratio > 0 for ratio in record["ratios"].values())
    command = bench.Bench(trials=2, samples=40)
    lines = command.text({**record, "compared_with": None, "fallen": []}).splitlines()
    assert lines[0].startswith("# ")
    rows = [line.split(" ") for line in lines[1:]]
    assert all(len(row) == 3 and float(row[1]) > 0 for row in rows)
    units = {name: unit for name, _, unit in rows}
    assert (units["encode/W=5"], units["step/call"], units["store/read"]) == ("samples/s", "us", "bytes/s")
    assert units["ratio/encode/W=5"] == "x"


def test_a_fall_is_an_exit_status(
    measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rcbht: CommandLine
) -> None:
    [record] = json.loads(measured.read_text())
    values = {name: (entry["value"], entry["unit"]) for name, entry in record["values"].items()}

    def measure(factor: float) -> Callable[[Any], Any]:
        return lambda _: (values, {name: factor * ratio for name, ratio in record["ratios"].items()})

    path = tmp_path / "history.json"
    without = {name: value for name, value in record.items() if name != "processor"}  # as before 0.2
    others = [{**record, "device": "other"}, {**record, "processor": "other"}, without]
    path.write_text(json.dumps([{**record, "ratios": {"step": 1e9}}, record, *others]))
    monkeypatch.setattr(bench, "measure", measure(0.85))
    assert f"no ratio has fallen by more than 20 % since {record['date']}" in rcbht(*SMALL, "--check", path)
    monkeypatch.setattr(bench, "measure", measure(0.75))
    assert "25 % below the earlier" in rcbht.ended(2, *SMALL, "--check", path, "--history", path).out
    assert [len(run["ratios"]) for run in json.loads(path.read_text())] == [1, 6, 6, 6, 6, 6]
    assert "has no run of 3 trials" in rcbht.refused(*SMALL[:2], "3", *SMALL[3:], "--check", path)


def test_a_ratio_that_is_gone_is_told() -> None:
    assert ratios.fallen({"a": 1.0, "new": 1.0}, {"a": 1.2, "b": 1.0}) == ["The ratio b is no longer measured."]


def test_the_two_calls_take_turns() -> None:
    made: list[str] = []
    ratios.interleaved(lambda: made.append("a"), lambda: made.append("b"), repeats=3)
    assert "".join(made) == "ab" * 4


@pytest.mark.parametrize("text", ["", "{", "[1]", '[{"ratios": {}}]', "{}x"])
def test_what_is_no_history_is_refused(text: str, tmp_path: Path, rcbht: CommandLine) -> None:
    path = tmp_path / "h.json"
    path.write_text(text)
    for words in (("--check", str(path)), ("--check", str(tmp_path / "none.json"))):
        assert rcbht.refused(*SMALL, *words).count("\n") == 1
    with pytest.raises(InputError, match="not a history"):
        ratios.append_record(path, {})
    assert path.read_text() == text


@pytest.mark.parametrize("words", [["--trials", "9" * 23], ["--samples", "9" * 23], ["--trials", "-1"]])
def test_sizes_that_no_memory_has_are_refused(words: list[str], rcbht: CommandLine) -> None:
    assert "expected at" in rcbht.refused("bench", *words)


def test_a_device_must_be_there(rcbht: CommandLine) -> None:
    if jax.default_backend() != "cpu":
        pytest.skip("an accelerator is there")
    assert "no accelerator" in rcbht.refused(*SMALL, "--device")


def test_a_comparison_or_a_file_that_is_in_vain_is_refused_before_measuring(
    measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rcbht: CommandLine
) -> None:
    monkeypatch.setattr(bench, "measure", lambda _: pytest.fail("it measured"))
    (tmp_path / "other.json").write_text("{}x")
    others = {
        "--check": [(measured, "has no run of 3 trials of 40 samples")],
        "--history": [
            (tmp_path, "is a folder"),
            (tmp_path / "none" / "x.json", "none is not a folder"),
            (tmp_path / "other.json", "is not a history"),
        ],
    }
    for option, cases in others.items():
        for path, sentence in cases:
            assert sentence in rcbht.refused("bench", "--trials", "3", "--samples", "40", option, path)


def test_an_interruption_while_it_compiles_ends_with_its_status() -> None:
    default = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # a shell may have ignored it
    code = f"{default}; from rcbht_jax.cli.main import script; script()"
    with subprocess.Popen(
        [sys.executable, "-c", code, "bench"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        env=as_users_compile() | {"JAX_ENABLE_COMPILATION_CACHE": "false"},
    ) as run:  # fmt: skip
        assert run.stderr is not None
        assert b"[1/" in run.stderr.readline()
        time.sleep(1.0)
        run.send_signal(signal.SIGINT)
        assert run.wait(timeout=60) == 130
