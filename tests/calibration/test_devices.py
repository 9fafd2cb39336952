"""Work that is shared among devices gives what one of them gives."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rcbht_jax._util.devices import wanted
from rcbht_jax.errors import InputError

ROOT = Path(__file__).resolve().parents[2]


def test_two_devices_give_the_results_of_one() -> None:
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"
    # with as few threads as a small machine has cores, two devices wait for each other's
    env = {**os.environ, "XLA_FLAGS": flags.strip(), "NPROC": "8", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.two_devices"], cwd=ROOT, env=env, capture_output=True, text=True,
        timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]


def test_the_option_asks_for_devices_that_are_there() -> None:
    assert [wanted("all", 3), wanted("2", 3), wanted("1", 0), wanted("all", 0)] == [3, 2, 1, 0]
    for wrong, sentence in {"0": "expected", "-1": "expected", "some": "expected", "4": "expected at most 3"}.items():
        with pytest.raises(InputError, match=sentence):
            wanted(wrong, 3)
