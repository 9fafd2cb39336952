"""Files of segmenters: arrays and one JSON text. Loading runs no code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rcbht_jax
from rcbht_jax._util.untrusted import checked_texts
from rcbht_jax._util.url_path import as_path
from rcbht_jax.encoding.rules import (
    AnyConfig,
    AnyLimits,
    checked_limits,
    config_fields,
    config_from,
    limit_arrays,
    limits_from,
)
from rcbht_jax.errors import InputError
from rcbht_jax.features.trailing import columns_of
from rcbht_jax.learning.forest import Forest
from rcbht_jax.learning.model_io import reading, write_archive

FORMAT = "rcbht-segmenter-1"
FORESTS = ("first", "second")


@dataclass(frozen=True)
class SegmenterFile:
    """A fitted causal segmenter, with what its input and its classes are called."""

    track: str  # of annotations, whose labels it learned
    classes: tuple[str, ...]
    axes: tuple[str, ...]
    units: tuple[str, ...]
    words: bool  # whether it reads words
    encoder: AnyConfig  # of the words; its period is that of the samples
    limits: AnyLimits  # of the words
    first: Forest
    second: Forest
    arm: str = ""  # whose wrench it learned; "" = the last by name, as the right one

    @classmethod
    def of(cls, segmenter: Any, track: str, labels: tuple[str, ...], arm: str = "") -> SegmenterFile:
        """What a stream needs of a fitted segmenter.

        Args:
            segmenter: a fitted, causal :class:`rcbht_jax.introspection.segmenter.WrenchSegmenter`.
            track: of the annotations that it learned.
            labels: of the track, by code.
            arm: whose wrench it learned; "" = the last by name, as the right one.

        Raises:
            NotFittedError: of scikit-learn: it is not fitted.
            InputError: it reads later samples.
        """
        (encoder, limits), (axes, units) = segmenter.encoder(), segmenter.axes_
        if segmenter.offline:
            raise InputError("A segmenter that reads later samples cannot follow a stream; leave out --offline.")
        first, second = (Forest.of(forest, segmenter.classes_) for forest in (segmenter.first_, segmenter.second_))
        classes = tuple(labels[code] for code in segmenter.classes_)
        return cls(track, classes, axes, units, bool(segmenter.words), encoder, limits, first, second, arm)


def save(path: Path | str, file: SegmenterFile) -> None:
    """Write a segmenter to a single file of any suffix, whole or not at all.

    Raises:
        InputError: the folder does not exist.
    """
    plain = {name: getattr(file, name) for name in ("track", "classes", "axes", "units", "words", "arm")}
    meta = {"format": FORMAT, "version": rcbht_jax.__version__, "encoder": config_fields(file.encoder), **plain}
    trees = file.first.arrays("first.") | file.second.arrays("second.")
    write_archive(path, meta, dict(limit_arrays(file.limits)) | trees)


def load(path: Path | str) -> SegmenterFile:
    """Read what :func:`save` wrote.

    Raises:
        InputError: missing, damaged, or not a segmenter.
    """
    path = as_path(path)
    with reading(path, FORMAT) as (meta, archive):
        config = config_from(meta["encoder"])
        limits = limits_from(config, archive)
        classes, axes, units = (
            tuple(checked_texts(f"its {name}", meta[name])) for name in ("classes", "axes", "units")
        )
        (track,), words = checked_texts("its track", [meta["track"]]), bool(meta["words"])
        if not len(checked_limits(config, limits)) == len(axes) == len(units) or len(classes) < 2:
            raise InputError("its axes, units, limits and classes do not fit each other")
        first, second = (
            Forest.from_arrays(archive, columns, len(classes), f"{name}.")
            for name, columns in zip(FORESTS, columns_of(units, len(classes), words), strict=True)
        )
        (arm,) = checked_texts("its arm", [meta.get("arm", "")])
        return SegmenterFile(track, classes, axes, units, words, config, limits, first, second, arm)
