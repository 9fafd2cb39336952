"""Import of files of any robot: find, read, understand, bring onto one grid, report.

Notes (semicolon-separated in ``Recordings.note``): ``uneven`` (interpolated at its own rate), ``resampled:RATE`` (from
that rate), ``filtered`` (before that), ``gap:SECONDS`` (the longest), ``gaps:COUNT``, ``saturated:AXIS``,
``stuck:AXIS``, ``counts`` (were divided), ``other-arrays:COUNT`` (arrays), ``missing:COUNT``, ``repeated:COUNT``,
``unordered:COUNT``, ``reversed``, ``padded:COUNT``, ``between:COUNT``, ``held:COUNT``, ``zeros:COUNT`` (samples),
``windows:COUNT`` (of so many samples), ``lines:COUNT`` (that are no samples), ``restarts:COUNT`` (of the time),
``again:COUNT`` (values of the group that come again after others), ``cp1252``, ``cp1251``, ``cp932``, ``gb18030``,
``changes:COLUMN`` (one that should be constant), ``beginning-of:OTHER``, ``copy-of:OTHER``,
``contradictory-duplicate:OTHER``, ``the-bag-ends-early``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from rcbht_jax._util.digest import files_hash
from rcbht_jax._util.printable import plural, spelled
from rcbht_jax._util.untrusted import check_inside, leads_out
from rcbht_jax.errors import InputError
from rcbht_jax.io import store
from rcbht_jax.io.importing import arrays, columnar, listing, marks
from rcbht_jax.io.importing.arms import PLACE, tables_of_arms
from rcbht_jax.io.importing.assemble import assemble
from rcbht_jax.io.importing.cases import read_blocks, read_ts
from rcbht_jax.io.importing.clock_parts import with_whole_times
from rcbht_jax.io.importing.constants import constants_of, describe, without_properties
from rcbht_jax.io.importing.exported import attrs_of_export, not_read, read_export
from rcbht_jax.io.importing.find import Item, chosen, find, is_export
from rcbht_jax.io.importing.given import from_start, possible
from rcbht_jax.io.importing.guess import Meaning, Understood, guess, merged, some, stated_words
from rcbht_jax.io.importing.json_documents import read_json_document
from rcbht_jax.io.importing.json_lines import read_json_lines
from rcbht_jax.io.importing.long_form import widened
from rcbht_jax.io.importing.mapping import Mapping, Track, Value, check
from rcbht_jax.io.importing.matlab import read_matlab
from rcbht_jax.io.importing.names import column_name
from rcbht_jax.io.importing.record import Record, Row, records
from rcbht_jax.io.importing.remarks import Lacks, doubts_on, remarks_on
from rcbht_jax.io.importing.report import ImportReport, most_common, without_copies
from rcbht_jax.io.importing.sidecars import Sidecars, sidecars_of
from rcbht_jax.io.importing.table import Table
from rcbht_jax.io.importing.text import read_csv
from rcbht_jax.io.importing.unpacked import doubts, plain_name
from rcbht_jax.io.importing.words import text
from rcbht_jax.io.importing.zarr_groups import read_zarr
from rcbht_jax.types import Recordings

Constants = dict[str, dict[str, float]]  # recording -> column -> value
Progress = Callable[[list[Item]], Iterable[Item]]


@dataclass(frozen=True)
class Imported:
    """Recordings, the mapping that was used, and the report on every file."""

    recordings: Recordings
    mapping: Mapping  # of the first file, with the annotations and columns of all
    report: ImportReport
    attrs: dict[str, str] = field(default_factory=dict)  # of the store, as the files state them


def read_source(
    source: Path,
    kind: str = "auto",
    mapping: Mapping | None = None,
    progress: Progress = iter,
    keep_copies: bool = False,
) -> Imported:
    """Read a file, or every file below a folder; a broken one is reported and does not stop the import.

    >>> imported = read_source(Path("runs"), "csv")
    >>> len(imported.recordings), imported.report.skipped
    (1, [])

    Args:
        source: a file or a folder.
        kind: one of :data:`rcbht_jax.io.importing.find.KINDS`; "auto" = by suffix.
        mapping: what the columns mean; :func:`~rcbht_jax.io.importing.guess.guess` finds what it leaves open.
        progress: wraps the list of files, for a progress bar.
        keep_copies: also import recordings that are exact copies of others, and note ``copy-of:OTHER``.

    Raises:
        InputError: the source holds no usable recording, the mapping contradicts itself, or a package is missing.
    """
    base = check(mapping or Mapping())
    items, others = chosen(source, *find(source, kind), base.files)
    if base.topic and not any(item.kind in ("bag", "mcap") for item in items):
        raise InputError(f"{source} holds no bag, and only a bag has topics; leave out the topic {base.topic}.")
    if items[0].kind == "export":
        if base != Mapping():
            raise InputError(
                f"{source} was written by rcbht export and is read as it is; leave out --map and its options."
            )
        return _exported(source, items[0], others)
    report = ImportReport()
    others = [name for name in others if name not in marks.described_by(base, items)]
    beside = sidecars_of(source, items, others)
    report.remarks += _unread(source, [name for name in others if name not in beside.files])
    if beside.files:
        were = plural(len(beside.files), "JSON document describes recordings", "JSON documents describe recordings")
        report.remarks.append(f"{were}: {some(beside.files)}.")
    read, used, tables, constants = _read(source, items, base, beside, report, progress)
    if not base.channels and not base.bias:
        read = _properties(read, used)
    found = [record for record, _ in read]
    words = _judge(found, base)
    names = marks.Names(((record.file, record.part) for record in found), [record.arm for record in found])
    _beside(source, read, [track for track in base.annotations if not track.column], names, report)
    _attach(found, tables, names, report)
    for record in found:
        record.intervals[:], problems = possible(record.intervals, record.end)
        report.warnings += [(record.name, problem) for problem in problems]
    found = most_common(without_copies(found, report, keep_copies), report)
    if not found:
        raise InputError(f"{source} holds no usable recording.{report.first_reason}")
    _warn_of_sources(found, used, report)
    described = describe(found, constants)
    recordings = assemble(found, source, base.rate, report)
    constant = Mapping(columns={own: Value(name) for name, own in described.items()})
    of_constants = [Understood(name, f"column {own}") for name, own in described.items()]
    first, rows = merged([*(used[record.name] for record in found), (constant, of_constants)])
    if any(PLACE in channel.column for channel in first.channels):
        first = replace(first, arms=base.arms or tuple(dict.fromkeys(str(one.columns["arm"]) for one in found)))
    if words and "outcome" in first.columns:
        first = replace(first, columns={**first.columns, "outcome": replace(first.columns["outcome"], words=words)})
    report.understood = [asdict(row) for row in rows]
    report.content_sha256 = _digest(source, [*items, *(Item(name, source / name, "json") for name in beside.files)])
    return Imported(recordings, first, report)


def import_source(
    source: Path,
    path: Path,
    kind: str = "auto",
    mapping: Mapping | None = None,
    overwrite: bool = False,
    progress: Progress = iter,
    keep_copies: bool = False,
) -> Imported:
    """Read a file or a folder as :func:`read_source` does, and write it as a store at ``path``.

    >>> import_source(Path("runs"), Path("runs.zarr"), "csv").recordings.axes
    ('Fz',)

    Raises:
        InputError: as :func:`read_source`, or ``path`` exists and ``overwrite`` is false.
    """
    store.check_target(path, overwrite)
    imported = read_source(source, kind, mapping, progress, keep_copies)
    report = imported.report
    attrs = {"importer": kind, "source_sha256": report.content_sha256, "import_report": report.to_dict()}
    store.write_recordings(path, imported.recordings, attrs | imported.attrs, overwrite)
    return imported


def _tables(item: Item, mapping: Mapping) -> Iterator[Table]:
    """The tables of a file, or of a folder that is one recording."""
    if item.kind in ("bag", "mcap"):
        from rcbht_jax.io.importing.bags import read_bag_tables  # rosbags is an extra of its own

        return read_bag_tables(item.path, item.title, mapping.topic)
    readers = {
        "csv": read_csv, "parquet": columnar.read_parquet, "npz": arrays.read_npz, "hdf5": arrays.read_hdf5,
        "matlab": read_matlab, "lerobot": columnar.read_lerobot, "ts": read_ts, "uci": read_blocks,
        "jsonl": read_json_lines, "json": read_json_document, "zarr": read_zarr,
    }  # fmt: skip
    return readers[item.kind](item.path, item.name if item.kind == "lerobot" else item.title)


def _unread(source: Path, others: list[str]) -> list[str]:
    """Remarks on what was not read of a source."""
    exports = [name for name in others if is_export(source / name)]
    were = plural(len(exports), "folder that rcbht export wrote was", "folders that rcbht export wrote were")
    how = f"{were} not read: {some(exports)}. Import each alone, and join the stores: rcbht join."
    others = [name for name in others if name not in exports]
    listed = ", ".join(others[:5]) + (", ..." if len(others) > 5 else "")
    rest = f"{plural(len(others), 'other file was', 'other files were')} not read: {listed}."
    return ([how] if exports else []) + ([rest] if others else [])


def _exported(source: Path, item: Item, others: list[str]) -> Imported:
    check_inside(source, source)
    recordings = read_export(item.path)
    names = [f"{trial}/{arm}" for trial, arm in zip(recordings.trial.tolist(), recordings.arm.tolist(), strict=True)]
    left = " and ".join(not_read(item.path))
    remark = f"{spelled(item.path.name)} was written by rcbht export; read as it is, but for {left}."
    report = ImportReport(names, remarks=[remark])
    report.remarks += _unread(source, others)
    report.content_sha256 = _digest(source, [item])
    return Imported(recordings, Mapping(), report, attrs_of_export(item.path))


def _read(
    source: Path, items: list[Item], base: Mapping, beside: Sidecars, report: ImportReport, progress: Progress
) -> tuple[list[tuple[Record, Item]], dict[str, Meaning], list[Table], Constants]:
    """The recordings of all files and where each is from, the mapping of each, tables of intervals, and constants."""
    found: list[tuple[Record, Item]] = []
    used: dict[str, Meaning] = {}
    marked = list(beside.tables)
    constants: Constants = {}
    listed: Table | None = None
    if not base.table and source.is_dir():
        base, listed = listing.with_table(source, base, items, report.remarks)
    tables = set(map(plain_name, marks.described_by(base, items)))
    files = [item.title for item in items if item.name not in tables]
    rows = listing.rows_of(source, base, files, report.warnings, listed)
    lacks = Lacks(base)
    for item in progress(items):
        if item.name in tables:
            continue
        try:
            if source.is_dir():
                check_inside(item.path, source)
            wide = (widened(with_whole_times(table, base), base) for table in _tables(item, base))
            for table in (arm for whole in wide for arm in tables_of_arms(whole, base)):
                named = marks.counted(marks.headed(table)) if item.kind == "csv" else table
                if item.kind == "csv" and marks.is_intervals(named.columns):
                    marked.append(marks.with_words(named, item.path))
                    report.remarks += marks.unused(named)
                    report.warnings += doubts(named.name, named.notes)
                    continue
                described = beside.described(table)
                try:
                    for record, meaning in _understood(described, base, rows, report):
                        found.append((record, item))
                        used[record.name] = meaning
                        if not base.channels and not meaning[0].group:
                            unused = (row.column for row in meaning[1] if row.role == "left out")
                            constants[record.name] = constants_of(table, unused)
                    lacks.add(described)
                except InputError as error:  # the other tables of the file may be usable
                    report.skipped.append((table.name, _reason(error, source)))
                    lacks.add(described, read=False)
        except InputError as error:
            report.skipped.append((item.title, _reason(error, source)))
    report.warnings, report.remarks = report.warnings + lacks.warnings(), report.remarks + lacks.remarks()
    if lost := listing.absent(rows, (record for record, _ in found), (name for name, _ in report.skipped)):
        report.warnings.append((base.table, lost))
    return found, used, marked, constants


def _properties(read: list[tuple[Record, Item]], used: dict[str, Meaning]) -> list[tuple[Record, Item]]:
    """The recordings without guessed axes that are one number in each: these describe them, also in ``used``."""
    alike: dict[tuple[str, ...], list[int]] = {}
    for place, (record, _) in enumerate(read):
        alike.setdefault(record.axes, []).append(place)
    read = list(read)
    for places in alike.values():
        found, names = without_properties([read[place][0] for place in places])
        for place, record in zip(places, found, strict=True):
            read[place] = record, read[place][1]
            if names:
                used[record.name] = _described_by(*used[record.name], names)
    return read


def _described_by(mapping: Mapping, rows: list[Understood], names: list[str]) -> Meaning:
    """The meaning of columns where some channels became columns of the store."""
    owns = {one.column: one.name or one.column for one in mapping.channels if (one.name or one.column) in names}
    columns = {column_name(name): Value(column) for column, name in owns.items()}
    channels = tuple(one for one in mapping.channels if one.column not in owns)
    meant = {column: Understood(column, f"column {column_name(name)}") for column, name in owns.items()}
    rows = [meant.get(row.column, row) for row in rows]
    return replace(mapping, channels=channels, columns={**columns, **mapping.columns}), rows


def _understood(
    table: Table, base: Mapping, rows: dict[str, Row], report: ImportReport
) -> Iterator[tuple[Record, Meaning]]:
    """The recordings of a table, and the meaning of its columns."""
    mapping, _ = meaning = guess(table, base)
    report.remarks += [text for text in remarks_on(table, mapping, base) if text not in report.remarks]
    report.warnings += [(table.name, doubt) for doubt in doubts_on(table, mapping)]
    for record in records(table, mapping, rows):
        if isinstance(record, tuple):
            report.skipped.append(record)
            continue
        if base.table and not record.listed:
            report.warnings.append((record.name, f"{base.table} has no row for it."))
        if "changes:outcome" in record.notes:
            report.warnings.append((record.name, "states several outcomes; its outcome is unknown."))
        report.warnings += [(record.name, doubt) for doubt in record.doubts]
        yield record, meaning


def _judge(found: list[Record], base: Mapping) -> dict[str, str]:
    """Say success and failure for the words of an outcome whose mapping states none; returns what they mean."""
    words = stated_words(
        base.columns.get("outcome", Value("outcome")), (text(one.columns.get("outcome", "")) for one in found)
    )
    for columns in (record.columns for record in found if words and "outcome" in record.columns):
        word = text(columns["outcome"])
        columns["outcome"] = words.get(word.lower(), word)
    return words


def _warn_of_sources(found: list[Record], used: dict[str, Meaning], report: ImportReport) -> None:
    """Warn of recordings whose axes have other columns than those of most: they may be of another sensor."""
    sources = {record.name: tuple(channel.column for channel in used[record.name][0].channels) for record in found}
    [(common, _)] = Counter(sources.values()).most_common(1)
    for name, columns in sources.items():
        pairs = zip(columns, common, strict=True)
        if other := next(((one, usual) for one, usual in pairs if one.lower() != usual.lower()), None):
            text = "its axes are the columns {!r}, ...; those of most recordings are {!r}, .... Is it the same sensor?"
            report.warnings.append((name, text.format(*other)))


def _reason(error: InputError, source: Path) -> str:
    """The reason for the report, which is stored: it must not contain folders of the importing machine."""
    return spelled(str(error).replace(f"{source}/", ""))


def _beside(
    source: Path, read: list[tuple[Record, Item]], tracks: list[Track], names: marks.Names, report: ImportReport
) -> None:
    """Add the intervals that files beside the recordings hold; a missing file leaves the others."""
    known = [dict[Path, marks.Marks]() for _ in tracks]
    for place, (record, item) in enumerate(read):
        file = Path(plain_name(source.name if item.path == source else str(item.path.relative_to(source))))
        for track, held in zip(tracks, known, strict=True):
            try:
                intervals = marks.track_intervals(source, file, track, names, place, report.warnings, held)
            except InputError as error:
                report.warnings.append((record.name, _reason(error, source)))
                continue
            shift = record.origin if track.clock == "stamps" else 0.0
            record.intervals.extend((name, label, start - shift, end - shift) for name, label, start, end in intervals)


def _attach(found: list[Record], tables: list[Table], names: marks.Names, report: ImportReport) -> None:
    """Give recordings the intervals of tables that name them, or that are named after them."""
    for table in tables:
        try:
            rows = marks.intervals_of(table, Track("label", file=table.name))
        except InputError as error:
            report.warnings.append((table.name, str(error)))
            continue
        of_each, twofold, unknown = marks.by_recording(rows, names, marks.named_after(table.name))
        for place, intervals in of_each.items():
            record = found[place]
            if marks.SAMPLES in table.notes:
                record.intervals.extend(marks.at_samples(intervals, record.time, record.period))
                continue
            moved, doubts = from_start(intervals, record.origin, record.end, record.period)
            record.intervals.extend(moved)
            report.warnings += [(record.name, f"{doubt[:-1]} ({table.name}).") for doubt in doubts]
        report.warnings += [(table.name, marks.ambiguous(word)) for word in twofold]
        if not of_each and not twofold:
            report.warnings.append(
                (table.name, "is a table of annotations, and no recording is named in it or like it.")
            )
        elif lost := list(filter(None, unknown)):
            count = plural(sum(word in lost for word, _ in rows), "annotation is", "annotations are")
            report.warnings.append((table.name, f"{count} of no recording here, and left out: {some(lost)}."))


def _digest(source: Path, items: Iterable[Item]) -> str:
    """Digest of the files of a source by relative name and content."""
    files = (sorted(item.path.rglob("*")) if item.path.is_dir() else [item.path] for item in items)
    root = source if source.is_dir() else source.parent
    own = (path for some in files for path in some if (path.is_file() and path == source) or not leads_out(path, root))
    return files_hash(root, own)
