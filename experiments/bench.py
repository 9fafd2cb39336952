"""Speed and memory of the encoders on this machine, peers in the same run (extra "bench").

Run on an otherwise idle machine: python -m experiments.bench
"""

from __future__ import annotations

from experiments.record import write_result
from rcbht_jax.commands.bench import Bench


def main() -> None:
    write_result("bench", "python -m experiments.bench", Bench().run(), seed=0)


if __name__ == "__main__":
    main()
