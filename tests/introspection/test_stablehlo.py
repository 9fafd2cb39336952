"""The exported chain says what the introspector says, in a process that cannot import this package."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax._util.optional import require
from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief
from rcbht_jax.introspection import stablehlo
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import load
from rcbht_jax.introspection.stablehlo import write_chain
from tests.support.introspection_models import few_axes, model, trial

EXAMPLE = Path(__file__).resolve().parents[2] / "examples/run_chain.py"


def test_runs_without_this_package(tmp_path):
    meta = write_chain(tmp_path / "c", model())
    assert [head["name"] for head in meta["heads"]] == ["states", "outcome", "failure-type"]
    wrench = np.concatenate([trial(0, 70, 102), trial(1, 71, 98)])
    lines = [json.dumps({"wrench": row}) for row in wrench.astype(float).tolist()]
    lines.insert(102, '{"begin": true}')
    blocked = "import sys; sys.modules['rcbht_jax'] = None; import runpy; sys.argv = sys.argv[1:]; "
    done = subprocess.run(
        [sys.executable, "-c", blocked + "runpy.run_path(sys.argv[0], run_name='__main__')", str(EXAMPLE), "c"],
        input="\n".join(lines), capture_output=True, text=True, cwd=tmp_path, timeout=300, check=True,
    )  # fmt: skip
    said = [json.loads(line) for line in done.stdout.splitlines()]
    introspector = Introspector(model(), rate=None)
    events = introspector.push(wrench[:102]) + introspector.begin() + introspector.push(wrench[102:])
    beliefs = [e for e in events if isinstance(e, Belief)]
    assert len(said) == 40
    for belief in beliefs:
        row = said[belief.sample // 5 - 1]
        assert row["sample"] == belief.sample
        np.testing.assert_allclose(list(row[belief.head].values()), belief.probabilities, atol=2e-4)


def test_any_axes_trials_and_what_stands_on_one_line(tmp_path):
    """A reading beside "begin" was lost, "reset" and two axes were tracebacks."""
    two = few_axes(2)
    meta = write_chain(tmp_path / "c", two, ("cpu",))
    assert (meta["axes"], meta["units"]) == (["axis0", "axis1"], ["", ""])
    wrench = trial(1, 71, 40)[:, :2]
    lines = [{"wrench": row} for row in wrench.astype(float).tolist()]
    lines[12]["begin"] = lines[23]["reset"] = True
    lines[30:30] = [{"wrench": [np.nan, 0.0]}, {"wrench": [1.5]}]  # would stay in the state, would be broadcast
    lines[20:20] = [{"wrench": bad} for bad in (["a", 1.0], [[1.0], 2.0], {"Fx": 1.0}, None)]  # were tracebacks
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), "c"],
        input="\n".join([*map(json.dumps, lines), "", "[]", '{"wrench": [1.0, ']),  # each of these was a traceback
        capture_output=True, text=True, cwd=tmp_path, timeout=300, check=True,
    )  # fmt: skip
    assert done.stderr.count("left out: ") == 9
    introspector = Introspector(two, rate=None)
    events = introspector.push(wrench[:12]) + introspector.begin() + introspector.push(wrench[12:23])
    introspector.reset()
    beliefs = [event for event in events + introspector.push(wrench[23:]) if isinstance(event, Belief)]
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["sample"] for row in said] == [belief.sample for belief in beliefs] == [5, 10, 15, 20, 5, 10, 15]
    for row, belief in zip(said, beliefs, strict=True):
        np.testing.assert_allclose(list(row["states"].values()), belief.probabilities, atol=2e-4)


def test_artefact_is_whole_or_absent(tmp_path):
    with pytest.raises(InputError):
        write_chain(tmp_path / "none" / "c", model())
    with pytest.raises(InputError, match="abacus"):
        write_chain(tmp_path / "c", model(), ("abacus",))
    assert not list(tmp_path.iterdir())
    write_chain(tmp_path / "c", model(), ("cpu",))
    with pytest.raises(InputError, match='was made by "rcbht export-model"; this needs a file of "rcbht train-online"'):
        load(tmp_path / "c")
    with zipfile.ZipFile(tmp_path / "c") as archive:
        assert archive.testzip() is None
        assert b"rcbht-chain-1" in archive.read("chain.json")


def test_a_missing_package_is_named_in_one_sentence(tmp_path, monkeypatch):
    """The sentence became part of another one, and ended with two full stops."""
    monkeypatch.setattr(stablehlo, "export_chain", lambda *_: require("missing", "export"))
    with pytest.raises(InputError, match=r'^missing is not installed: pip install "rcbht-jax\[export\]"\.$'):
        write_chain(tmp_path / "c", model())
