"""Beliefs from an exported chain with NumPy and JAX alone; rcbht-jax is not needed.

    rcbht export-model states.model -o states.chain
    python examples/run_chain.py states.chain < wrenches.jsonl

Each line of the input is {"wrench": [Fx, Fy, Fz, Mx, My, Mz]} (N, Nm), one per sampling period, or {"begin": true}
where a sub-task begins. One JSON line with the probabilities of every head is printed per window.
"""

import io
import json
import sys
import zipfile

import jax
import numpy as np
from jax import export


def main() -> None:
    with zipfile.ZipFile(sys.argv[1]) as archive:
        meta = json.loads(archive.read("chain.json"))
        with np.load(io.BytesIO(archive.read("state.npz")), allow_pickle=False) as arrays:
            state = [arrays[name] for name in sorted(arrays.files)]
        chain = jax.jit(export.deserialize(archive.read("chain.stablehlo")).call)
    window = np.zeros((meta["window"], 6), np.float32)
    begins = np.zeros(len(meta["sentences"]), np.int32)
    received = 0
    for line in sys.stdin:
        message = json.loads(line)
        if message.get("begin"):
            begins = np.where([scope == "subtask" for scope in meta["sentences"]], received, begins).astype(np.int32)
            continue
        window[received % len(window)] = message["wrench"]
        received += 1
        if received % len(window) == 0:
            state, said, _ = chain(state, window.copy(), np.int32(len(window)), begins)
            heads = {
                head["name"]: dict(zip(head["classes"], np.asarray(p).round(4).tolist(), strict=True))
                for head, p in zip(meta["heads"], said, strict=True)
            }
            print(json.dumps({"sample": received, **heads}), flush=True)


if __name__ == "__main__":
    main()
