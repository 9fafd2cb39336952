"""``rcbht bench``: speed and memory on one machine, with references and peers measured in the same run."""

from __future__ import annotations

import hashlib
import importlib.util
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.printable import plural
from rcbht_jax._util.ratios import append_record, cpu_model, fallen, interleaved, latest, read_history, turns
from rcbht_jax.cli.command import Command, Flag, announce, check_place, option, unset
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    import jax

_REPEATS = 7
DT = 0.005
WINDOW = 5  # samples, of the fit rule and of a step
TRIALS, TRIALS_ON_DEVICE = 100, 8192
MOST = 10**12  # samples: more would fill any memory
Values = dict[str, tuple[float, str]]  # name -> value, unit


@dataclass(frozen=True)
class Bench(Command):
    """Measure speed and memory of the encoders and of a store.

    Lines read "name value unit". Times are medians; compile time is separate. A line ratio/... compares with a
    reference measured alternately in the same run, so it depends less on the machine: the encoder with plain line
    fits of the same windows, a streaming step with an empty one, the fit rule with the published rule, reading a store
    with loading and hashing the same bytes. The extra "bench" installs other symbolic representations (tslearn,
    fABBA), which are measured on the same array.

    Example: rcbht bench --trials 100

    Example: rcbht bench --check benchmarks/history.json
    """

    trials: Annotated[int | None, unset("100, with --device 8192", metavar="INT")] = None
    """Trials of six axes in the batch."""
    samples: int = 2000
    """Samples per trial."""
    device: Flag = False
    """Measure on the accelerator that JAX finds, instead of the CPU."""
    check: Annotated[
        Path | None,
        option(
            "Compare the ratios with the newest record of this device, processor and these sizes; exit status 2 if one "
            "has fallen by more than 20 %.",
            "",
            metavar="HISTORY.json",
        ),
    ] = None
    history: Annotated[Path | None, unset(metavar="HISTORY.json")] = None
    """File to append this run to; created if it does not exist."""

    def run(self) -> dict[str, Any]:
        import jax

        trials = self.trials if self.trials is not None else TRIALS_ON_DEVICE if self.device else TRIALS
        if trials < 1 or self.samples < 20:
            raise InputError(f"--trials is {trials} and --samples {self.samples}; expected at least 1 and 20.")
        if trials * self.samples > MOST:
            raise InputError(
                f"--trials is {trials} and --samples {self.samples}; expected at most {MOST} samples in all."
            )
        device = _device(self.device)
        run = {
            "device": device.device_kind, "processor": cpu_model(), "trials": trials, "samples": self.samples,
        }  # fmt: skip
        old = None if self.check is None else latest(read_history(self.check), run)
        if self.check is not None and old is None:
            raise InputError(
                f"{self.check} has no run of {plural(trials, 'trial')} of {self.samples} samples on "
                f"{device.device_kind} with {run['processor']}; add one with --history {self.check}."
            )
        if self.history is not None:  # a wrong file is reported before the work
            check_place(self.history, None)
            if self.history.exists():
                read_history(self.history)
        with jax.default_device(device):
            values, ratios = measure(signal(trials, self.samples))
        record = {
            "date": time.strftime("%Y-%m-%d", time.gmtime()),
            **run,
            "values": {name: {"value": value, "unit": unit} for name, (value, unit) in values.items()},
            "ratios": ratios,
        }
        result = {**record, "compared_with": None, "fallen": []}
        if old is not None:
            result |= {"compared_with": old.get("date"), "fallen": fallen(ratios, old["ratios"])}
        if self.history is not None:
            append_record(self.history, record)
        return result

    def exit_status(self, result: dict[str, Any]) -> int:
        return 2 if result["fallen"] else 0

    def text(self, result: dict[str, Any]) -> str:
        values = {name: (entry["value"], entry["unit"]) for name, entry in result["values"].items()}
        values |= {f"ratio/{name}": (ratio, "x") for name, ratio in result["ratios"].items()}
        lines = [f"# {result['device']}, {plural(result['trials'], 'trial')} of {result['samples']} samples"]
        lines += [f"{name} {value:.6g} {unit}" for name, (value, unit) in values.items()]
        if not any(name.startswith("peer/") for name in values):
            lines.append('# no other representation is installed; pip install "rcbht-jax[bench]"')
        if result["compared_with"] is not None:
            lines += [f"# {sentence}" for sentence in result["fallen"]] or [
                f"# no ratio has fallen by more than 20 % since {result['compared_with']}"
            ]
        return "\n".join(lines)


def _device(accelerator: bool) -> jax.Device:
    """The accelerator that JAX finds, or the processor."""
    import jax

    if not accelerator:
        return jax.devices("cpu")[0]
    if (device := jax.devices()[0]).platform == "cpu":
        raise InputError('JAX finds no accelerator; leave out --device, or pip install "rcbht-jax[cuda]".')
    return device


def measure(wrench: NDArray[np.float32]) -> tuple[Values, dict[str, float]]:
    """All values by name, and the ratios to their references."""
    values: Values = {}
    ratios: dict[str, float] = {}
    announce(1, 6, "batch encoder")
    for window in (5, 20):
        found, ratios[f"encode/W={window}"] = batch_encoder(wrench, window)
        values |= found
    announce(2, 6, "rule fit")
    found, some = fit_rule(wrench)
    values, ratios = values | found, ratios | some
    announce(3, 6, "streaming encoder")
    found, ratios["step"] = streaming_step()
    values |= found
    announce(4, 6, "offline encoder")
    values["offline/33_s"] = (offline_trial(), "s")
    announce(5, 6, "store")
    if importlib.util.find_spec("zarr") is not None:
        values["store/read"], ratios["store/read"] = store_reading(wrench)
    announce(6, 6, "other representations")
    ours = values["encode/W=5"][0]
    for name, speed in peers(wrench, 5).items():
        values[f"peer/{name.replace(' ', '_')}"] = (speed, "samples/s")
        values[f"faster_than/{name.replace(' ', '_')}"] = (ours / speed, "x")
    return values, ratios


def signal(trials: int, samples: int, seed: int = 0) -> NDArray[np.float32]:
    """Random walks ``[trials, samples, 6]`` with the slopes of a snap assembly: all labels occur."""
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(size=(trials, samples, 6)) * 0.3, axis=1).astype(np.float32)


def median_seconds(run: Callable[[], Any], repeats: int = _REPEATS) -> float:
    """Median wall time of a call that has been made once before."""
    return float(np.median(turns([run], repeats)))


def batch_encoder(wrench: NDArray[np.float32], window: int) -> tuple[Values, float]:
    """Dense encoding of all trials at once, and its speed in units of bare line fits of the same windows."""
    import jax
    import jax.numpy as jnp

    from rcbht_jax.encoding.encoder import EncoderConfig, encode
    from rcbht_jax.encoding.thresholds import preset

    config, limits = EncoderConfig(window=window, dt=DT), jnp.asarray(preset().limits, jnp.float32)
    data, length = jnp.asarray(wrench), jnp.full(len(wrench), wrench.shape[1], jnp.int32)
    start = time.perf_counter()
    compiled = jax.jit(encode, static_argnums=0).lower(config, limits, data, length).compile()
    compile_seconds = time.perf_counter() - start
    fits = jax.jit(_line_fits, static_argnums=0)
    timing = interleaved(
        lambda: jax.block_until_ready(compiled(limits, data, length)),
        lambda: jax.block_until_ready(fits(window, data)),
        _REPEATS,
    )
    memory = compiled.memory_analysis()
    tracks = compiled(limits, data, length)
    labels = sum(leaf.nbytes for leaf in jax.tree.leaves(tracks))
    slots = sum(track.label.size for track in (tracks.primitive, tracks.mc, tracks.llb))
    name = f"encode/W={window}"
    values: Values = {
        name: (wrench.size / timing.seconds, "samples/s"),
        f"{name}/compile": (compile_seconds, "s"),
        f"{name}/label": (labels / slots, "bytes/slot"),
    }
    if memory:
        values[f"{name}/working_memory"] = (memory.temp_size_in_bytes / wrench.nbytes, "x_wrench")
    return values, timing.ratio


def _line_fits(window: int, wrench: Any) -> Any:
    """Slope and mean of every window ``[trial, window, axis]``: what no encoder of windows can do without."""
    import jax.numpy as jnp

    count = wrench.shape[1] // window
    cut = wrench[:, : count * window].reshape(len(wrench), count, window, -1)
    time = (np.arange(window) - (window - 1) / 2) * DT
    weights = jnp.asarray(time / (time**2).sum(), wrench.dtype)
    return jnp.einsum("nwta,t->nwa", cut, weights), cut.mean(2)


def fit_rule(wrench: NDArray[np.float32]) -> tuple[Values, dict[str, float]]:
    """A data set as ``encode`` labels it, and a step inside a scan; their speed in units of the published rule's."""
    import jax
    import jax.numpy as jnp

    from rcbht_jax.encoding import encoder, fit
    from rcbht_jax.encoding.batch import encode_batch
    from rcbht_jax.encoding.thresholds import preset
    from rcbht_jax.encoding.tolerance import FitLimits, auto_tolerance

    ours, published = fit.FitConfig(window=WINDOW, dt=DT), encoder.EncoderConfig(window=WINDOW, dt=DT)
    length = np.full(len(wrench), wrench.shape[1], np.int32)
    limits = FitLimits(np.asarray(preset().limits), auto_tolerance(wrench, length, ours.needed))
    batch = interleaved(
        lambda: encode_batch(ours, limits, wrench, length),
        lambda: encode_batch(published, preset(), wrench, length),
        _REPEATS,
    )
    count = wrench.shape[1] // WINDOW
    samples = jnp.asarray(wrench[0, : count * WINDOW].reshape(count, WINDOW, -1))
    stacked = jnp.asarray(limits.stacked(), samples.dtype)
    fitted = jax.jit(lambda x: jax.lax.scan(partial(fit.step, ours, stacked), fit.init(ours), x))
    paper = jax.jit(lambda x: jax.lax.scan(partial(encoder.step, published, stacked[:, :4]), encoder.init(), x))
    step = interleaved(
        lambda: jax.block_until_ready(fitted(samples)), lambda: jax.block_until_ready(paper(samples)), _REPEATS
    )
    values: Values = {
        f"fit/encode/W={WINDOW}": (wrench.size / batch.seconds, "samples/s"),
        "fit/step/scan": (step.seconds / count * 1e6, "us"),
    }
    return values, {f"fit/encode/W={WINDOW}": batch.ratio, "fit/step": step.ratio}


def streaming_step(windows: int = 2000) -> tuple[Values, float]:
    """One step for six axes: inside a scan, as a single jitted call, and that in units of a call that does nothing."""
    import jax
    import jax.numpy as jnp

    from rcbht_jax.encoding.encoder import EncoderConfig, init, step
    from rcbht_jax.encoding.thresholds import preset

    config, limits = EncoderConfig(window=WINDOW, dt=DT), jnp.asarray(preset().limits, jnp.float32)
    samples = jnp.asarray(signal(1, windows * WINDOW)[0].reshape(windows, WINDOW, 6))
    scan = jax.jit(lambda s, x: jax.lax.scan(lambda c, w: step(config, limits, c, w), s, x))
    in_scan = median_seconds(lambda: jax.block_until_ready(scan(init(), samples))) / windows
    single = jax.jit(step, static_argnums=0)
    empty: Callable[..., Any] = jax.jit(lambda limits, state, x: (state, x.sum()))
    state, _ = single(config, limits, init(), samples[0])
    one = np.asarray(samples[1])
    calls: list[Callable[[], Any]] = [
        lambda: jax.block_until_ready(single(config, limits, state, one)),
        lambda: jax.block_until_ready(empty(limits, state, one)),
    ]
    times = turns(calls, windows)
    ours, reference = np.median(times, axis=0)
    values: Values = {
        "step/scan": (in_scan * 1e6, "us"),
        "step/call": (float(ours) * 1e6, "us"),
        "step/call/p99": (float(np.quantile(times[:, 0], 0.99)) * 1e6, "us"),
    }
    return values, float(reference / ours)


def store_reading(wrench: NDArray[np.float32]) -> tuple[tuple[float, str], float]:
    """Reading of a store, verified, and its speed in units of loading and hashing the same bytes."""
    from rcbht_jax.io.store import read_recordings, write_recordings
    from rcbht_jax.types import Recordings

    some = wrench[: max(1, 2**26 // wrench[0].nbytes)]
    with tempfile.TemporaryDirectory(prefix="rcbht-bench-") as folder:
        path, plain = Path(folder) / "bench.zarr", Path(folder) / "bench.npy"
        write_recordings(path, Recordings.from_arrays(some, 1 / DT), {})
        np.save(plain, some)
        timing = interleaved(
            lambda: read_recordings(path),
            lambda: hashlib.sha256(np.load(plain, allow_pickle=False).data).hexdigest(),
            _REPEATS,
        )
    return (some.nbytes / timing.seconds, "bytes/s"), timing.ratio


def offline_trial() -> float:
    """Seconds that the offline taxonomy takes for one trial of 33 s and six axes at 200 Hz."""
    from rcbht_jax import reference

    seconds = 33.0
    wrench = signal(1, round(seconds / DT))[0].astype(np.float64)
    times = reference.sample_times(len(wrench), DT)
    return median_seconds(lambda: reference.encode(times, wrench, [0.0, seconds / 4, seconds / 2]), repeats=3)


def peers(wrench: NDArray[np.float32], window: int) -> dict[str, float]:
    """Samples per second of the peers that are installed (extra ``bench``); slow ones get part of the array."""
    lanes = np.moveaxis(wrench, 2, 1).reshape(-1, wrench.shape[1]).astype(np.float64)
    segments = wrench.shape[1] // window
    speeds = {}
    if importlib.util.find_spec("tslearn") is not None:
        from tslearn.piecewise import OneD_SymbolicAggregateApproximation, SymbolicAggregateApproximation

        sax = SymbolicAggregateApproximation(n_segments=segments, alphabet_size_avg=9)
        speeds["tslearn SAX"] = lanes.size / median_seconds(lambda: sax.fit_transform(lanes[:, :, None]), repeats=3)
        slope = OneD_SymbolicAggregateApproximation(n_segments=segments, alphabet_size_avg=9, alphabet_size_slope=9)
        part = lanes[:60]
        speeds["tslearn 1d-SAX"] = part.size / median_seconds(lambda: slope.fit_transform(part[:, :, None]), repeats=1)
    if importlib.util.find_spec("fABBA") is not None:
        from fABBA import fABBA

        part = lanes[:6]
        speeds["fABBA"] = part.size / median_seconds(
            lambda: [fABBA(tol=0.1, alpha=0.1, verbose=0).fit_transform(lane) for lane in part], repeats=3
        )
    return speeds
