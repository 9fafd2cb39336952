"""``rcbht export-model``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from rcbht_jax.cli.command import Command
from rcbht_jax.introspection.model import load
from rcbht_jax.introspection.stablehlo import PLATFORMS, write_chain


@dataclass(frozen=True)
class ExportModel(Command):
    """Write the whole chain of a model, wrench to beliefs, as a StableHLO artefact that needs JAX but not rcbht-jax.

    examples/run_chain.py shows how to run it.

    Example: rcbht export-model states.model -o states.chain
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")]
    """Model file made by "rcbht train-online"."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="CHAIN")] = Path("online.chain")
    """Artefact to write: a zip archive of StableHLO, the initial state and a description."""
    platforms: tuple[Literal["cpu", "cuda", "rocm", "tpu"], ...] = PLATFORMS  # type: ignore[assignment]
    """Where it is to run."""

    def run(self) -> dict[str, Any]:
        meta = write_chain(self.out, load(self.model), self.platforms)
        return {"chain": str(self.out), "bytes": self.out.stat().st_size, **meta}

    def text(self, result: dict[str, Any]) -> str:
        heads = ", ".join(head["name"] for head in result["heads"])
        platforms = " and ".join(result["platforms"])
        return f"{result['chain']}: {heads} for {platforms}, {result['bytes'] / 1e6:.1f} MB"
