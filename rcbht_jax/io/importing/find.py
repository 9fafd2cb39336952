"""Files of a source and their kinds."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from rcbht_jax._util.printable import spelled
from rcbht_jax._util.untrusted import MAX_FILES, read_object
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.unpacked import plain_name
from rcbht_jax.io.importing.words import in_order

SUFFIXES = {
    ".csv": "csv", ".tsv": "csv", ".parquet": "parquet", ".pq": "parquet", ".feather": "parquet", ".arrow": "parquet",
    ".npz": "npz", ".npy": "npz", ".h5": "hdf5",
    ".hdf5": "hdf5", ".hdf": "hdf5", ".mat": "matlab", ".mcap": "mcap", ".bag": "bag", ".db3": "bag", ".ts": "ts",
    ".jsonl": "jsonl", ".ndjson": "jsonl", ".json": "json",
}  # fmt: skip
TEXTS = (".txt", ".dat", ".data", ".log", ".lvm", ".asc")  # where "csv" or "uci" is asked for
KINDS = (
    "auto", "csv", "parquet", "npz", "hdf5", "matlab", "mcap", "bag", "lerobot", "ts", "uci", "jsonl", "json", "zarr",
)  # fmt: skip
OWN = "rcbht-"  # beginning of the attribute "format" of what this program writes
WORKBOOKS = (".xlsx", ".xlsm", ".xls", ".xlsb", ".ods", ".numbers")
_OF_TEXT = ("csv", "uci", "ts", "jsonl", "json")  # which may be packed


@dataclass(frozen=True)
class Item:
    """A file, or a folder that is one recording or data set."""

    name: str  # relative to the source, as it can be written, without the ending of a packed one
    path: Path
    kind: str  # one of KINDS but "auto", or "export"

    @property
    def title(self) -> str:
        """The name in messages: also of a source that is one recording by itself."""
        return self.name or spelled(self.path.name)


def kind_of(name: str, asked: str = "auto") -> str:
    """The kind of a file, perhaps packed, by the end of its name and the kind that the user asked for; "" = unknown.

    >>> kind_of("run.csv.gz"), kind_of("run.log"), kind_of("run.log", "csv"), kind_of("run.npz.gz")
    ('csv', '', 'csv', '')
    """
    plain = plain_name(name)
    if plain.lower().endswith(".zarr.zip"):
        return "zarr"
    suffix = PurePosixPath(plain).suffix.lower()
    found = asked if asked in ("csv", "uci") and suffix in TEXTS else SUFFIXES.get(suffix, "")
    return found if plain == name or found in _OF_TEXT else ""


def find(source: Path, kind: str = "auto") -> tuple[list[Item], list[str]]:
    """What to read of a source, sorted, and the names of other files in it.

    A source is a file, or a folder of files in any sub-folders; hidden ones are skipped. ``kind`` is one of ``KINDS``;
    "auto" = by suffix.

    Raises:
        InputError: the source is missing, or holds no file of that kind.
    """
    if kind not in KINDS:
        raise InputError(f"{kind!r} is not a kind of file; expected one of {', '.join(KINDS)}.")
    if not source.exists():
        raise InputError(f"{source} does not exist; expected a file or a folder.")
    if not source.is_dir():
        if source.suffix.lower() in WORKBOOKS:
            raise InputError(f"{source} is a workbook, which is not read; save its sheets as CSV, each as a file.")
        chosen = kind_of(source.name) if kind == "auto" else kind
        if not chosen or chosen == "lerobot":
            raise InputError(
                f"{source} is not a file of a known kind; name its kind, for example: rcbht import csv {source}."
            )
        return [Item(plain_name(spelled(source.name)), source, chosen)], []
    if _is_own(source):
        raise InputError(f"{source} is a store that rcbht wrote; use it as it is, or join it with others: rcbht join.")
    if (whole := _whole(source)) and (whole == kind or kind in ("auto", "bag", "mcap") or whole == "export"):
        return [Item("", source, whole)], []
    if kind == "lerobot":
        raise InputError(f"{source} has no meta/info.json; expected the folder of a LeRobot data set.")
    items, others = _listed(source, kind)
    if not items:
        what = "of a known kind" if kind == "auto" else f"of the kind {kind}"
        known = f" Files with these endings are read: {', '.join(SUFFIXES)}; save yours as one of them."
        text = f" Read text such as {', '.join(TEXTS)} with: rcbht import csv {source}."
        held = ", ".join(others[:5]) or "none"
        if any(is_export(source / name) for name in others):
            raise InputError(f"{source} holds what rcbht export wrote ({held}); import each folder alone.")
        if any(Path(name).suffix.lower() in WORKBOOKS for name in others):
            raise InputError(f"{source} holds workbooks, which are not read; save their sheets as CSV, each as a file.")
        texts = any(Path(name).suffix.lower() in TEXTS for name in others) and kind == "auto"
        raise InputError(f"{source} holds no file {what}; it holds {held}.{text if texts else known}")
    return sorted(items, key=lambda item: in_order(item.name)), others


def _listed(source: Path, kind: str) -> tuple[list[Item], list[str]]:
    """What to read of a folder of files, and the names of other files in it; an export is read only by itself."""
    items, documents, others = list[Item](), list[Item](), list[str]()
    for folder, folders, files in os.walk(source):
        here = Path(folder)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if here != source and (whole := _whole(here, foreign=not is_export(here))):
            name = spelled(here.relative_to(source).as_posix())
            if whole == "export" or (whole == "zarr" and (kind not in ("auto", whole) or _is_own(here))):
                others.append(name)
            else:
                items.append(Item(name, here, whole))
            folders.clear()
            continue
        for name in sorted(files):
            if not name.startswith("."):
                path, found = here / name, kind_of(name, kind)
                relative = spelled(path.relative_to(source).as_posix())
                if found and kind in ("auto", found):
                    of = plain_name(relative) if plain_name(name) not in files else relative
                    (documents if found == "json" else items).append(Item(of, path, found))
                else:
                    others.append(relative)
        if len(items) + len(documents) + len(others) > MAX_FILES:
            raise InputError(f"{source} holds more than {MAX_FILES} files; import its folders one by one.")
    if not items:
        return documents, others
    # beside other files, JSON describes recordings
    return items, others + [spelled(item.path.relative_to(source).as_posix()) for item in documents]


def chosen(
    source: Path, items: list[Item], others: list[str], patterns: tuple[str, ...]
) -> tuple[list[Item], list[str]]:
    """Of what :func:`find` found, what a pattern matches, and the names of all else; without patterns all.

    >>> items = [Item(name, Path(name), "csv") for name in ("a/ft.csv", "a/joints.csv")]
    >>> [item.name for item in chosen(Path("."), items, [], ("ft.csv",))[0]]
    ['a/ft.csv']

    Raises:
        InputError: no pattern matches a file.
    """
    if not patterns:
        return items, others
    read = [
        item for item in items if any(PurePosixPath(item.name).match(one) or item.path.match(one) for one in patterns)
    ]
    if not read:
        held = ", ".join(item.name for item in items[:5])
        raise InputError(f"{source} holds no file like {' or '.join(patterns)}; it holds {held}.")
    return read, others + [item.name for item in items if item not in read]


def _is_own(folder: Path) -> bool:
    """Whether a folder is a store, or labels, that this program wrote."""
    try:
        attributes = read_object(folder / "zarr.json").get("attributes")
    except InputError:
        return False
    return isinstance(attributes, dict) and str(attributes.get("format", "")).startswith(OWN)


def is_export(folder: Path) -> bool:
    """Whether a folder was written by ``rcbht export``; other programs call a file ``dataset.json``, too.

    >>> is_export(Path("runs"))
    False
    """
    try:
        return str(read_object(folder / "dataset.json").get("made_by", "")).startswith("rcbht-jax")
    except InputError:
        return False


def _whole(folder: Path, foreign: bool = False) -> str:
    """The kind of a folder that is one recording or data set, whose ``dataset.json`` may be foreign; "" = of files."""
    marks = {
        "dataset.json": "export", "meta/info.json": "lerobot", "metadata.yaml": "bag", ".zgroup": "zarr",
        "zarr.json": "zarr",
    }  # fmt: skip
    known = (kind for mark, kind in marks.items() if not (foreign and kind == "export") and (folder / mark).is_file())
    return next(known, "")
