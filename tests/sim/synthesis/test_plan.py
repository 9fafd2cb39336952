"""The manifest: what it covers, and that it is plain JSON."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterable
from copy import copy
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from rcbht_jax.errors import InputError
from sim_mjx.assemblies.latch import LatchVariation
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario
from sim_mjx.synthesis import plan, shards
from sim_mjx.synthesis.pipeline import synthesise
from sim_mjx.synthesis.plan import SynthesisConfig, job_of, manifest_of
from tests.support.fake_simulation import SMALL, fake_engine


def test_the_digest_of_the_code_covers_what_trials_depend_on(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = list[str]()

    def note(root: Path, paths: Iterable[Path]) -> str:
        seen.extend(path.relative_to(root).as_posix() for path in paths if path.is_file())
        return ""

    monkeypatch.setattr(plan, "files_hash", note)
    plan.code_hash.__wrapped__()
    assert seen == sorted(seen)
    # kinematics, stored starts, and options of the compiler
    for name in ("robots/kinematics.py", "io/hiro/onsets.py", "_util/compiling.py"):
        assert f"rcbht_jax/{name}" in seen
    assert {f"sim_mjx/{name}" for name in ("own_files.py", "synthesis/records.py", "engines/native.py")} <= set(seen)


def with_spec(**values: Any) -> SynthesisConfig:
    """A job whose distributions have values of any type, which the annotations of the tests' run refuse."""
    spec = copy(get_scenario("clip@panda").spec())
    for name, value in values.items():
        object.__setattr__(spec, name, value)
    return SynthesisConfig("clip@panda", 2, spec=spec)


def test_arrays_and_numpys_numbers_are_plain_in_the_manifest() -> None:
    found = manifest_of(with_spec(shift=np.array([-1e-3, 1e-3]), lean=jnp.zeros(2), turn=(np.float32(0), np.int64(1))))
    spec = json.loads(json.dumps(found))["job"]["spec"]
    assert (spec["shift"], spec["lean"], spec["turn"]) == ([-1e-3, 1e-3], [0.0, 0.0], [0.0, 1])
    assert manifest_of(SMALL)["job"] == asdict(SMALL)  # as existing work folders have it


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (lambda: 0, r"spec.shift of the job is <function .*; expected finite numbers, words, or lists of them"),
        ((0.0, 1j), r"spec.shift\[1\] of the job is 1j"),
        ({1: 2}, r"spec.shift of the job is \{1: 2\}"),
        (np.array([0.0, np.nan]), r"spec.shift\[1\] of the job is nan"),
    ],
    ids=["function", "complex", "keys", "nan"],
)
def test_what_a_manifest_cannot_hold_is_named(value: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        manifest_of(with_spec(shift=value))


OWN = """from dataclasses import dataclass, field, replace
import numpy as np
from sim_mjx.assemblies.clip import CLIP
from sim_mjx.assemblies.latch import LatchVariation
@dataclass(frozen=True)
class Sizes:
    small: float = 0.7e-3
    ends: tuple[float, ...] = (1.0, 2.0)
@dataclass(frozen=True)
class Vary(LatchVariation):
    weights: np.ndarray = field(default_factory=lambda: np.array([1, 2], np.int32))
    sizes: Sizes = Sizes()
    every: tuple[Sizes, ...] = (Sizes(), Sizes())
    levels: list[float] = field(default_factory=lambda: [1.0, 2.0])
    named: dict[str, tuple[float, ...]] = field(default_factory=lambda: {"one": (1.0, 2.0)})
ARR = replace(CLIP, name="arr", variation=Vary)
"""


@pytest.mark.parametrize("weights", [np.array([3, 4], np.int32), np.array([0.2, 0.8])])
def test_distributions_with_arrays_and_dataclasses_come_back_as_they_were(tmp_path: Path, weights: Any) -> None:
    (tmp_path / "own.py").write_text(OWN)
    name = f"{tmp_path}/own.py:ARR@panda"
    spec = get_scenario(name).spec(weights=weights, shift=(0.0, 1e-3))
    job = SynthesisConfig(name, 2, spec=spec)
    again = job_of(json.loads(json.dumps(plan.provenance(manifest_of(job))["job"]))).spec
    assert (again.weights.tolist(), again.weights.dtype) == (weights.tolist(), weights.dtype)
    assert replace(again, weights=weights) == replace(spec, weights=weights)


@dataclass(frozen=True)
class Wider(LatchVariation):
    ends: Any = None


def test_a_distribution_that_cannot_be_written_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"spec\.ends of the job is \{1\}"):
        synthesise(tmp_path / "x.zarr", SynthesisConfig("clip@panda", 2, spec=Wider(ends={1})))
    assert not list(tmp_path.iterdir())


def test_numpys_counts_are_numbers(tmp_path: Path) -> None:
    job, unchecked = object.__new__(SynthesisConfig), inspect.unwrap(SynthesisConfig.__init__)
    unchecked(job, "B", np.int64(2), np.uint8(5), "native", np.int32(1), DomainRandomization(), np.int64(5))
    assert [type(one) for one in (job.trials, job.seed, job.shard, job.window)] == [int] * 4
    shards.begin(tmp_path / "x.work", manifest_of(job))
    assert synthesise(tmp_path / "y.zarr", replace(job, window=None), simulate=fake_engine).stored == 2
