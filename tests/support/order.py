"""The longest files of tests, which begin first: at the end of a run no worker waits long for another."""

from __future__ import annotations

LONGEST = (  # over half a minute each on two cores without the longest tests, the longest first
    "tests/sim/synthesis/test_resume.py",
    "tests/sim/engines/test_engines.py",
    "tests/project/test_examples.py",
    "tests/sim/synthesis/test_pipeline.py",
    "tests/project/test_docs.py",
    "tests/encoding/test_encoder.py",
    "tests/sim/engines/test_lanes.py",
    "tests/reference/test_golden.py",
    "tests/sim/assemblies/test_assembly_stores.py",
    "tests/plots/test_plots.py",
    "tests/encoding/test_fit.py",
)


def place(name: str) -> int:
    """Sorts the name of a test: by its file if that is long, and after all long ones otherwise."""
    file = name.partition("::")[0]
    return LONGEST.index(file) if file in LONGEST else len(LONGEST)
