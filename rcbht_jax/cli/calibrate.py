"""``rcbht calibrate``."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import tyro

from rcbht_jax._util.devices import wanted
from rcbht_jax._util.printable import plural
from rcbht_jax.cli import common
from rcbht_jax.cli.command import Flag, option, progress_bar, unset
from rcbht_jax.cli.rules import RuleCommand, checked_tolerance
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    import jax

    from rcbht_jax.calibration.dataset import CalibrationData
    from rcbht_jax.calibration.rest import RestSlopes
    from rcbht_jax.calibration.rest_runs import RestRuns
    from rcbht_jax.calibration.sample import Sample
    from rcbht_jax.encoding.rules import AnyConfig, AnyLimits
    from rcbht_jax.learning.tasks import TaskSpec
    from rcbht_jax.types import Recordings

_READ_BY = {  # options by the methods that read them; the others refuse them
    ("context",): ("own_axes",),
    ("search",): ("groups", "candidates", "generations", "rungs", "checkpoint"),
    ("gradient",): ("steps", "loss"),
    ("search", "gradient"): ("devices", "seed"),
    ("context", "search", "gradient"): (
        "thresholds", "robot", "task", "boundaries", "arm", "objective", "rest_weight", "plot",
    ),
}  # fmt: skip


class _Given(NamedTuple):
    """What a method calibrates with."""

    training: Recordings
    data: CalibrationData
    config: AnyConfig
    base: AnyLimits
    rest: RestSlopes | RestRuns | None


class _Found(NamedTuple):
    """What a method has found."""

    limits: AnyLimits
    details: dict[str, Any]  # for the result
    scores: np.ndarray | None = None  # [2, score] of the base and of these limits; None = not known


@dataclass(frozen=True)
class Calibrate(RuleCommand):
    """Find gradient thresholds on trials of a store and write them to a file.

    The context method is the authors' rule: the impulse limit comes from the insertion, the constant limit from the
    rotation. The search method scores thousands of thresholds and returns those whose labels separate the classes
    best. The gradient method trains thresholds and a linear classifier together by gradient descent. With --rule fit,
    rest, search and gradient find the tolerances of that rule as well. Pass training trials only: scores on the trials
    that chose the thresholds are optimistic.

    If a store has more than 128 MiB of wrenches, thresholds are found on trials spread evenly over the chosen ones.

    Example: rcbht calibrate hiro.zarr --method search --session B -o thresholds.json
    """

    store: common.Store
    """Store with the trials."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="THRESHOLDS.json")]
    """File of thresholds to write; an existing one is replaced."""
    method: Literal["rest", "context", "search", "gradient"] = "search"
    """Calibration method; rest needs neither annotations nor classes and fits any robot."""
    task: common.Task = ""
    boundaries: common.Boundaries = "harmonised"
    arm: common.Arm = ""
    source: common.Sources = ()
    session: common.Sessions = ()
    own_axes: Flag = False
    """Find separate limits for every axis, instead of copying them between axes as the authors do (context)."""
    groups: Literal["axis", "kind", "all"] = "kind"
    """Thresholds for each axis, for each unit (forces, moments), or for all axes together (search)."""
    candidates: int = 1024
    """Thresholds to score first; a power of two spreads them best (search)."""
    generations: int = 20
    """Generations of CMA-ES around the best candidates (search)."""
    rungs: tuple[float, ...] = (1.0,)
    """Fractions of the trials for successive halving, for example 0.25 1 (search)."""
    objective: tuple[Literal["accuracy", "fit", "fisher", "information", "agreement"], ...] = ("accuracy", "fit")
    """Scores to maximise, with equal weights (search)."""
    checkpoint: Annotated[Path | None, unset(metavar="FILE")] = None
    """File that stores the scores, from which an interrupted search resumes (search)."""
    steps: int = 150
    """Training steps (gradient)."""
    loss: Literal["logistic", "fit"] = "logistic"
    """Loss of the classifier (gradient)."""
    devices: Annotated[str | None, option("GPUs of this machine that share the work (search, gradient).", "1")] = None
    rest_weight: Annotated[
        float,
        option(
            "Weight of the penalty on rest that is not labelled constant (search, gradient); 0 = no penalty. "
            "Unless it is 0, the context method takes the slopes at rest as the least constant limit."
        ),
    ] = 1.0
    plot: Annotated[Path | None, unset(metavar="OUT.png")] = None
    """Figure to write: the thresholds, drawn over the gradients of each axis and state."""
    seed: int = 0
    """Seed of the random numbers."""
    compile_cache: common.CompileCache = None

    FORMER: ClassVar[dict[str, str]] = {"--ledger": "--checkpoint"}

    def interrupted(self) -> str:
        saved = f"the scores so far are in {self.checkpoint}, and the same command resumes"
        return saved if self.checkpoint is not None and self.checkpoint.exists() else super().interrupted()

    def run(self) -> dict[str, Any]:
        from rcbht_jax._util import compile_cache
        from rcbht_jax.calibration.sample import read_sample
        from rcbht_jax.io.store import read_table
        from rcbht_jax.learning.task_choice import chosen_task
        from rcbht_jax.learning.tasks import TaskSpec

        self._check()
        compile_cache.use(self.compile_cache)
        if self.method == "rest":
            return self._rest(read_sample(self.store, self._everything))
        task = chosen_task(self.task, read_table(self.store))
        spec = TaskSpec(task, self.boundaries, self.arm, self.source, self.session)
        return self._by_classes(read_sample(self.store, spec), spec)

    def _by_classes(self, sample: Sample, spec: TaskSpec) -> dict[str, Any]:
        from rcbht_jax.calibration.dataset import calibration_data
        from rcbht_jax.encoding.limit_files import write_limits
        from rcbht_jax.encoding.rules import config_fields
        from rcbht_jax.learning.tasks import labelled_intervals

        recordings = sample.recordings
        config = self.config(recordings.dt)
        items = labelled_intervals(recordings, spec)
        data = calibration_data(recordings, items, config)
        start = time.perf_counter()
        training = recordings.take(np.unique(items.intervals[0].recording))
        base = self.limits(config, self.read_limits(training, self.store)[0], training)
        given = _Given(training, data, config, base, self._rest_of(training, config))
        found: _Found = getattr(self, f"_{self.method}")(given)
        seconds = time.perf_counter() - start
        result = {
            "method": self.method,
            "trials": len(data),
            **_of(sample),
            "classes": list(data.classes),
            **self._scores(given, found),
            **found.details,
        }
        provenance = {
            **result,
            "task": asdict(spec),
            "config": config_fields(config),
            "robot": self.robot or "",
            **({"thresholds_from": str(self.thresholds)} if self.thresholds else {}),
            "seed": self.seed,
            "data_hash": sample.data_hash,
            "trial_names": data.trial.tolist(),
        }
        write_limits(self.out, found.limits, provenance, recordings.axes, recordings.units)
        if self.plot is not None:
            self._draw(self.plot, given, found)
        return self._summary(found.limits, recordings, seconds) | result

    def _check(self) -> None:
        """Refuse options that do not go together, before the work."""
        checked_tolerance(self.rule, self.tolerance)
        if self.rule == "fit" and self.method == "context":
            raise InputError(
                "The method context is for the paper's rule; with --rule fit choose rest, search or gradient."
            )
        if self.rule == "fit" and self.plot is not None:
            raise InputError("--plot shows the slopes of windows, which --rule fit does not name; leave it out.")
        for methods, options in _READ_BY.items():
            if self.method not in methods:
                self.refuse(options, f"is for --method {' or '.join(methods)}; with {self.method} leave it out.")
        self._chosen_devices()
        if self.plot is not None:
            from rcbht_jax.plots.canvas import check_suffix

            check_suffix(self.plot)
        if not 0 <= self.rest_weight < np.inf:
            raise InputError(f"--rest-weight is {self.rest_weight}; expected a finite number, 0 or more.")

    def _scores(self, given: _Given, found: _Found) -> dict[str, Any]:
        """How good the new limits and the base are, by the objective and by each of its scores."""
        import jax

        from rcbht_jax.calibration.objective import SCORES, Objective
        from rcbht_jax.calibration.search import score_candidates

        weights = Objective.of(dict.fromkeys(self.objective, 1.0)).weights()
        pair = jax.tree.map(lambda *leaves: np.stack(leaves), given.base, found.limits)
        both = found.scores  # to score two more than a search has means to compile for two
        both = score_candidates(given.data, given.config, pair) if both is None else both
        penalties = np.zeros(2) if given.rest is None else given.rest.penalty(pair)
        return {
            "value": float(both[1] @ weights - penalties[1]),
            "preset_value": float(both[0] @ weights - penalties[0]),
            "rest_penalty": float(penalties[1]),
            "preset_rest_penalty": float(penalties[0]),
            "scores": dict(zip(SCORES, both[1].tolist(), strict=True)),
            "preset_scores": dict(zip(SCORES, both[0].tolist(), strict=True)),
        }

    def _draw(self, path: Path, given: _Given, found: _Found) -> None:
        from rcbht_jax.encoding.rules import gradients_of
        from rcbht_jax.encoding.thresholds import GradientThresholds
        from rcbht_jax.plots import save
        from rcbht_jax.plots.thresholds import threshold_figure

        new, old = (GradientThresholds(gradients_of(x)) for x in (found.limits, given.base))
        axes, units = given.training.axes, given.training.units
        save(threshold_figure(given.data, given.config.window, new, old, axes, units), path)

    def _summary(self, limits: AnyLimits, recordings: Recordings, seconds: float) -> dict[str, Any]:
        from rcbht_jax.encoding.rules import gradients_of
        from rcbht_jax.encoding.tolerance import FitLimits

        summary = {"thresholds": str(self.out), "rule": self.rule, "axes": list(recordings.axes)}
        tolerance = {"tolerance": np.asarray(limits.tolerance).tolist()} if isinstance(limits, FitLimits) else {}
        return {**summary, "limits": np.asarray(gradients_of(limits)).tolist(), **tolerance, "seconds": seconds}

    def text(self, result: dict[str, Any]) -> str:
        from rcbht_jax.encoding.thresholds import LIMITS, TOLERANCE

        names, rows = list(LIMITS), result["limits"]
        if "tolerance" in result:
            names, rows = [*names, TOLERANCE], [[*row, one] for row, one in zip(rows, result["tolerance"], strict=True)]
        trials = plural(result["trials"], "trial")
        lines = [f"{result['thresholds']}: {result['method']} on {trials} in {result['seconds']:.1f} s"]
        if "value" in result:
            lines[0] += f"; objective {result['value']:.3f}, with the initial thresholds {result['preset_value']:.3f}"
        if "of_trials" in result:
            lines.append(f"The store is large: these trials are spread evenly over its {result['of_trials']}.")
        lines.append("      " + "".join(f"{name:>10}" for name in names))
        lines += [
            f"{axis:6}" + "".join(f"{limit:10.3f}" for limit in row)
            for axis, row in zip(result["axes"], rows, strict=True)
        ]
        if still := result.get("never_change"):
            lines.append(f"HIRO's limits stand for what never changes here: {', '.join(still)}.")
        if one := result.get("ungraded"):
            lines.append(f"Insertion is hardly steeper than rotation or rest, so all limits are one: {', '.join(one)}.")
        return "\n".join([*lines, "These trials chose the thresholds: evaluate on others."])

    @property
    def _everything(self) -> TaskSpec:
        """What needs neither annotations nor classes."""
        from rcbht_jax.learning.tasks import TaskSpec

        return TaskSpec(sources=self.source, sessions=self.session, outcomes=())

    def _rest(self, sample: Sample) -> dict[str, Any]:
        from rcbht_jax.calibration.rest import changing, rest_thresholds
        from rcbht_jax.calibration.rest_runs import fit_rest_limits
        from rcbht_jax.encoding.fit import FitConfig
        from rcbht_jax.encoding.limit_files import write_limits
        from rcbht_jax.learning.tasks import chosen_recordings

        start = time.perf_counter()
        recordings = sample.recordings
        chosen = chosen_recordings(recordings, self._everything)
        if not chosen.any():
            raise InputError("No recording has such a --source and --session; rcbht info lists those of the store.")
        if self.tolerance:
            raise InputError("The method rest finds the tolerances; leave out --tolerance.")
        result: dict[str, Any] = {"method": "rest", "trials": len(np.unique(recordings.trial[chosen])), **_of(sample)}
        config, some = self.config(recordings.dt), recordings.take(chosen)
        result["never_change"] = np.array(recordings.axes)[~changing(some)].tolist()
        limits: AnyLimits
        if isinstance(config, FitConfig):
            found = fit_rest_limits(some, config)
            limits = found.limits
            result["rest_constant"] = dict(zip(recordings.axes, found.constant.round(4).tolist(), strict=True))
        else:
            limits = rest_thresholds(some, self.window).thresholds
        provenance = {**result, "window": self.window, "data_hash": sample.data_hash}
        write_limits(self.out, limits, provenance, recordings.axes, recordings.units)
        return self._summary(limits, recordings, time.perf_counter() - start) | result

    def _rest_of(self, training: Recordings, config: AnyConfig) -> RestSlopes | RestRuns | None:
        from rcbht_jax.calibration.rest import RestSlopes
        from rcbht_jax.calibration.rest_runs import RestRuns
        from rcbht_jax.encoding.fit import FitConfig

        if self.rest_weight == 0:
            return None
        if isinstance(config, FitConfig):
            return RestRuns.of(training, config, self.rest_weight)
        return RestSlopes.of(training, self.window, self.rest_weight)

    def _context(self, given: _Given) -> _Found:
        from rcbht_jax.calibration import contextual
        from rcbht_jax.calibration.rest import QUIET, RestSlopes
        from rcbht_jax.encoding.encoder import EncoderConfig

        copy = contextual.OWN if self.own_axes else contextual.AUTHORS_COPY
        rest, config = given.rest, given.config
        least = np.quantile(rest.steep, QUIET, axis=1) if isinstance(rest, RestSlopes) else 0.0
        assert isinstance(config, EncoderConfig)  # run() refuses the fit rule
        every, variant = np.arange(len(given.training)), self.boundaries
        context = contextual.calibrate(given.training, every, config, given.base, copy, least, boundaries=variant)
        trials = dict(zip(("impulse", "constant"), context.trials.tolist(), strict=True))
        facts = {"trials_per_limit": trials, "own_axes": self.own_axes}
        return _Found(context.thresholds, {**facts, "ungraded": list(context.ungraded)})

    def _chosen_devices(self) -> list[jax.Device] | None:
        import jax

        return None if self.devices is None else jax.devices()[: wanted(self.devices, len(jax.devices()))]

    def _search(self, given: _Given) -> _Found:
        from rcbht_jax.calibration.objective import Objective
        from rcbht_jax.calibration.search import SearchOptions, SearchSpace, search

        options = SearchOptions(
            space=SearchSpace(given.base, _groups(self.groups, given.training)),
            objective=Objective.of(dict.fromkeys(self.objective, 1.0)),
            candidates=self.candidates,
            rungs=self.rungs,
            generations=self.generations,
            seed=self.seed,
        )
        with progress_bar("search", "candidates") as bar:
            best = search(
                given.data, given.config, options, devices=self._chosen_devices(), checkpoint=self.checkpoint,
                progress=bar.update, rest=given.rest,
            )  # fmt: skip
        plain = {key: value for key, value in asdict(options).items() if key != "space"}
        both = np.array([list(found.values()) for found in (best.start_scores, best.scores)], np.float32)
        details = {"evaluations": best.evaluations, "groups": self.groups, "options": plain}
        return _Found(best.thresholds, details, both)

    def _gradient(self, given: _Given) -> _Found:
        from rcbht_jax.calibration.gradient import FIT_TEMPERATURE, GradientOptions, calibrate

        options = GradientOptions(
            steps=self.steps,
            loss=self.loss,
            seed=self.seed,
            temperature=FIT_TEMPERATURE if self.rule == "fit" else GradientOptions.temperature,
        )
        with progress_bar("train", "steps", self.steps) as bar:
            trained = calibrate(
                given.data, given.config, given.base, options, devices=self._chosen_devices(), progress=bar.update,
                rest=given.rest,
            )  # fmt: skip
        losses = [trained.history[0][1], trained.history[-1][1]]
        return _Found(trained.thresholds, {"loss_first_last": losses, "options": asdict(options)})


def _groups(choice: Literal["axis", "kind", "all"], recordings: Recordings) -> tuple[int, ...]:
    """Number of the group of each axis."""
    units, axes = recordings.units, recordings.axes
    names = {"axis": axes, "kind": units, "all": ("",) * len(axes)}[choice]
    return tuple(list(dict.fromkeys(names)).index(name) for name in names)


def _of(sample: Sample) -> dict[str, int]:
    """How many trials the sample is of; nothing where it is all of the store."""
    return {} if sample.trials is None else {"of_trials": sample.trials}
