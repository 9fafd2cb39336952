"""Stop and retry by beliefs that an environment observes.

The classifiers of ``experiments.online.recovery`` (outcome, and direction of the deviation) are part of the observation
of an environment of session C; all parts are assembled at once, by the recorded controller alone. An attempt
is stopped once the belief in a failure has stood above its level for a second; then the part is approached anew, moved
against the direction that the beliefs of all attempts together favour, one step farther each time. A part whose attempt
ends without that is believed done. Whether its four tabs are seated is used only for the report.

Run: python -m experiments.online.retry
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from experiments._lib.arrays import Flags, Floats
from experiments._lib.results_io import defaults_of, given, write_result
from experiments.online.recovery import ATTEMPTS, DIRECTIONS, DOUBT, HOLD, MILD, PRESET, STEP, learn
from rcbht_jax.introspection.introspector import FAILURE_TYPE
from rcbht_jax.introspection.model import IntrospectionModel
from sim_mjx import env
from sim_mjx.assembly.task import horizontal
from sim_mjx.env.environment import State
from sim_mjx.registry import get_scenario

CERTAIN = 0.7  # belief in a failure above which an attempt is in doubt, where the classifier has no level of its own
SIZES = (0.006, 0.008, 0.010)  # m, of the faults
FIRST = 2_000_000  # index of the first trial, beyond those of the training
ENGINE, CONFIG = "mjx", env.EnvConfig(observe=("wrench", "beliefs"))


@dataclass(frozen=True)
class Attempt:
    """Result of one attempt at every part."""

    stopped: Flags  # [part] because of beliefs
    seated: Flags  # [part] when it ended or was stopped
    evidence: Floats  # [part, direction] logarithm of the beliefs in each direction


class Bench:
    """Parts in an environment, all assembled at once; ``faults`` are x and y of the hand from each part, m."""

    def __init__(self, model: IntrospectionModel, faults: Floats, seed: int) -> None:
        self.faults, self.seed = faults, seed
        params, _ = get_scenario(PRESET).draw_batch(seed, range(FIRST, FIRST + len(faults)), MILD)
        self.scene = env.load(PRESET, CONFIG, params=params, model=model, engine=ENGINE, parallel=len(faults))
        self.begin, self.step = (env.jit(jax.vmap(method)) for method in (self.scene.begin, self.scene.step))
        at, self.columns, self.level = self.scene.observation_slices["beliefs"].start, {}, CERTAIN
        for head in model.heads:
            self.columns |= {(head.name, name): at + number for number, name in enumerate(head.classes)}
            at += len(head.classes)
            self.level = head.alarm_level or self.level

    def attempt(self, number: int, correction: Floats, level: float | None = None) -> Attempt:
        """Assemble all parts with the approach moved by ``correction`` [part, 2], m; ``level`` = inf stops none."""
        level = self.level if level is None else level
        count = len(self.faults)
        seeds = np.random.default_rng([self.seed, number]).integers(0, 2**32, (count, 2), dtype=np.uint32)
        state: State = self.begin(self.scene.trials, jnp.arange(count), seeds)
        task = state.data.params.task
        moved = jnp.asarray(horizontal(self.faults + correction), jnp.float32)[:, None]
        task = replace(task, way_position=task.way_position + moved)
        params = replace(state.data.params, task=task)
        state = replace(state, data=replace(state.data, params=params))
        doubt, over, stopped, seated = np.zeros(count), *np.zeros((3, count), np.bool_)
        obs = np.zeros(state.obs.shape)
        while not over.all():
            state = self.step(state, jnp.zeros((count, self.scene.action_size)))
            seen, done, tabs = jax.device_get((state.obs, state.done, state.metrics["seated"]))
            obs[~over], seated[~over] = seen[~over], tabs[~over] == 1.0
            doubt = np.where(seen[:, self.columns["outcome", "failure"]] > level, doubt + self.scene.dt, 0.0)
            stopped |= (doubt >= HOLD) & ~over
            over |= stopped | (done > 0.5)
        beliefs = np.stack([obs[:, self.columns[FAILURE_TYPE, kind]] for kind in DIRECTIONS], axis=1)
        return Attempt(stopped, seated, np.log(np.maximum(beliefs, DOUBT)))


def assemble(bench: Bench, attempts: int) -> dict[str, Any]:
    """Attempts until every part is believed done, or no attempts are left."""
    count = len(bench.faults)
    correction, evidence = np.zeros((count, 2)), np.zeros((count, len(DIRECTIONS)))
    believed, seated = np.zeros((2, count), np.bool_)
    first: Attempt | None = None
    for number in range(attempts):
        found = bench.attempt(number, correction)
        first = first or found
        open_ = ~believed
        seated[open_], believed[open_] = found.seated[open_], ~found.stopped[open_]
        evidence += found.evidence
        ways = np.array(list(DIRECTIONS.values()))[evidence.argmax(1)]
        correction = np.where(believed[:, None], correction, -STEP * (number + 1) * ways)
        if believed.all():
            break
    assert first is not None
    unstopped = bench.attempt(0, np.zeros((count, 2)), level=np.inf)
    return {
        "parts": count,
        "seated by one attempt that nothing stops": int(unstopped.seated.sum()),
        "stopped at the first attempt": int(first.stopped.sum()),
        "of them would have seated": int((first.stopped & unstopped.seated).sum()),
        "seated in the end": int(seated.sum()),
        "believed done": int(believed.sum()),
        "believed done, not seated": int((believed & ~seated).sum()),
    }


def main(
    trials: Annotated[int, tyro.conf.arg(help="Training trials per kind of fault.")] = 24,
    repeats: Annotated[int, tyro.conf.arg(help="Parts per kind and size of fault; some more have none.")] = 2,
    attempts: int = ATTEMPTS,
    seed: int = 0,
) -> None:
    model, trained = learn(trials, seed)
    faulty = [np.array(way) * size for way in DIRECTIONS.values() for size in SIZES]
    faults = np.array(repeats * (faulty + [np.zeros(2)] * len(DIRECTIONS)))
    result = {
        "training": trained, "engine": ENGINE, "sizes_mm": [size * 1e3 for size in SIZES],
        "faulty parts": repeats * len(faulty), **assemble(Bench(model, faults, seed), attempts),
    }  # fmt: skip
    command = "python -m experiments.online.retry" + given(locals(), defaults_of(main))
    write_result("retry", command, result, seed)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
