"""Compiled programs outlive the process that compiled them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import jax
import pytest

from rcbht_jax._util import compile_cache
from rcbht_jax.errors import InputError
from rcbht_jax.introspection import model as model_files
from tests.support.compiler import as_users_compile
from tests.support.introspection_models import model

PROGRAM = """
import sys
from pathlib import Path
import jax
from rcbht_jax._util import compile_cache
compile_cache.SLOW = 0.0
compile_cache.use(Path(sys.argv[1]))
seen = []
jax.monitoring.register_event_listener(lambda name, **_: seen.append(name))
jax.jit(lambda x: jax.numpy.sin(x) + 1.0)(jax.numpy.ones(3)).block_until_ready()
print("/jax/compilation_cache/cache_hits" in seen)
"""


def test_the_second_process_finds_the_programs_of_the_first(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "cache"
    hits = [
        subprocess.run([sys.executable, "-c", PROGRAM, str(folder)], check=True, capture_output=True, text=True).stdout
        for _ in range(2)
    ]
    assert [hit.strip() for hit in hits] == ["False", "True"]


def test_a_program_cut_off_is_replaced_without_a_warning(tmp_path: Path) -> None:
    """As a killed process or a full disk leaves it; JAX would keep it, and warn in each later process."""
    command = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    subprocess.run(command, check=True)
    for stored in tmp_path.glob("*-cache"):
        stored.write_bytes(stored.read_bytes()[:100])
    said = [subprocess.run(command, check=True, capture_output=True, text=True) for _ in range(2)]
    assert [run.stdout.strip() for run in said] == ["False", "True"]
    assert [run.stderr for run in said] == ["", ""]


def test_other_warnings_are_shown(tmp_path: Path) -> None:
    code = "compile_cache.use(Path(sys.argv[1])); import warnings; warnings.warn('something else')"
    command = [sys.executable, "-c", PROGRAM.partition("compile_cache.SLOW")[0] + code, str(tmp_path)]
    said = subprocess.run(command, check=True, capture_output=True, text=True)
    assert "something else" in said.stderr


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be created"):
        compile_cache.use(tmp_path / "file" / "cache")


@pytest.mark.parametrize("home", ["file", ""])
def test_without_a_writable_home_there_is_no_cache(home: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    (tmp_path / "file").write_text("")
    before = jax.config.jax_compilation_cache_dir
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / home) if home else "")
    monkeypatch.setattr(Path, "home", homeless)
    compile_cache.use()
    assert jax.config.jax_compilation_cache_dir == before


def test_the_default_folder_is_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compile_cache.default_folder() == tmp_path / "rcbht-jax"


LIGHT = """
import sys
from rcbht_jax.introspection import introspector, model, session
from rcbht_jax.io import messages, playback, rosbags
from rcbht_jax.report import live_page
print(sorted({"sklearn", "pandas", "matplotlib", "scipy.stats"} & set(sys.modules)))
"""


def test_a_stream_starts_without_what_only_training_needs() -> None:
    said = subprocess.run([sys.executable, "-c", LIGHT], check=True, capture_output=True, text=True).stdout
    assert said.strip() == "[]"


def test_a_stream_keeps_its_chain(tmp_path: Path) -> None:
    """The command finds the chain that an earlier start compiled."""
    model_files.save(tmp_path / "m", model())
    (tmp_path / "in.jsonl").write_text(('{"wrench": [0, 0, 0, 0, 0, 0]}\n') * 20)
    command = [sys.executable, "-m", "rcbht_jax", "stream", "-", "-m", str(tmp_path / "m")]
    command += ["--compile-cache", str(tmp_path / "cache"), "--json"]
    # As users compile: without optimisation (conftest.py) the chain is made too fast to be worth keeping.
    env, times = as_users_compile(), []
    for _ in range(2):
        with (tmp_path / "in.jsonl").open("rb") as lines:
            subprocess.run(command, check=True, capture_output=True, stdin=lines, env=env)
        times.append([path.stat().st_mtime_ns for path in sorted((tmp_path / "cache").glob("jit_infer*-cache"))])
    assert len(times[0]) == 1
    assert times[0] == times[1]
