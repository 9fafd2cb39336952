"""The long form: python -m tests.attacks --seed 1 --attempts 20000 --out attack.json

An interrupted run resumes from the file. Exit status 1 = something is wrong; an attempt of a number and a seed can be
repeated with --only NUMBER.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import rcbht_jax
from rcbht_jax._util.atomic import atomic_write
from rcbht_jax._util.untrusted import load_json
from sim_mjx.synthesis.plan import processor
from tests.attacks import harness

BATCH = 250


def main() -> int:
    """Run attempts that are not done yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--attempts", type=int, default=20_000)
    parser.add_argument("--out", type=Path, default=Path("attack.json"))
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--only", type=int, help="repeat one attempt in this process")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        good = Path(folder)
        if options.only is not None:
            harness.make_good(good)
            print(*harness.attempt(options.only, options.seed, good))
            return 0
        harness.in_child(lambda: harness.make_good(good))
        return _run(options.seed, options.attempts, options.out, good, options.processes)


def _run(seed: int, attempts: int, out: Path, good: Path, processes: int) -> int:
    result = _begun(out, seed, attempts)
    start, before = harness.clock(), result["attempts"]
    while result["attempts"] < attempts:
        batch = range(result["attempts"], min(result["attempts"] + BATCH, attempts))
        for number, name, wrong in harness.in_runners(batch, seed, good, processes):
            result["attempts"] += 1
            counts = Counter(result["outcomes"].get(name, {}))
            counts[wrong if wrong == "refused" else "wrong" if wrong else "done"] += 1
            result["outcomes"][name] = dict(sorted(counts.items()))
            if wrong not in ("", "refused"):
                result["defects"].append({"attempt": number, "what": name, "wrong": wrong})
        with atomic_write(out) as draft:
            draft.write_text(json.dumps(result, indent=1) + "\n")
        pace = (result["attempts"] - before) / (harness.clock() - start)
        left = (attempts - result["attempts"]) / pace
        done = f"{result['attempts']} of {attempts}, {len(result['defects'])} defects"
        print(f"{done}, {pace:.0f}/s, {left / 60:.0f} min left", file=sys.stderr, flush=True)
    for defect in result["defects"]:
        print(json.dumps(defect))
    print(f"{result['attempts']} attempts, {len(result['defects'])} defects: {out}")
    return bool(result["defects"])


def _begun(out: Path, seed: int, attempts: int) -> dict[str, Any]:
    """The result of an earlier run with this seed, or an empty one."""
    if out.exists() and (found := load_json(out))["seed"] == seed and found["version"] == rcbht_jax.__version__:
        return found
    return {
        "command": f"python -m tests.attacks --seed {seed} --attempts {attempts}",
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{os.cpu_count()} CPU cores, {processor()}, Python {platform.python_version()}",
        "version": rcbht_jax.__version__,
        "seed": seed,
        "attempts": 0,
        "defects": [],
        "outcomes": {},
    }


if __name__ == "__main__":
    sys.exit(main())
