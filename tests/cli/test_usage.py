"""What helps to find a command: quick help, suggestions, completion, hints, progress, commands of other packages."""

from __future__ import annotations

import importlib.metadata
import io
import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from rcbht_jax.cli import commands, main
from rcbht_jax.cli.command import progress_bar
from rcbht_jax.cli.completion import options_of
from tests.cli.test_commands import synthetic
from tests.support.command_line import CommandLine

HEAVY = {"jax", "matplotlib", "mujoco", "optax", "rosbags", "scipy", "sklearn", "zarr"}
ALL_HELP = f"""
import contextlib, io, sys
from rcbht_jax.cli import main
for name in main.all_commands():
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main.main([*name.split(), "--help"]) == 0
    assert "Example: rcbht " + name in out.getvalue(), name
print(sorted({HEAVY!r} & set(sys.modules)))
"""


def cpu_seconds(*words: str) -> float:
    """Smaller CPU time of two runs of Python, which other processes on the machine hardly change."""
    times = []
    for _ in range(2):
        process = subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = status
        assert status == 0
        times.append(usage.ru_utime + usage.ru_stime)
    return min(times)


def test_no_help_imports_what_only_running_needs() -> None:
    done = subprocess.run([sys.executable, "-c", ALL_HELP], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


def test_help_is_as_quick_as_importing_jax() -> None:
    assert cpu_seconds("-m", "rcbht_jax", "calibrate", "--help") < 1.3 * cpu_seconds("-c", "import jax")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("encdoe x.zarr", "rcbht has no command 'encdoe x.zarr'; did you mean encode?"),
        ("plot mpa x.zarr", "did you mean plot map"),
        ("plot", "trial"),
        ("import hrio a b", "did you mean import hiro or"),
        ("import tests a.zarr", "has no command 'import tests'; did you mean import auto?"),
        ("simulat x.zarr", "did you mean simulate?"),
        ("qqqq", '"rcbht --help" lists the commands'),
        ("encode x.zarr --windw 5", "rcbht encode has no option --windw; did you mean --window?"),
        ("encode x.zarr --gate", "did you mean --no-gate"),
        ("train x.zarr --feature ngram", "did you mean --features?"),
        ("info x.zarr --jsn", "did you mean --json?"),
        ("train x.zarr --qqqq=1", '"rcbht train --help" lists the options'),
        ("train x.zarr --session A --session B", "--session is given twice; write all its values after one --session."),
        ("monitor fit x.zarr --where=skill=4 --where day=2", "--where is given twice"),
        ("train x.zarr --session --task states", "--session has no value; expected one or more."),  # not all of them
        ("stream x.zarr -m x.model --trial", "--trial has no value; expected one or more."),
        ("monitor fit x.zarr --where -o x.monitor", "--where has no value; expected one or more."),
        ("classify x.zarr --model m --source a -o o.csv --source=b", "--source is given twice"),
    ],
)
def test_mistyped_words_get_suggestions(words: str, sentence: str, rcbht: CommandLine) -> None:
    out, err = rcbht.ended(2, *words.split())
    assert sentence in out + err
    assert len(err.splitlines()) <= 1


def test_a_mistyped_second_word_of_a_command_gets_a_suggestion(rcbht: CommandLine) -> None:
    assert "did you mean fidelity fit?" in rcbht.refused("fidelity", "fitt", "x.zarr")
    assert '"rcbht fidelity --help" lists them' in rcbht.refused("fidelity", "--session", "x")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("encode x --window y", "--window is 'y'; expected a whole number."),
        ("simulate x --max-seconds=1s --trials 3", "--max-seconds is '1s'; expected a number."),
        ("encode x --latency_cap None", "--latency-cap is 'None'; expected a number."),
        ("calibrate x -o y --rungs 0.5 z", "--rungs is 'z'; expected a number."),
        ("train x --costs 1 -1 --seed 0.5", "--seed is '0.5'; expected a whole number."),
    ],
)
def test_other_words_in_place_of_numbers_are_refused(words: str, sentence: str, rcbht: CommandLine) -> None:
    assert rcbht.refused(*words.split()) == f"rcbht: {sentence}\n"


def test_a_positional_word_after_numbers_is_not_blamed_for_another_option(rcbht: CommandLine) -> None:
    assert "--rule" in (error := rcbht.refused("encode", "--tolerance", "0.1", "x", "--rule", "y"))
    assert "--tolerance is" not in error


@pytest.mark.parametrize(
    ("words", "same"),
    [
        ("encode --tolerance 0.1 -0.2 x", "encode x --tolerance 0.1 -0.2"),
        ("plot trial x --seconds 1 2 t -o y", "plot trial x t -o y --seconds 1 2"),
        ("encode x --window y --help", "encode --help"),
    ],
)
def test_words_after_numbers_may_be_positional_and_help_is_shown_all_the_same(
    words: str, same: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parsed = [
        main.parse(name := main.command_name(one.split()), one.split()[name.count(" ") + 1 :]) for one in (words, same)
    ]
    assert parsed[0] == parsed[1]
    assert ("usage: rcbht encode" in capsys.readouterr().out) == (parsed[0] is None)


@pytest.mark.parametrize(
    ("name", "former", "present"),
    [
        ("evaluate", "x --arms both", "x --arm both"),
        ("calibrate", "x -o t.json --ledger s.npz", "x -o t.json --checkpoint s.npz"),
        ("train-online", "x --tasks outcome --features relative", "x --task outcome --relative"),
        ("train-online", "x --features all --detect", "x --detect"),
        ("stream", "- --k=0.9 --bridge 0.1 --silent 2", "- --certainty 0.9 --max-gap 0.1 --timeout 2"),
        ("simulate", "--longest 3 -o x.zarr", "x.zarr --max-seconds 3"),
        ("report", "x -o r.html --most 3", "x -o r.html --max-trials 3"),
    ],
)
def test_former_spellings_of_options_mean_the_same(name: str, former: str, present: str) -> None:
    assert main.parse(name, former.split()) == main.parse(name, present.split())


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_has_every_command_and_option(shell: str, rcbht: CommandLine) -> None:
    script = rcbht("completion", shell)
    for name in main.all_commands():
        words = name.split()
        assert words[-1] in script
        for option in options_of(main.command_class(name)):
            assert (f"-l {option[2:]}" if shell == "fish" else option) in script


COMPLETED = [
    ("rcbht pl", "plot"),
    ("rcbht plot ", "trial beliefs map"),
    ("rcbht plot map --la", "--layer"),
    ("rcbht plot map x.zarr --layer ", "primitive mc llb"),
    ("rcbht encode x.zarr --robot b", "baxter"),
    ("rcbht train x.zarr --costs 1 2 --k", "--kernels"),
    ("rcbht encode ", ""),
    ("rcbht import hiro ", ""),
    ("rcbht fidelity --rec", "--recorded"),
    ("rcbht fidelity fit --rec", ""),
    ("rcbht completion ", "bash zsh fish"),
    ("rcbht --v", "--version"),
]
TYPED = 'COMP_WORDS=({words}); COMP_CWORD={last}; _rcbht; echo "${{COMPREPLY[*]}}"'
RUN = {  # each takes the script as $1
    "bash": ("bash", "-c", 'source "$1"; ' + TYPED, "-"),
    "zsh": ("zsh", "-f", "-c", "autoload -U compinit; compinit -u -D; source $1; emulate sh; " + TYPED, "-"),
    "fish": ("fish", "--no-config", "-c", "source $argv[1]; complete -C {typed}"),
}


def installed(shell: str) -> object:
    """A shell as a parameter, skipped where the machine has none."""
    return pytest.param(shell, marks=pytest.mark.skipif(not shutil.which(shell), reason=f"{shell} is not installed"))


@pytest.mark.parametrize("shell", list(map(installed, RUN)))
@pytest.mark.parametrize(("typed", "completions"), COMPLETED)
def test_shells_complete(shell: str, typed: str, completions: str, tmp_path: Path, rcbht: CommandLine) -> None:
    (tmp_path / "script").write_text(rcbht("completion", shell))
    words = typed.split(" ")
    known = {"words": " ".join(f'"{word}"' for word in words), "last": len(words) - 1, "typed": f"'{typed}'"}
    command = [word.format(**known) for word in RUN[shell]] + [str(tmp_path / "script")]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path)
    lines = done.stdout.splitlines() if shell == "fish" else done.stdout.split()
    found = [line.split("\t")[0] for line in lines if line.startswith(words[-1])]  # zsh leaves this to its caller
    assert set(found) - {"script"} == set(completions.split())  # fish adds files where a command takes them
    assert not done.stderr


def test_zsh_takes_no_word_for_a_modifier(rcbht: CommandLine) -> None:
    assert not re.search(r"\{[^}]*:[A-Za-z]", rcbht("completion", "zsh"))  # where no zsh is installed


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ("info no.zarr", "rcbht import auto FOLDER no.zarr"),
        ("evaluate STORE", "rcbht encode STORE"),
        ("classify STORE -m no.model", "rcbht train STORE.zarr -o no.model"),
        ("stream STORE -m no.model", "rcbht train-online STORE.zarr -o no.model"),
        ("report STORE -o r.html -m no.model", "rcbht train-online STORE.zarr -o no.model"),
        ("encode STORE --thresholds no.json", "rcbht calibrate STORE.zarr -o no.json"),
        ("simulate new.zarr --physical no.json", "rcbht fidelity fit HIRO.zarr -o no.json"),
        ("fidelity fit no.zarr -o f.json", "rcbht import hiro DIR no.zarr"),
    ],
)
def test_what_is_missing_is_named_with_the_command_that_makes_it(
    words: str, hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rcbht: CommandLine
) -> None:
    from rcbht_jax.io.store import write_recordings

    monkeypatch.chdir(tmp_path)
    write_recordings(Path("STORE"), synthetic(), {})
    assert f'"{hint}"' in rcbht.refused(*words.split())


def test_progress_is_shown_on_terminals_only(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    for stream, shown in ((io.StringIO(), False), (Terminal(), True)):
        monkeypatch.setattr(sys, "stderr", stream)
        with progress_bar("encode", "trials", total=3) as bar:
            bar.update(3)
        assert ("encode: 100%" in stream.getvalue()) == shown


def test_another_package_brings_commands_by_an_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "simulate" in main.all_commands()
    assert not any("sim_mjx" in target for target, _ in commands.COMMANDS.values())
    entry = EntryPoint("other", "json:encoder.ESCAPE_DCT", main.GROUP)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry] if group == main.GROUP else [])
    main.all_commands.cache_clear()
    try:
        names = set(main.all_commands())
    finally:
        monkeypatch.undo()
        main.all_commands.cache_clear()
    assert names == {*commands.COMMANDS, *entry.load()}
