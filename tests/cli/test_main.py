"""The command line: exit status, one sentence for every mistake, machine-readable results."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given

from rcbht_jax.cli import main
from rcbht_jax.cli.command import Command
from rcbht_jax.cli.completion import COMMON, options_of
from rcbht_jax.errors import InputError
from tests.support.command_line import CommandLine


@pytest.mark.parametrize("words", [["--help"], ["-h"], ["import", "--help"], ["--version"]])
def test_help_is_status_zero(words: list[str], rcbht: CommandLine) -> None:
    assert rcbht(*words)


@pytest.mark.parametrize("name", list(main.all_commands()))
def test_help_has_an_example_flows_and_names_only_options_that_are_there(
    name: str, rcbht: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """tyro keeps line breaks of docstrings: a text of several lines belongs into ``option``."""
    monkeypatch.setenv("COLUMNS", "1000")  # nothing else breaks a line
    out = rcbht(*name.split(), "--help")
    assert f"Example: rcbht {name}" in out
    assert "--json" in out
    text = " ".join(re.sub("[│╭╮╰╯─]", " ", out).split())
    assert not re.search(r"None\b|\(default: (''|)\)|STORE.zarr store \(", text), "a default or a help text is missing"
    own = {*options_of(main.command_class(name)), *COMMON, "--out"}
    of_others = re.sub(r'"rcbht [^"]*"|\(train-online --detect\)|Example: rcbht [^-]*', " ", text)
    assert set(re.findall(r"--[a-z][a-z-]*", of_others)) <= own
    lines = [line.strip("│").rstrip() for line in out.splitlines()]
    for before, line in pairwise(lines):
        if line.startswith(" " * 12):  # help below a long name of an option, whose own line holds no help
            assert re.match("-|[A-Z]", before.strip())
            assert "  " not in before.strip(), line


def test_a_warning_is_a_sentence() -> None:
    """Python's own form names a file and quotes a line of code."""
    code = (
        "import warnings; from rcbht_jax.cli import main; "
        "main.main = lambda: warnings.warn('No font.') or 0; main.script()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stderr == "rcbht: No font.\n"


def test_overview_imports_no_command() -> None:
    code = (
        "import sys; from rcbht_jax.cli import main; assert main.main(['--help']) == 0; "
        "sys.exit(any(m in sys.modules for m in ('jax', 'numpy', 'tyro', 'zarr')))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["nonsense"], "no command 'nonsense'"),
        (["info"], "options are wrong"),
        (["info", "missing.zarr"], "does not exist"),
        (["info", "x", "--nope"], "has no option --nope"),
        (["import", "hiro", "missing", "out.zarr"], "is not a folder"),
        (["import", "hiro", ".", "no/such/place/out.zarr"], "create it first"),
        (["import", "hiro", "a" * 5000, "out.zarr"], "cannot be used"),
    ],
)
def test_wrong_input_is_one_sentence_and_status_two(
    words: list[str], sentence: str, rcbht: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out, err = rcbht.ended(2, *words)
    assert out == ""
    last = err.splitlines()[-1]
    assert last.startswith("rcbht: ")
    assert sentence in last
    assert len(last) < 2050  # whatever it quotes


def test_import_then_info(hiro_dir: Path, tmp_path: Path, rcbht: CommandLine) -> None:
    out = str(tmp_path / "two.zarr")
    assert len(rcbht.json("import", "hiro", hiro_dir / "SIM_HIRO_TWO_SA_SUCCESS", out)["imported"]) == 30
    assert "--overwrite" in rcbht.refused("import", "hiro", hiro_dir / "SIM_HIRO_TWO_SA_SUCCESS", out)
    info = rcbht.json("info", out)
    assert [(g["arm"], g["recordings"]) for g in info["groups"]] == [("R", 15), ("L", 15)]
    assert info["annotations"]["states"] == {
        "approach": [30, 30], "rotation": [30, 30], "insertion": [30, 30], "mating": [26, 26],
    }  # fmt: skip
    text = rcbht("info", out)
    assert "30 recordings of Fx (N), " in text
    assert "task states: approach (15), rotation (15), insertion (15), mating (13)" in text
    assert "annotations states: approach (30 in 30 recordings), " in text
    assert len(info["trials"]) == 15  # once for both arms
    assert f"trials: {', '.join(info['trials'][:5])} and 10 more\n" in text


@pytest.mark.parametrize(
    ("error", "status", "sentence"),
    [
        (KeyboardInterrupt(), 130, "Interrupted"),
        (OSError(errno.ENOSPC, "No space left on device"), 1, "disk is full"),
        (MemoryError(), 2, "The memory does not suffice; use fewer"),
        (MemoryError("Unable to allocate 7 TiB"), 2, "does not suffice (Unable to allocate 7 TiB); use"),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), 1, "disk is full"),
        (OSError(errno.EFBIG, "File too large"), 1, "largest size that the system allows (ulimit -f)"),
        (PermissionError(errno.EACCES, "Permission denied", "x.zarr"), 2, "x.zarr cannot be used"),
        (
            PermissionError(errno.EACCES, "Permission denied", ".x.partial-0123456789ab.zarr"),
            2,
            "x.zarr cannot be used",
        ),
        (InputError("a\nb.zarr is damaged."), 2, "rcbht: a\\nb.zarr is damaged."),
    ],
)
def test_interruptions_end_in_a_sentence(
    error: BaseException, status: int, sentence: str, rcbht: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Failing(Command):
        def run(self) -> dict[str, object]:
            raise error

        def text(self, result: dict[str, object]) -> str:
            return ""

    monkeypatch.setattr(main, "parse", lambda name, words: Failing())
    assert sentence in rcbht.ended(status, "info").err


LOSES = {  # what is raised there is lost
    "collector": "gc.callbacks.append(lambda phase, info: hit())\nbody = gc.collect",
    "destructor": "Thing = type('Thing', (), {'__del__': lambda self: hit()})\nbody = lambda: [Thing()].clear()",
    "import": "def body():\n    try:\n        hit()\n    finally:\n        raise ImportError('of a C extension')",
    "own code": "body = hit",
}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("where", LOSES)
def test_a_signal_ends_the_command_wherever_it_comes(where: str, number: int) -> None:
    code = (
        "import gc, os, signal, sys, time\n"
        "from rcbht_jax.cli import main\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"  # nohup ignores it, for what it starts as well
        "todo = [1]\n"
        f"def hit():\n    if todo:\n        todo.pop()\n        os.kill(os.getpid(), {number})\n"
        "    return sum(range(1000))\n"
        f"{LOSES[where]}\n"
        "main._dispatch = lambda words: (body(), time.sleep(6), 0)[2]\n"
        "start = time.monotonic()\nstatus = main.main([])\n"
        "assert time.monotonic() - start < 4 and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL\n"
        "assert sys.unraisablehook is sys.__unraisablehook__\nsys.exit(status)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert run.returncode == 128 + number, run.stderr
    assert run.stderr.splitlines() == ["rcbht: Interrupted."]


def test_what_fails_while_a_recording_is_finished_is_not_hidden(
    rcbht: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(words: list[str]) -> int:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except KeyboardInterrupt:
            raise InputError("out.mcap cannot be written: the disk is full.") from None
        return 0

    monkeypatch.setattr(main, "_dispatch", stopped)
    error = rcbht.ended(128 + signal.SIGTERM).err
    assert error == "rcbht: Interrupted; out.mcap cannot be written: the disk is full.\n"


@pytest.mark.parametrize(
    ("command", "kept"),
    [
        ("info", "no incomplete file was left, and what a stream had recorded is kept"),
        ("simulate", "what is finished is kept, and the same command resumes"),
        ("fidelity", "what is finished is kept, and the same command resumes"),
        ("fidelity fit", "what is finished is kept, and the same command resumes"),
        ("calibrate", "the scores so far are in scores.json, and the same command resumes"),
        ("calibrate", "no incomplete file was left, and what a stream had recorded is kept"),  # before the first scores
    ],
)
def test_an_interrupted_command_says_what_is_kept(
    command: str, kept: str, tmp_path: Path, rcbht: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = str(tmp_path)
    words = {
        "info": [store], "simulate": ["out.zarr"], "fidelity": ["--out", "out"],
        "fidelity fit": [store, "--out", "out.json"],
        "calibrate": [store, "--out", "out.json", "--method", "search", "--checkpoint", "scores.json"],
    }[command]  # fmt: skip

    def interrupted(self: Command) -> dict[str, object]:
        if "scores.json" in kept:
            (tmp_path / "scores.json").touch()
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main.command_class(command), "run", interrupted)
    assert rcbht.ended(128 + signal.SIGINT, *command.split(), *words).err == f"rcbht: Interrupted; {kept}.\n"


def test_what_else_a_destructor_raises_is_reported_as_before() -> None:
    def fails(self: object) -> None:
        raise ValueError("else")

    reported = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "unraisablehook", lambda unraisable: reported.append(str(unraisable.exc_value)))
        with main.endings():
            type("Thing", (), {"__del__": fails})()
    assert reported == ["else"]


def test_closed_output_is_no_traceback(hiro_store: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    code = "import sys; from rcbht_jax.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "info", str(hiro_store)]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert done.returncode == 1
    assert done.stderr == b""


# No slash: nothing outside the test's own folder may be read or written.
WORDS = st.one_of(
    st.sampled_from(["import", "hiro", "info", "--json", "--help", "--overwrite", "-h", "--", ".", "x.zarr"]),
    st.text(st.characters(exclude_characters="/~", exclude_categories=("Cs",)), max_size=8),
)


@given(words=st.lists(WORDS, max_size=5))
def test_any_words_end_in_status_zero_or_two(words: list[str], tmp_path_factory: pytest.TempPathFactory) -> None:
    before = Path.cwd()
    os.chdir(tmp_path_factory.getbasetemp())
    try:
        assert main.main(words) in (0, 2)
    finally:
        os.chdir(before)


def test_names_do_not_steer_the_terminal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, rcbht: CommandLine) -> None:
    monkeypatch.chdir(tmp_path)
    assert "rcbht: \\x1b]0;owned\\x07\\u202egnp.zarr" in rcbht.refused("info", "\x1b]0;owned\x07\u202egnp.zarr")


def test_names_that_a_terminal_cannot_show_are_spelled_out(tmp_path: Path) -> None:
    code = "import sys; from rcbht_jax.cli.main import main; sys.exit(main(['info', 'Gr\\xf6\\xdfe\\udcff.zarr']))"
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=False, env=os.environ | {"PYTHONIOENCODING": "ascii"}
    )
    assert run.returncode == 2
    assert rb"Gr\xf6\xdfe" in run.stderr
    assert b"Traceback" not in run.stderr


def test_text_that_cannot_be_written_is_one_sentence(monkeypatch: pytest.MonkeyPatch, rcbht: CommandLine) -> None:
    """Half a surrogate pair in somebody's names, wherever on its way into a file it is noticed."""

    def write(words: list[str]) -> int:
        "a\ud800b".encode()
        return 0

    monkeypatch.setattr(main, "_dispatch", write)
    assert rcbht.refused("info") == "rcbht: A text holds '\\ud800', which is not valid Unicode.\n"


@pytest.mark.parametrize("command", ["evaluate", "train", "train-online", "segment", "monitor fit", "calibrate"])
@pytest.mark.parametrize("below", [True, False])
def test_seeds_that_no_generator_takes_are_refused(
    command: str, below: bool, tmp_path: Path, rcbht: CommandLine
) -> None:
    most = 2**31 - 1 if command == "evaluate" else 2**32 - 1
    seed = -1 if below else most + 1
    out = [] if command in ("evaluate", "segment") else ["-o", str(tmp_path / "out")]
    error = rcbht.refused(*command.split(), tmp_path, *out, f"--seed={seed}")
    assert f"--seed is {seed}; expected 0 to {most}" in error


@pytest.mark.parametrize("command", ["train", "train-online", "segment", "classify -m M", "monitor fit", "calibrate"])
@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("missing/x.csv", "missing is not a folder; create it first"),
        ("file/x.csv", "file is not a folder"),
        ("link.csv", "missing is not a folder"),
        ("folder.csv", "folder.csv is a folder; choose a name for a file."),
    ],
)
def test_files_that_cannot_be_made_are_refused_before_the_work(
    command: str, name: str, sentence: str, tmp_path: Path, rcbht: CommandLine
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "link.csv").symlink_to(tmp_path / "missing" / "x.csv")
    model = [str(tmp_path / "file") if word == "M" else word for word in command.split()]
    assert sentence in rcbht.refused(*model, tmp_path, "-o", tmp_path / name)


def test_a_home_that_cannot_be_written_to_is_no_remark(hiro_store: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    words = [sys.executable, "-m", "rcbht_jax", "plot", "trial", str(hiro_store), "nothing", "-o", "x.png"]
    surroundings = {**os.environ, "MPLCONFIGDIR": str(tmp_path / "file" / "none")}
    run = subprocess.run(words, env=surroundings, cwd=tmp_path, capture_output=True, text=True)
    assert [line[:7] for line in run.stderr.splitlines()] == ["rcbht: "]
