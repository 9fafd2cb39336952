"""What a synthesis simulates: the job, and the manifest of everything that determines its shards."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from numpy.typing import NDArray

import rcbht_jax
from rcbht_jax._util.digest import content_hash, files_hash
from rcbht_jax._util.untrusted import MAX_FILES, MAX_ROWS
from rcbht_jax.encoding import thresholds
from rcbht_jax.encoding.choices import plain
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.rules import made_by
from rcbht_jax.errors import InputError
from sim_mjx import engines
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import Scenario, get_scenario, own_files

ROBOT = "hiro"  # its threshold preset labels the trials
# Widest first; the names of NumPy before 2.4, and since.
_WIDEST = {
    "AVX-512": {"AVX512_SKX", "X86_V4"}, "AVX2": {"AVX2", "X86_V3"}, "AVX": {"AVX"}, "SVE": {"SVE"}, "NEON": {"ASIMD"},
}  # fmt: skip
_OF_THE_LIBRARY = ("_util/compiling.py", "io/hiro/onsets.py")  # what trials and their stored starts depend on
MOST = MAX_ROWS // 2  # trials, of up to two arms, a row of the store each


@dataclass(frozen=True)
class SynthesisConfig:
    """What to simulate."""

    preset: str  # see ``sim_mjx.registry``
    trials: int
    seed: int = 0
    engine: str = "native"
    shard: int = 256  # trials per shard
    spec: Any = field(default_factory=DomainRandomization)  # or the assembly's own distributions
    window: int | None = None  # samples per window of the labels, which have HIRO's thresholds; None = no labels

    def __post_init__(self) -> None:
        for name in ("trials", "seed", "shard", "window"):
            object.__setattr__(self, name, plain(getattr(self, name)))  # JSON does not know NumPy's numbers


def check(job: SynthesisConfig) -> Scenario:
    """The scenario of a job that can be simulated.

    Raises:
        InputError: unknown preset or engine, a count below one, a bad seed or distribution, or labels of an assembly
            that HIRO's thresholds do not fit.
    """
    for name, value in (("number of trials", job.trials), ("shard's number of trials", job.shard)):
        if value < 1:
            raise InputError(f"The {name} is {value}; expected 1 or more.")
    if job.trials > min(MOST, MAX_FILES * job.shard):
        raise InputError(
            f"The number of trials is {job.trials}, in shards of {job.shard}; expected at most {MOST}, in {MAX_FILES} "
            "shards."
        )
    engines.check(job.engine)
    if job.window is not None:
        encoder_config(job)
    scenario = get_scenario(job.preset)
    if job.window is not None and not scenario.recorded:
        raise InputError(
            f"Labels of a simulation have HIRO's thresholds, which do not fit {job.preset}; leave the window out, and "
            "encode the store."
        )
    scenario.draw(job.seed, 0, job.spec)
    return scenario


def job_of(values: dict[str, Any]) -> SynthesisConfig:
    """The job that :func:`provenance` wrote down, in shards of the default size.

    Raises:
        InputError: its preset or assembly is not known here.
        KeyError, TypeError: it is of another version.
    """
    return SynthesisConfig(**{**values, "spec": scenario_of(values)[1]})


def scenario_of(values: dict[str, Any]) -> tuple[Scenario, Any]:
    """Scenario and distributions of a job that :func:`provenance` wrote down; errors as of :func:`job_of`."""
    scenario = get_scenario(values["preset"])
    return scenario, _as_given(scenario.spec(), values["spec"])


def _as_given(like: Any, value: Any) -> Any:
    """JSON's value in the type of a field's default: a dataclass, an array or a list; other lists as tuples."""
    if isinstance(value, dict):
        default = like.get if isinstance(like, Mapping) else partial(getattr, like)
        found = {name: _as_given(default(name, None), one) for name, one in value.items()}
        return type(like)(**found) if is_dataclass(like) and not isinstance(like, type) else found
    if not isinstance(value, list):
        return value
    if isinstance(like, np.ndarray):
        given = np.asarray(value)
        same = given.astype(like.dtype)
        return same if same.tolist() == value else given  # of another type than the default
    if isinstance(like, jax.Array):
        return jnp.asarray(value, like.dtype)
    likes = like if isinstance(like, tuple | list) and len(like) == len(value) else (None,) * len(value)
    each = [_as_given(default, one) for default, one in zip(likes, value, strict=True)]
    return each if isinstance(like, list) else tuple(each)


def encoder_config(job: SynthesisConfig) -> EncoderConfig:
    return EncoderConfig(window=job.window or 0, dt=CONTROL_PERIOD)


def indices(job: SynthesisConfig, shard: int) -> range:
    return range(shard * job.shard, min((shard + 1) * job.shard, job.trials))


def label_limits() -> NDArray[np.float64]:
    """Thresholds that label the trials [6, 4]."""
    return np.asarray(thresholds.preset(ROBOT).limits)


def label_attrs(job: SynthesisConfig) -> dict[str, Any]:
    """How the labels of a job are made, as "rcbht encode" notes it: JSON values."""
    config = encoder_config(job)
    return {"semantics": "online", "window": config.window, **made_by(config, label_limits())}


def manifest_of(job: SynthesisConfig) -> dict[str, Any]:
    """Everything that determines a shard, as JSON values.

    Raises:
        InputError: the distributions hold something else than numbers, words, and lists, mappings and arrays of them.
    """
    versions: dict[str, Any] = {
        "rcbht_jax": rcbht_jax.__version__,
        "jax": jax.__version__,
        "mujoco": mujoco.__version__,
    }
    versions |= {"numpy": np.__version__, "sim_mjx_sha256": code_hash()}
    if job.engine != "warp":  # which does not give the same bytes twice
        versions["processor"] = processor()
    made: dict[str, Any] = {"job": _plain("", job), "versions": versions}
    if own := own_files(job.preset):
        made["versions"]["own_sha256"] = [file.digest for file in own]
        made["versions"]["scene_sha256"] = _scene_hash(job.preset)  # they may read other files, such as an MJCF
    if job.window is not None:  # what else the labels depend on
        made["versions"]["encoding_sha256"] = encoding_hash()
        made["thresholds"] = label_limits().tolist()
    return made


def _plain(name: str, value: Any) -> Any:
    """A value as JSON knows it; ``name`` says where it stands.

    Raises:
        InputError: JSON has nothing for it.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float) and np.isfinite(value):
        return float(value)
    if isinstance(value, np.ndarray | np.generic | jax.Array) and np.asarray(value).dtype.kind in "biuUf":
        return _plain(name, np.asarray(value).tolist())
    if isinstance(value, tuple | list):
        plain = [_plain(f"{name}[{place}]", one) for place, one in enumerate(value)]
        return tuple(plain) if isinstance(value, tuple) else plain
    if is_dataclass(value) and not isinstance(value, type):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: _plain(f"{name}.{key}".lstrip("."), one) for key, one in value.items()}
    raise InputError(f"{name} of the job is {value!r}; expected finite numbers, words, or lists of them.")


def _scene_hash(preset: str) -> str:
    """Digest of the compiled scene of a preset."""
    model = get_scenario(preset).scene().model
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content_hash([content])


@cache
def processor() -> str:
    """System and instructions that decide how numbers are rounded, in words.

    MuJoCo, NumPy and XLA choose vector instructions when they run; the widest of those that NumPy has found is noted.

    >>> processor().startswith(platform.system())  # Linux x86_64 with AVX-512, for example
    True
    """
    extensions: Any = np.show_config(mode="dicts")
    found = {name for names in ("baseline", "found") for name in extensions["SIMD Extensions"].get(names, ())}
    widest = next(
        (words for words, names in _WIDEST.items() if found & names), "no vector instructions beyond its base"
    )
    return f"{platform.system()} {platform.machine()} with {widest}"


@cache  # the code that runs is the one read at the start, whatever is edited later
def code_hash() -> str:
    """Digest of the simulation's sources: shards made by different code must not be mixed."""
    root = Path(__file__).parents[2]
    library = [*(root / "rcbht_jax/robots").glob("*.py"), *(root / "rcbht_jax" / one for one in _OF_THE_LIBRARY)]
    return files_hash(root, sorted([*(root / "sim_mjx").rglob("*.py"), *library]))


@cache
def encoding_hash() -> str:
    """Digest of the sources that label trials."""
    root = Path(rcbht_jax.__file__).parent
    return files_hash(root, sorted([*(root / "encoding").glob("*.py"), root / "labels.py", root / "types.py"]))


def provenance(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The part of the manifest that determines the store: all but the shard size."""
    job = {name: value for name, value in manifest["job"].items() if name != "shard"}
    return {"job": job, "versions": manifest["versions"]}
