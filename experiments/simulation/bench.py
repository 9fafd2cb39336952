"""Speed and memory of the encoders on this machine, compared with other libraries in the same run (extra "bench").

Run on an otherwise idle machine: python -m experiments.simulation.bench
"""

from __future__ import annotations

from experiments._lib.results_io import write_result
from rcbht_jax.cli.bench import Bench


def main() -> None:
    write_result("bench", "python -m experiments.simulation.bench", Bench().run(), seed=0)


if __name__ == "__main__":
    main()
