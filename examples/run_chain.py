"""Beliefs from an exported chain with NumPy and JAX alone; rcbht-jax is not needed.

    rcbht export-model states.model -o states.chain
    python examples/run_chain.py states.chain < wrenches.jsonl

Each line of the input is {"wrench": [Fx, Fy, Fz, Mx, My, Mz]}, one per sampling period, in the order and the units that
chain.json in the archive names, or {"begin": true} where a sub-task begins and {"reset": true} where a trial does; a
reading on such a line is the next one. One JSON line with the probabilities of every head is printed per window. A
line that is no JSON object is left out with a message, and so is a reading that is no list of finite numbers, one per
axis: it would stay in the state for good.
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
            start = [arrays[name] for name in sorted(arrays.files)]
        exported = export.deserialize(archive.read("chain.stablehlo"))
    chain, *inputs = jax.jit(exported.call), *exported.in_avals[len(start) :]
    window, begins = np.zeros(inputs[0].shape, np.float32), np.zeros(inputs[2].shape, np.int32)
    state, received = start, 0
    for line in sys.stdin:
        try:
            message = json.loads(line)
        except ValueError:  # such as an empty line, or the last one of a file that was cut off
            message = None
        if not isinstance(message, dict):
            print(f"left out: {line.strip()}", file=sys.stderr)
            continue
        if message.get("reset"):
            state, received, begins = start, 0, np.zeros_like(begins)
        if message.get("begin"):
            begins = np.where([scope == "subtask" for scope in meta["sentences"]], received, begins).astype(np.int32)
        if "wrench" not in message:
            continue
        try:
            reading = np.asarray(message["wrench"], np.float32)
        except (TypeError, ValueError):  # text, or lists of different lengths
            reading = np.zeros(0, np.float32)
        if reading.shape != window.shape[1:] or not np.isfinite(reading).all():
            print(f"left out: {line.strip()}", file=sys.stderr)
            continue
        window[received % len(window)] = reading
        received += 1
        if received % len(window) == 0:
            state, said, _ = chain(state, window.copy(), np.int32(len(window)), begins)
            heads = {
                head["name"]: dict(zip(head["classes"], np.asarray(p, np.float64).round(4).tolist(), strict=True))
                for head, p in zip(meta["heads"], said, strict=True)
            }
            print(json.dumps({"sample": received, **heads}), flush=True)


if __name__ == "__main__":
    main()
