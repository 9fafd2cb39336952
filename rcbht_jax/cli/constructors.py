"""How values of options are read from words and shown in help, where tyro's own way does not fit."""

from __future__ import annotations

import typing
from dataclasses import replace
from pathlib import Path
from typing import Any

import tyro

from rcbht_jax._util.url_path import as_path

RULES = tyro.constructors.ConstructorRegistry()


@RULES.primitive_rule
def _path(info: tyro.constructors.PrimitiveTypeInfo) -> Any:
    """A file, a folder or a URL, which Path would fold."""
    if info.type is not Path:
        return None
    return tyro.constructors.PrimitiveConstructorSpec[Path](
        nargs=1,
        metavar="PATH",
        instance_from_str=lambda words: as_path(words[0]),
        is_instance=lambda value: isinstance(value, Path),
        str_from_instance=lambda path: [str(path)],
    )


@RULES.primitive_rule
def _optional(info: tyro.constructors.PrimitiveTypeInfo) -> Any:
    """An option that may be None is shown as what it takes, and is None only if it is left out."""
    kinds = [kind for kind in typing.get_args(info.type) if kind is not type(None)]
    if len(kinds) != 1 or type(None) not in typing.get_args(info.type):
        return None
    inner = tyro.constructors.PrimitiveTypeInfo.make(kinds[0], info.markers)
    spec = tyro.constructors.ConstructorRegistry.get_primitive_spec(inner)
    if isinstance(spec, tyro.constructors.UnsupportedTypeAnnotationError):
        return spec
    words = spec.str_from_instance
    return replace(
        spec,
        is_instance=lambda value: value is None or spec.is_instance(value),
        str_from_instance=lambda value: [] if value is None else words(value),
    )
