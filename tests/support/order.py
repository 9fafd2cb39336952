"""The longest files of tests, which begin first: at the end of a run no worker waits long for another."""

from __future__ import annotations

LONGEST = (  # over a minute each on two cores, the longest first
    "tests/project/test_docs.py",
    "tests/project/test_standard_compiler.py",
    "tests/reference/test_published_golden.py",
    "tests/sim/synthesis/test_resume.py",
    "tests/cli/test_stream.py",
    "tests/sim/validation/test_replay.py",
    "tests/sim/engines/test_engines.py",
    "tests/sim/validation/test_fidelity.py",
    "tests/sim/env/test_physics.py",
    "tests/sim/assemblies/test_assemblies.py",
    "tests/cli/test_from_file.py",
    "tests/util/test_compile_cache.py",
)


def place(name: str) -> int:
    """Sorts the name of a test: by its file if that is long, and after all long ones otherwise."""
    file = name.partition("::")[0]
    return LONGEST.index(file) if file in LONGEST else len(LONGEST)
