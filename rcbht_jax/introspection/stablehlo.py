"""The whole chain as a StableHLO artefact that runs without this package.

The artefact is one zip archive: ``chain.stablehlo`` (``jax.export``, weights inside), ``state.npz`` (the state
before the first sample) and ``chain.json`` (what goes in and out). Its one function maps

    state..., window float32 [window, axis], count int32, begins int32 [view]

to the new state, the class probabilities of every classifier, and the labels published by a complete window
(int32 ``[9, axis]``: code, first sample, end of the primitive, the same of the composition, the same of the
behaviour). Only JAX is needed to call it; any runtime that takes StableHLO can compile it.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import export

from rcbht_jax._util.atomic import atomic_write
from rcbht_jax._util.optional import require
from rcbht_jax.encoding.rules import config_fields
from rcbht_jax.errors import InputError
from rcbht_jax.introspection.chain import begin_stream
from rcbht_jax.introspection.introspector import Chain, infer
from rcbht_jax.introspection.model import IntrospectionModel, head_arrays
from rcbht_jax.types import Array

FORMAT = "rcbht-chain-1"
PLATFORMS = ("cpu", "cuda")
KNOWN_PLATFORMS = ("cpu", "cuda", "rocm", "tpu")
STABLEHLO, STATE, META = "chain.stablehlo", "state.npz", "chain.json"


def export_chain(model: IntrospectionModel, platforms: Sequence[str] = PLATFORMS) -> bytes:
    """The serialised chain of a model; see the module."""
    chain = Chain.of(model)
    start = begin_stream(chain.config, chain.views, len(model.axes))
    leaves, tree = jax.tree.flatten(start)
    limits = jnp.asarray(model.stacked_limits, jnp.float32)
    heads = tuple(jax.tree.map(jnp.asarray, head_arrays(head)) for head in model.heads)

    def run(state: list[Array], window: Array, count: Array, begins: Array) -> tuple[list[Array], list[Array], Array]:
        after, probabilities, published = infer(
            chain, limits, heads, jax.tree.unflatten(tree, state), window, count, begins
        )
        return jax.tree.leaves(after), list(probabilities), published.ints

    window = jax.ShapeDtypeStruct((model.encoder.window, len(model.axes)), jnp.float32)
    count = jax.ShapeDtypeStruct((), jnp.int32)
    begins = jax.ShapeDtypeStruct((len(chain.views),), jnp.int32)
    shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
    exported = export.export(jax.jit(run), platforms=tuple(platforms))(shapes, window, count, begins)
    require("flatbuffers", "export")  # of jax.export, which does not install it
    return bytes(exported.serialize())


def write_chain(path: Path, model: IntrospectionModel, platforms: Sequence[str] = PLATFORMS) -> dict[str, Any]:
    """Write the artefact, whole or not at all; returns its description.

    Raises:
        InputError: the folder does not exist, or there is no such platform.
    """
    unknown = set(platforms) - set(KNOWN_PLATFORMS)
    if unknown or not platforms:
        raise InputError(
            f"no chain for {', '.join(sorted(unknown)) or 'nothing'}: choose {', '.join(KNOWN_PLATFORMS)}."
        )
    chain = Chain.of(model)
    meta = {
        "format": FORMAT,
        "version": model.version,
        "data_hash": model.data_hash,
        "platforms": list(platforms),
        "axes": list(model.axes),
        "units": list(model.units),
        "dt": model.encoder.dt,
        "window": model.encoder.window,
        "encoder": config_fields(model.encoder),
        "sentences": list(chain.scopes),
        "heads": [{"name": head.name, "classes": list(head.classes), "alarm": head.alarm} for head in model.heads],
    }
    state = io.BytesIO()
    leaves = jax.tree.leaves(begin_stream(chain.config, chain.views, len(model.axes)))
    np.savez(state, allow_pickle=False, **{f"{k:03d}": np.asarray(leaf) for k, leaf in enumerate(leaves)})
    code = export_chain(model, platforms)
    try:
        with atomic_write(path) as draft, zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(META, json.dumps(meta, indent=1))
            archive.writestr(STATE, state.getvalue())
            archive.writestr(STABLEHLO, code)
    except OSError as error:
        raise InputError(f"the chain cannot be written to {path}: {error}.") from error
    return meta
