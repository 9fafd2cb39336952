"""Learn set-points and a search that seat parts 5 mm beside the hand, where the recorded controller fails.

The cross-entropy method over nine numbers: what is added to the force law's set-points, and a spiral of the hand with
a descent before it (``experiments.simulation.steered``). Every candidate of a generation meets the same trials: session
B's, mildly randomised, with the hand 5 mm beside the part in a random direction. On the device an environment is
stepped (engines mjx and warp); the native engine runs the same policy as a program. The test uses other trials.

A trial may take 40 s: the rear hooks let go seconds into mating, later for a hand that has searched. With at most 22 s,
which suffice for blocks, 10 of 16 trials of a third seed seated, with 40 s 13.

Run on a CPU, resumable: python -m experiments.simulation.learn_setpoints --checkpoint learn.json
On a GPU: python -m experiments.simulation.learn_setpoints --engine warp --population 128 --trials 32 --generations 15
    --tests 256
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from numpy.typing import NDArray

from experiments._lib.arrays import Floats
from experiments._lib.intervals import seated_share
from experiments._lib.results_io import defaults_of, given, write_result
from experiments.simulation import steered
from rcbht_jax._util import checkpoint as checkpoints
from sim_mjx import engines, env
from sim_mjx.assembly import task
from sim_mjx.env.actions import with_set_points
from sim_mjx.env.environment import State
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario

PRESET, OFFSET = "hooked-B", 5e-3  # m, from hand to part
LEARN, TEST = 1, 2  # seeds of the trials
SPREAD = 0.15  # standard deviation at first, of the ranges
ELITE, KEPT = 0.25, 0.3  # best share of a generation, and share of the old distribution that stays
STRETCH = 40  # steps of the environment per call
Scores = tuple[Floats, NDArray[np.bool_]]  # share of seated tabs, and all seated [trial]


def beside(seed: int, indices: range, seconds: float, offset: float = OFFSET) -> Any:
    """Trials of the preset with the hand ``offset`` beside the part."""
    spec = DomainRandomization(nominal_share=1.0, longest=seconds)
    params, _ = get_scenario(PRESET).draw_batch(seed, indices, spec)
    angle = np.array([np.random.default_rng([seed, index, 5]).uniform(0, 2 * np.pi) for index in indices])
    moved = offset * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    return replace(params, task=replace(params.task, way_position=params.task.way_position + moved[:, None]))


def evaluate(engine: str, trials: Any, policies: Floats) -> Scores:
    """Every policy on every trial, [policy, trial] each."""
    count = len(trials.command_delay)
    rows, repeated = np.tile(np.arange(count), len(policies)), np.repeat(policies, count, axis=0)
    many = (trials, rows, repeated)
    tabs, seated = by_program(*many) if engine == "native" else by_environment(engine, *many)
    shape = (len(policies), count)
    return tabs.reshape(shape), seated.reshape(shape)


def by_program(trials: Any, rows: NDArray[np.intp], policies: Floats) -> Scores:
    """On the native engine, by the tabs at the end."""
    scene = get_scenario(PRESET).scene()
    many = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], trials)
    params = steered.SteeredParams(steered.with_policies(many, policies), policies)
    out = engines.simulate(replace(scene, program=steered.steered(scene.program)), params, "native")
    return out.seated.mean(1), out.seated.all(1)


def by_environment(engine: str, trials: Any, rows: NDArray[np.intp], policies: Floats) -> Scores:
    """On the device, by the episodes of an environment."""
    episodes = env.load(PRESET, steered.CONFIG, params=trials, engine=engine, parallel=len(rows))
    state = jax.jit(jax.vmap(episodes.reset_to))(jnp.asarray(rows))
    params = with_set_points(state.data.params, jnp.asarray(steered.set_points(policies), jnp.float32))
    state = replace(state, data=replace(state.data, params=params))
    stretch, touched = steps(engine, len(rows)), jnp.full(len(rows), -1, jnp.int32)
    while not jax.device_get((state.done > 0.5).all()):
        state, touched = stretch(state, touched, jnp.asarray(policies, jnp.float32))
    tabs, success = jax.device_get((state.metrics["seated"], state.metrics["success"]))
    return np.asarray(tabs, np.float64), success > 0.5


@cache
def steps(engine: str, lanes: int) -> Callable[[State, Any, Any], tuple[State, Any]]:
    """Steps of all lanes, of which ended ones stay as they are; compiled once for all trials."""
    scene = env.load(PRESET, steered.CONFIG, trials=1, engine=engine, parallel=lanes)

    def one(state: State, touched: Any, policy: Any) -> tuple[State, Any]:
        data = state.data
        touched = jnp.where((touched < 0) & (data.phase > task.APPROACH), data.tick, touched)
        action = steered.act(policy, *steered.clocks(data.params, data.tick, touched), state.obs[6:12])
        after, going = scene.step(state, action), state.done < 0.5
        return jax.tree.map(lambda new, old: jnp.where(going, new, old), after, state), touched

    def stretch(state: State, touched: Any, policies: Any) -> tuple[State, Any]:
        def body(carry: tuple[State, Any], _: None) -> tuple[tuple[State, Any], None]:
            return jax.vmap(one)(*carry, policies), None

        return jax.lax.scan(body, (state, touched), length=STRETCH)[0]

    return env.jit(stretch)


@dataclass(frozen=True)
class Search:
    """What the outcome of learning depends on."""

    engine: str
    population: int
    trials: int  # of each candidate
    seconds: float  # longest trial
    seed: int


def learn(search: Search, generations: int, file: Path | None) -> dict[str, Any]:
    """The cross-entropy method; the state after each generation is on disk if there is a ``file``."""
    kept = checkpoints.load(file, asdict(search)) if file else None
    state = kept or {
        "mean": (0.5 * (steered.LOW + steered.HIGH)).tolist(), "sd": (SPREAD * (steered.HIGH - steered.LOW)).tolist(),
        "generations": [],
    }  # fmt: skip
    for generation in range(len(state["generations"]), generations):
        rng = np.random.default_rng([search.seed, generation])
        mean, sd = np.array(state["mean"]), np.array(state["sd"])
        drawn = mean + sd * rng.standard_normal((search.population, len(mean)))
        candidates = np.clip(drawn, steered.LOW, steered.HIGH)
        candidates[0] = mean
        indices = range(generation * search.trials, (generation + 1) * search.trials)
        tabs, seated = evaluate(search.engine, beside(LEARN, indices, search.seconds), candidates)
        score = (tabs + seated).mean(1)  # what an episode's reward sums up to
        best = np.argsort(-score)[: max(2, round(ELITE * search.population))]
        if score[best].any():  # a generation without any seated tab has no information
            middle, wide = weighted(candidates[best], score[best])
            state["mean"] = (KEPT * mean + (1 - KEPT) * middle).tolist()
            state["sd"] = (KEPT * sd + (1 - KEPT) * wide).tolist()
        state["generations"].append(
            {"seated, mean": round(float(seated.mean()), 4), "seated, best": round(float(seated.mean(1).max()), 4),
             "seated, middle": round(float(seated[0].mean()), 4)}
        )  # fmt: skip
        if file:
            checkpoints.save(file, asdict(search), state)
    return state


def weighted(candidates: Floats, score: Floats) -> tuple[Floats, Floats]:
    """Mean and standard deviation of candidates that count as much as they score."""
    mean = np.average(candidates, axis=0, weights=score)
    return mean, np.sqrt(np.average((candidates - mean) ** 2, axis=0, weights=score))


def test(engine: str, policy: Floats, count: int, seconds: float) -> dict[str, Any]:
    """Recorded and learnt policy on trials that learning has not seen, beside the part and before it."""
    both, out = np.stack([steered.RECORDED, policy]), {}
    for name, offset in (("5 mm beside", OFFSET), ("in place", 0.0)):
        _, seated = evaluate(engine, beside(TEST, range(count), seconds, offset), both)
        out[name] = {"recorded": seated_share(seated[0]), "learnt": seated_share(seated[1])}
    return out


def main(
    engine: Literal["native", "mjx", "warp"] = "native",
    population: int = 16,
    trials: Annotated[int, tyro.conf.arg(help="Trials of each candidate.")] = 12,
    generations: int = 10,
    tests: Annotated[int, tyro.conf.arg(help="Trials of the test.")] = 64,
    seconds: Annotated[float, tyro.conf.arg(help="Longest trial, s.")] = 40.0,
    seed: int = 0,
    checkpoint: Annotated[Path | None, tyro.conf.arg(help="File to resume from.")] = None,
) -> None:
    options = given(locals() | {"checkpoint": None}, defaults_of(main))
    search = Search(engine, population, trials, seconds, seed)
    state = learn(search, generations, checkpoint)
    policy = np.array(state["mean"])
    result = {
        **asdict(search),
        "policy": dict(zip(steered.RANGES, policy.round(4).tolist(), strict=True)),
        "spread": dict(zip(steered.RANGES, np.round(state["sd"], 4).tolist(), strict=True)),
        "generations": state["generations"],
        "test": test(engine, policy, tests, seconds),
    }  # fmt: skip
    name = "learn_setpoints" if engine == "native" else "learn_setpoints_gpu"
    write_result(name, f"python -m experiments.simulation.learn_setpoints{options}", result, seed)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
