"""Several stores as one: recorded and simulated trials that train together, or the days of a campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from rcbht_jax._util.columns import kind_of, unit_factor
from rcbht_jax._util.digest import wrench_digests
from rcbht_jax.annotations import Annotations, corrected_variant
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.simulation import ORIGINS, origin_of
from rcbht_jax.io.tare import tare
from rcbht_jax.labels import UNITS
from rcbht_jax.types import Recordings

_Seen = tuple[Path, bytes, Recordings, int]  # store, digest of the samples, its recordings, row
KEPT = ("importer", "frames")  # attributes that the joined store has where all stores agree


@dataclass(frozen=True)
class Joined:
    """Recordings taken from each store."""

    taken: dict[str, int]  # recordings, by store
    copies: dict[str, int]  # recordings left out, since an earlier store has them


def join_stores(paths: Sequence[Path], out: Path, *, tare_seconds: float = 0.0, overwrite: bool = False) -> Joined:
    """Write the recordings of several stores, with annotations and columns, as one store.

    Label tracks and the parameters of simulations are left out. Exact copies (source, trial, arm, samples, and what is
    known of them) are taken once. If only some stores have a corrected track (TRACK-harmonised), that of the others is
    a copy of TRACK, as tasks use TRACK in a store without a corrected one. All recordings are in memory at the same
    time.

    >>> from rcbht_jax.io.store import write_recordings
    >>> for name in ("first.zarr", "second.zarr"):
    ...     wrench = np.random.default_rng(len(name)).normal(size=(300, 6))
    ...     write_recordings(Path(name), Recordings.from_arrays([wrench], 200.0, trial=[name]), {})
    >>> join_stores([Path("first.zarr"), Path("second.zarr")], Path("both.zarr")).taken
    {'first.zarr': 1, 'second.zarr': 1}

    Args:
        paths: of two stores or more, with the same axes, units and sampling period.
        out: store to create.
        tare_seconds: subtract from each recording the mean of so many seconds at its beginning; 0 = nothing.
        overwrite: replace an existing store once the new one is complete.

    Raises:
        InputError: fewer than two stores, one of them twice, a store that cannot be read, other axes, units or periods,
            text and numbers in one column, or two different recordings of one name; ``out`` is one of the stores, or
            exists and ``overwrite`` is false.
    """
    if len(paths) < 2:
        raise InputError(f"Expected at least two stores to join, not {len(paths)}.")
    if twice := next((path for place, path in enumerate(paths) if path in paths[:place]), None):
        raise InputError(f"{twice} is named twice; name each store once.")
    if not 0 <= tare_seconds < float("inf"):
        raise InputError(f"The tare is {tare_seconds} s; expected zero or more.")
    if any(path.resolve() == out.resolve() for path in paths):
        raise InputError(f"{out} is one of the stores to join, and would lose its label tracks; choose another name.")
    store.check_target(out, overwrite)
    parts = [store.read_recordings(path) for path in paths]
    _check(paths, parts)
    taken, copies, chosen, seen = dict[str, int](), dict[str, int](), list[Recordings](), dict[tuple[str, ...], _Seen]()
    for path, part in zip(paths, parts, strict=True):
        new = _new(path, part, seen)
        taken[str(path)], copies[str(path)] = int(new.sum()), int((~new).sum())
        if new.any():
            chosen.append(part.take(np.flatnonzero(new)))
    _check_columns([path for path in paths if taken[str(path)]], chosen)
    whole = Recordings.join(_corrected(chosen))
    if tare_seconds:
        whole = tare(whole, max(1, round(tare_seconds / whole.dt)))
    store.write_recordings(out, whole, _attrs(paths, taken, tare_seconds), overwrite)
    return Joined(taken, copies)


def _check(paths: Sequence[Path], parts: Sequence[Recordings]) -> None:
    """Check that the recordings can be in one store; errors name the stores."""
    for path, part in zip(paths[1:], parts[1:], strict=True):
        if part.dt != parts[0].dt:
            raise InputError(
                f"{path} has {1 / part.dt:g} samples a second, {paths[0]} has {1 / parts[0].dt:g}; import one again, "
                "with --rate."
            )
        if (part.axes, part.units) != (parts[0].axes, parts[0].units):
            how = _same_units(path, part, paths[0], parts[0]) if part.axes == parts[0].axes else ""
            raise InputError(f"{path} has {_axes(part)}; {paths[0]} has {_axes(parts[0])}.{how}")


def _check_columns(paths: Sequence[Path], parts: Sequence[Recordings]) -> None:
    """Check that each column holds values of one kind; errors name the stores."""
    known = dict[str, tuple[str, Path]]()
    for path, part in zip(paths, parts, strict=True):
        for name, column in part.columns.items():
            kind, first = known.setdefault(name, (kind_of(column), path))
            if kind_of(column) != kind:
                raise InputError(
                    f"{path} has {kind_of(column)} in the column {name}, {first} has {kind}; import one again with a "
                    "map that gives it another name or other values."
                )


def _same_units(path: Path, part: Recordings, first_path: Path, first: Recordings) -> str:
    """How the recordings of two stores get the same units: those of the first, or N and Nm if the other has them."""
    if all(unit in UNITS for unit in part.units):
        path, part, first = first_path, first, part
    apart = [one for one in zip(part.axes, part.units, first.units, strict=True) if one[1] != one[2]]
    if any("" in one[1:] for one in apart):
        return " State units in the names of columns, such as Fx [N], or in a map, and import again."
    channels = dict[str, list[str]]()
    for axis, unit, other in apart:
        if not (ratio := unit_factor(unit, other)):
            return ""
        channels.setdefault(f'scale = {ratio:.10g} and unit = "{other}"', []).append(axis)
    needs = "; ".join(f"{content} for {', '.join(axes)}" for content, axes in channels.items())
    return f" Import {path} again with a map that has {needs}."


def _corrected(parts: Sequence[Recordings]) -> list[Recordings]:
    """The parts, each with a corrected track wherever any part has it, so that tasks find the recordings of all."""
    tracks = dict.fromkeys(track for part in parts for track in part.annotations.tracks)
    pairs = [(track, variant) for track in tracks if (variant := corrected_variant(track)) in tracks]
    found = []
    for part in parts:
        marks = part.annotations
        plain = [(track, variant) for track, variant in pairs if track in marks.labels and variant not in marks.labels]
        copies = [replace(marks.of(track), labels={variant: marks.labels[track]}) for track, variant in plain]
        found.append(replace(part, annotations=Annotations.join([marks, *copies])) if copies else part)
    return found


def _axes(part: Recordings) -> str:
    return ", ".join(f"{axis} in {unit or '?'}" for axis, unit in zip(part.axes, part.units, strict=True))


def _new(path: Path, part: Recordings, seen: dict[tuple[str, ...], _Seen]) -> Bool[np.ndarray, " recording"]:
    """Which recordings no earlier store has; ``seen`` holds those that one has, by name."""
    names = list(zip(part.source.tolist(), part.trial.tolist(), part.arm.tolist(), strict=True))
    digests = [row.tobytes() for row in wrench_digests(part.wrench, part.length)]
    for row, (name, digest) in enumerate(zip(names, digests, strict=True)):
        if name not in seen:
            continue
        other, digest_there, whole, place = seen[name]
        if digest != digest_there:
            raise InputError(f"{path} has another recording {name[1]!r} of {name[0]!r} than a store before it.")
        if _facts(part, row) != _facts(whole, place):
            raise InputError(
                f"{path} and {other} have the same recording {name[1]!r} of {name[0]!r} with another outcome or "
                "session, other columns or other annotations, some of which would be lost; leave one of the stores out."
            )
    new = np.array([name not in seen for name in names], bool)
    for row, (name, digest) in enumerate(zip(names, digests, strict=True)):
        seen.setdefault(name, (path, digest, part, row))
    return new


def _facts(part: Recordings, row: int) -> tuple[Any, ...]:
    """What is known of a recording, but for its note; annotations as text, of which unknown times are equal."""
    one = part.take([row])
    known = {name: values[0].item() for name, values in one.columns.items() if str(values[0]) not in ("", "nan")}
    marks = one.annotations
    tracks = np.array(marks.tracks, object)[marks.track].tolist()
    rows = zip(tracks, marks.names().tolist(), marks.start.tolist(), marks.end.tolist(), strict=True)
    return str(one.outcome[0]), str(one.session[0]), known, sorted(map(repr, rows))


def _attrs(paths: Sequence[Path], taken: dict[str, int], tare_seconds: float) -> dict[str, Any]:
    """Where the recordings come from."""
    every = [store.read_attrs(path) for path in paths]
    joined = [
        {"store": path.name, "content_sha256": attrs.get("content_sha256"), "recordings": taken[str(path)]}
        for path, attrs in zip(paths, every, strict=True)
    ]
    origins = {origin_of(attrs) for attrs, one in zip(every, joined, strict=True) if one["recordings"]}
    origin = "" if "" in origins else origins.pop() if len(origins) == 1 else ORIGINS[-1]
    every = [{**attrs, "importer": importer_of(attrs)} for attrs in every]
    values_of = {name: {str(attrs.get(name, "")) for attrs in every} for name in KEPT}
    same = {name: values.pop() for name, values in values_of.items() if len(values) == 1}
    kept = {"importer": "joined", "origin": origin, **{name: value for name, value in same.items() if value}}
    return {**kept, "joined": joined, "tare_s": tare_seconds}


def importer_of(attrs: Mapping[str, Any]) -> str:
    """What made a store: a simulation of HIRO's trials, which names no importer, counts as theirs; "" = not known.

    >>> importer_of({"simulated": {}}), importer_of({"importer": "csv"}), importer_of({"robot": "mine"})
    ('hiro', 'csv', '')
    """
    return str(attrs.get("importer", "hiro" if "simulated" in attrs else ""))
