"""Tests of equal bits once more, compiled as users compile: for all others conftest.py switches optimisation off."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from tests.support.compiler import as_users_compile

ROOT = Path(__file__).resolve().parents[2]
# What fusion, fused multiply-add or another order of a sum would break: golden labels, stream against batch, a trial
# alone against the same in a batch; and memory that fusion saves.
EXACT = (
    "encoding/test_encoder_golden.py::test_double_precision_equals_the_golden_labels[5]",
    "encoding/test_encoder.py::test_any_chunking_equals_the_batch_bit_for_bit",
    "encoding/test_encoder.py::test_a_stream_of_one_axis_equals_the_batch_bit_for_bit",
    "encoding/test_encoder.py::test_working_memory_is_at_most_six_times_the_wrench",
    "encoding/test_fit.py::test_any_chunking_equals_the_batch_bit_for_bit[float32]",
    "encoding/test_fit.py::test_a_recording_of_one_axis_equals_itself_beside_another_bit_for_bit[float32]",
    "encoding/test_fit.py::test_a_recording_of_one_axis_equals_itself_beside_another_bit_for_bit[float64]",
    "sim/synthesis/test_pipeline.py::test_physics_of_a_trial_does_not_depend_on_its_batch",
)


def test_bits_are_equal_with_the_compiler_of_the_users() -> None:
    env = {name: value for name, value in as_users_compile().items() if not name.startswith("PYTEST_")}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *(f"tests/{name}" for name in EXACT)]
    done = subprocess.run(
        command, cwd=ROOT, env={**env, "RCBHT_STANDARD_COMPILER": "1"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    counts = re.search(r"(\d+) passed(?:, (\d+) skipped)?", done.stdout)
    assert counts, done.stdout
    assert sum(int(count or 0) for count in counts.groups()) == len(EXACT)  # golden data may be absent


def test_words_that_fit_keep_up_with_a_sensor_of_1_khz() -> None:
    """A step of straight-line code over so many samples took minutes: fused, each repeated all before it."""
    code = (
        "import numpy as np, rcbht_jax as rj\n"
        "from rcbht_jax.encoding.fit import FitConfig\n"
        "from rcbht_jax.encoding.tolerance import FitLimits\n"
        "limits = FitLimits(np.tile([4.0, 3, 2, 1], (2, 1)), np.full(2, 0.1))\n"
        "print(len(rj.Encoder(FitConfig(5, 0.001), limits).push(np.zeros((500, 2)))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=as_users_compile(), capture_output=True, text=True, timeout=120,
        check=True,
    )  # fmt: skip
    assert done.stdout.split() == ["100"]
