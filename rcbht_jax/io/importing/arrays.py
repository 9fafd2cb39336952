"""Files of named arrays: NPZ (without pickles), and HDF5, also as MATLAB writes it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import decoded, unit_of_time
from rcbht_jax._util.optional import require
from rcbht_jax._util.untrusted import MAX_MEMBERS, check_declared, check_file, declared_bytes, read_arrays
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.attributes import scaled, stated_units, units_of
from rcbht_jax.io.importing.isolated import apart
from rcbht_jax.io.importing.names import names_side, wrenches
from rcbht_jax.io.importing.table import Table, tables_of
from rcbht_jax.io.importing.trees import Tree, leaves, put, separated


@contextmanager
def reading(path: Path, what: str) -> Iterator[None]:
    """Turn any exception of a reader into one InputError.

    >>> with reading(Path("a.npz"), "NPZ"):
    ...     raise ValueError("bad magic")
    Traceback (most recent call last):
    rcbht_jax.errors.InputError: a.npz is not a readable NPZ file: bad magic.
    """
    try:
        yield
    except InputError:
        raise
    except (MemoryError, RecursionError) as error:
        raise InputError(
            f"{path} is damaged: it asks for more memory than there is ({type(error).__name__})."
        ) from None
    except Exception as error:  # a damaged file fails in any way inside its reader
        detail = (str(error).splitlines() or [""])[0][:120].rstrip(".")
        raise InputError(f"{path} is not a readable {what} file: {detail or type(error).__name__}.") from None


def read_npz(path: Path, name: str) -> Iterator[Table]:
    """Tables of an NPZ file, or of one array in an NPY file; see :func:`~rcbht_jax.io.importing.table.tables_of`.

    Fields of structured arrays are arrays of their own. Arrays of Python objects are left out.

    >>> np.savez("a.npz", t=np.arange(9) * 0.01, wrench=np.zeros((9, 6)))
    >>> [list(table.columns)[:2] for table in read_npz(Path("a.npz"), "a.npz")]
    [['t', 'wrench_0']]

    Raises:
        InputError: not a regular file, damaged, holds nothing but Python objects, or declares arrays too large for it.
    """
    size = check_file(path)
    objects = list[str]()
    with reading(path, "NPZ"):
        if path.suffix.lower() == ".npy":
            with path.open("rb") as file:
                check_declared(path, declared_bytes(file), size)
            arrays = {"values": np.load(path, allow_pickle=False)}
        else:
            arrays = read_arrays(path, objects)
    alone = len(arrays) == 1
    fields = {key: array for key, array in arrays.items() if array.dtype.names}
    named = {
        field if alone else f"{key}.{field}": array[field]
        for key, array in fields.items()
        for field in array.dtype.names or ()
    }
    usable = {key: array for key, array in arrays.items() if key not in fields} | named
    try:
        for table in tables_of(path, name, usable):
            yield replace(table, others=(*table.others, *objects))
    except InputError as error:
        hint = f" Python objects ({', '.join(objects[:3])}) are never loaded." if objects else ""
        raise InputError(f"{error}{hint}") from None


@apart("h5py")
def read_hdf5(path: Path, name: str) -> Iterator[Table]:
    """Tables of an HDF5 file: sub-groups of like content are a recording each, else the whole file is one.

    Arrays below a group are its columns, by their path in it, as are fields of compound arrays and the columns of a
    table that pandas wrote; attributes are facts (dt, rate: the sampling).

    >>> [table.columns["Fz"].shape for table in read_hdf5(Path("run.h5"), "run.h5")]
    [(400,)]

    Raises:
        InputError: not a regular file, damaged, declares arrays too large for it, or h5py is missing.
    """
    yield from hdf5_tables(path, name)


def hdf5_tables(path: Path, name: str, turned: bool = False) -> Iterator[Table]:
    """As :func:`read_hdf5`, in this process, which a damaged file can keep busy without end.

    Dimensions are ``turned`` where they are stored in reverse, as MATLAB does.
    """
    size = check_file(path)
    h5py = require("h5py", "import")
    with reading(path, "HDF5"), h5py.File(path, "r") as file:
        datasets: list[Any] = []
        tree: Tree = {}
        for place, item in _members(file, {hash(file["/"].id)}):
            if isinstance(item, h5py.Dataset):
                datasets.append(item)
                if len(datasets) > MAX_MEMBERS:
                    raise InputError(f"{path} holds more than {MAX_MEMBERS} arrays; split it.")
                if item.shape is not None:  # it holds something
                    put(tree, place, item)
            elif isinstance(item, h5py.Group):
                put(tree, place, None)
        if any(item.external or item.is_virtual for item in datasets):
            raise InputError(f"{path} takes arrays from other files; copy them into it.")
        check_declared(
            path, sum(int(np.prod(item.shape or (0,), dtype=object)) * item.dtype.itemsize for item in datasets), size
        )
        group, parts = separated(tree, -1 if turned else 0) or ("", {"": dict(leaves(tree))})
        sides = all(map(names_side, parts))
        used = {id(one) for found in parts.values() for one in found.values()}
        lost = [key for key, one in leaves(tree) if key[0] != "#" and id(one) not in used and one.size]
        for part, found in parts.items():
            node = file["/".join(filter(None, (group, part))) or "/"]
            above = accumulate(filter(None, node.name.split("/")), "{}/{}".format)
            around = [file, node] if turned else [file, *map(file.get, above)]
            arrays: dict[str, Any] = {key: _attribute(value) for one in around for key, value in one.attrs.items()}
            objects = _objects(found) if turned else []
            for key in objects:
                del found[key.partition(" ")[0]]
            for key, one in _pandas(found).items() if not turned else found.items():
                arrays |= _arrays(file, key, one, turned, len(found) == 1)
            arrays |= {f"{key}/{name}": texts for key, one in found.items() for name, texts in _titles(one).items()}
            usable = {key: one for key, one in arrays.items() if one is not None and one.dtype.kind in "fiubUS"}
            stated = {key: texts for key, one in found.items() if (texts := stated_units(getattr(one, "attrs", {})))}
            for table in without_objects(path, f"{name}#{part}" if part else name, usable, objects, part):
                arm = {"arm": part} if sides and part else {}
                units = {**table.units, **units_of(table.columns, stated)}
                yield replace(table, units=units, facts={**arm, **table.facts}, others=(*table.others, *lost))


def _members(group: Any, seen: set[int], above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """The path and content of all that a group holds, each once, but a time by each of its names.

    Soft and external links are not followed.
    """
    for name in group:
        if type(group.get(name, getlink=True)).__name__ != "HardLink":
            continue
        item, place = group[name], (*above, name)
        if hash(item.id) in seen and (hasattr(item, "keys") or not unit_of_time(name)):
            continue
        seen.add(hash(item.id))
        yield place, item
        if hasattr(item, "keys"):
            yield from _members(item, seen, place)


def _titles(item: Any) -> dict[str, NDArray[Any]]:
    """The attributes of a table that name its columns."""
    if len(item.shape or ()) not in (2, 3) or item.dtype.kind not in "fiu":
        return {}
    lists = {key: _attribute(value) for key, value in getattr(item, "attrs", {}).items()}
    lists = {key: one for key, one in lists.items() if one.ndim == 1 and one.dtype.kind == "U"}
    return {key: one for key, one in lists.items() if len(one) in item.shape and wrenches(one.tolist())}


def _attribute(value: Any) -> NDArray[Any]:
    """An attribute as an array, of text where it is a list of texts, and not of references such as to dimensions."""
    array = np.asarray(value)
    texts = array.dtype.kind in "OS" and array.size > 0 and all(isinstance(one, str | bytes) for one in array.flat)
    return np.array([str(decoded(one)) for one in array.flat]).reshape(array.shape) if texts else array


def _pandas(found: dict[str, Any]) -> dict[str, Any]:
    """Data sets with the columns of a table that pandas wrote (``DataFrame.to_hdf``) by their names."""
    blocks = [key.removesuffix("_items") for key in found if key.endswith("_items") and "block" in key]
    taken = {f"{block}_{ending}" for block in blocks for ending in ("items", "values")}
    columns: dict[str, Any] = {}
    for block in blocks:
        values = found.get(f"{block}_values")
        titles = [decoded(text) for text in np.asarray(found[f"{block}_items"][()]).astype("S").tolist()]
        if values is not None and values.ndim == 2 and values.shape[1] == len(titles):
            content = values[()]
            columns |= {title: content[:, number] for number, title in enumerate(titles)}
    folders = {block.rpartition("/")[0] for block in blocks}
    taken |= {f"{folder}/{axis}".lstrip("/") for folder in folders for axis in ("axis0", "axis1")}
    return {key: one for key, one in found.items() if key not in taken} | columns


def _arrays(file: Any, key: str, item: Any, turned: bool, alone: bool) -> dict[str, NDArray[Any] | None]:
    """The arrays of a data set: its fields, what it refers to (as MATLAB keeps structures and cells), or itself."""
    if isinstance(item, np.ndarray):
        return {key: item}
    if item.dtype.names:
        content = item[()]
        return {field if alone else f"{key}.{field}": content[field] for field in item.dtype.names}
    if not turned or item.dtype.kind != "O" or not item.size:
        return {} if turned and key.startswith(("#refs#", "#subsystem#")) else {key: _array(item, turned)}
    head, _, field = key.rpartition("/")
    targets = [file[reference] for reference in item[()].ravel() if reference]
    values = [_array(target, turned) for target in targets if hasattr(target, "dtype")]
    cell = head == "" or _kind(item) == "cell"
    if cell and (texts := texts_of(values)) is not None:
        return {key: texts}
    struct = head and _kind(item.parent) == "struct"
    names = (f"{head}.{k}.{field}" if struct else f"{key}.{k}" for k in range(len(values)))
    return dict(zip(names, values, strict=True))


def _kind(item: Any) -> str:
    """Class of a MATLAB variable."""
    return str(decoded(item.attrs.get("MATLAB_class", b"")))


def _objects(found: Mapping[str, Any]) -> list[str]:
    """The variables that are objects of MATLAB's classes, and the class of each."""
    those = {key: one for key, one in found.items() if "MATLAB_object_decode" in getattr(one, "attrs", {})}
    return [f"{key} ({_kind(one)})" for key, one in those.items()]


def without_objects(
    path: Path, name: str, arrays: Mapping[str, NDArray[Any]], objects: Sequence[str], part: str = ""
) -> Iterator[Table]:
    """Tables of the arrays of a MATLAB file beside objects, which are named as left out.

    Raises:
        InputError: nothing but objects can be signals, or as :func:`tables_of`.
    """
    if objects and all(array.size < 2 or array.dtype.kind not in "fiu" for array in arrays.values()):
        raise InputError(
            f"{path} holds objects of MATLAB, which are not read: {', '.join(objects[:3])}; save numbers in a "
            "structure, such as S.t = seconds(T.Time) and S.wrench = T.Variables for a timetable T."
        )
    for table in tables_of(path, name, arrays, part):
        yield replace(table, others=(*table.others, *objects))


def texts_of(cells: Iterable[Any]) -> NDArray[np.str_] | None:
    """The texts of a cell array, of which some may be empty arrays; None = others are no texts, or all are empty.

    >>> texts_of(["free", np.empty(0)]), texts_of(["free", np.zeros(2)])
    (array(['free', ''], dtype='<U4'), None)
    """
    arrays = [np.asarray(cell) for cell in cells]
    texts = [array.dtype.kind == "U" and array.ndim == 0 for array in arrays]
    if not any(texts) or not all(text or array.size == 0 for text, array in zip(texts, arrays, strict=True)):
        return None
    return np.array([str(array) if array.size else "" for array in arrays])


def unpadded(rows: NDArray[Any]) -> NDArray[Any]:
    """Texts without the blanks that make the rows of a MATLAB matrix of characters equally long."""
    return np.char.rstrip(rows, " ")


def _array(item: Any, turned: bool) -> NDArray[Any] | None:
    """A data set of numbers or text; None for anything else."""
    if turned and item.attrs.get("MATLAB_empty", 0):  # it holds the dimensions
        return np.array("") if _kind(item) == "char" else np.empty(0)
    if turned and _kind(item) == "char":
        rows = ["".join(map(chr, row)) for row in np.atleast_2d(np.asarray(item[()]).T).tolist()]
        return np.array(rows[0]) if len(rows) == 1 else unpadded(np.array(rows))
    if item.dtype.kind in "fiub":
        content = scaled(np.asarray(item[()]), item.attrs)
        return content.T if turned else content
    if item.dtype.kind in "OS" and item.size and isinstance(np.asarray(item[()]).flat[0], bytes | str):
        return np.asarray(item.asstr()[()]).astype(np.str_)
    return None
