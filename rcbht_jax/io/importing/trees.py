"""Arrays in groups within each other, as files of many kinds hold them: which groups are recordings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcbht_jax._util.columns import unit_of_time
from rcbht_jax.io.importing.families import numbered
from rcbht_jax.io.importing.names import GROUPS, has_forces, names_side, preference, wrenches
from rcbht_jax.io.importing.words import in_order

Tree = dict[str, Any]  # groups, "NAME/", and what has a shape, by its name
DEPTH = 16  # of groups in names
_OF_MATLAB = ("#refs#/", "#subsystem#/")  # groups of its cells and objects
FEW = 16  # elements that a list of gains or of names has at most


def put(tree: Tree, path: Sequence[str], array: Any) -> None:
    """Put an array, or None = a group alone, where a path leads.

    >>> tree = {}
    >>> put(tree, ["run", "Fz"], np.zeros(3))
    >>> [(path, array.shape) for path, array in leaves(tree)]
    [('run/Fz', (3,))]
    """
    *groups, last = path
    for group in groups:
        tree = tree.setdefault(f"{group}/", {})
    if array is None:
        tree.setdefault(f"{last}/", {})
    else:
        tree[last] = array


def leaves(tree: Tree) -> Iterator[tuple[str, Any]]:
    """The arrays of a tree by their paths in it."""
    for key, one in tree.items():
        if isinstance(one, dict):
            yield from ((key + path, array) for path, array in leaves(one))
        else:
            yield key, one


def of_groups(arrays: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, NDArray[Any]]]:
    """The arrays of each recording by its group, where "/" or "." in names stand for groups.

    Each has a wrench, and a time of its own or another length than others. Arms that are as long are one recording.

    >>> arrays = {f"{group}.{name}": np.zeros(9) for group in ("insert", "remove") for name in ("t", "Fx", "Fy", "Fz")}
    >>> {group: list(own) for group, own in of_groups(arrays).items()}
    {'insert': ['t', 'Fx', 'Fy', 'Fz'], 'remove': ['t', 'Fx', 'Fy', 'Fz']}
    """
    mark = "/" if any("/" in key for key in arrays) else "."
    tree: Tree = {}
    for key, array in arrays.items():
        put(tree, key.split(mark, DEPTH), array)
    _, parts = separated(tree, wrench=True) or ("", {})
    lengths = {max((len(array) for array in own.values() if array.ndim), default=0) for own in parts.values()}
    sides, given = all(map(names_side, parts)), set(map(id, tree.values()))
    timed = all(any(unit_of_time(re.split("[./]", path)[-1]) and id(one) not in given for path, one in own.items())
                for own in parts.values())  # fmt: skip
    if len(lengths) == 1 and (sides or not timed):
        return {}
    found = {part: {path.replace("/", mark): one for path, one in own.items()} for part, own in parts.items()}
    return {part: own | {"arm": np.asarray(part)} for part, own in found.items()} if sides else found


def separated(tree: Tree, axis: int = 0, wrench: bool = False) -> tuple[str, dict[str, dict[str, Any]]] | None:
    """The path of the group whose groups are a recording each, and the arrays of each by their paths in it.

    Single values beside them, also in groups without signals, are of all, as are arrays as long as one of their own,
    such as a time that all share. ``axis`` of arrays is the time; with ``wrench``, each recording has one. None = there
    are no such groups.
    """
    if not (recordings := recordings_in(tree, wrench)):
        return None
    path, parts = recordings
    taken, beside = {*path, *(f"{part}/" for part in parts)}, dict[str, Any]()
    for key in [*path, ""]:
        others = {name: one for name, one in tree.items() if name not in taken and name not in _OF_MATLAB}
        # a number is that of a segment, of which recording is unknown; a list in another group may be of one name
        beside |= {
            name: one
            for name, one in leaves(others)
            if name in others or (len(one.shape) != 1 and not any(map(str.isdecimal, name.split("/"))))
        }
        tree = tree[key] if key else tree
    found: dict[str, dict[str, Any]] = {}
    for part, group in parts.items():
        own = dict(leaves(group))
        lengths = {one.shape[axis] for one in own.values() if one.shape}
        shared = {key: one for key, one in beside.items() if key not in own and _is_shared(one, lengths)}
        found[part] = {**shared, **own}
    return "".join(path).rstrip("/"), found


def recordings_in(tree: Tree, wrench: bool = False) -> tuple[list[str], dict[str, Tree]] | None:
    """The keys that lead to the group whose groups are a recording each, and these by name; None = there are none."""
    path = _path(tree, wrench)
    return None if path is None else (path, _with_signals(_groups(_at(tree, path))))


def _is_shared(array: Any, lengths: set[int]) -> bool:
    return bool(array.size == 1 or array.size == max(array.shape or (0,)) in lengths)


def _groups(tree: Tree) -> dict[str, Tree]:
    """The groups of a tree by the numbers in their names, but for those in which MATLAB keeps cells and objects."""
    names = sorted((key for key, one in tree.items() if isinstance(one, dict) and key not in _OF_MATLAB), key=in_order)
    return {key[:-1]: tree[key] for key in names}


def _with_signals(groups: dict[str, Tree]) -> dict[str, Tree]:
    """The groups that hold more than single values, and than gains and the like if others do; a wrench is none."""
    longest = {name: max((max(one.shape or (1,)) for _, one in leaves(own)), default=0) for name, own in groups.items()}
    least = FEW if max(longest.values(), default=0) > FEW else 1
    names = {name: tuple(sorted(own)) for name, own in groups.items()}
    those = {names[name] for name, length in longest.items() if length > least}
    return {
        name: own
        for name, own in groups.items()
        if longest[name] > least or names[name] in those or (longest[name] > 1 and _one_wrench([own]))
    }


def _path(tree: Tree, wrench: bool) -> list[str] | None:
    """Keys of the outermost group whose groups (two or more) have the same names, or the same wrench, or are trial_0,
    ...; None = there is no such group.

    Groups of single values alone describe segments, and those beside a wrench, without one of their own, hold more
    signals of its recording, as do those of what was done to one wrench.
    """
    groups = _with_signals(_groups(tree))
    children = list(groups.values())
    if len(children) > 1 and not _are_of_one_wrench(groups) and _are_recordings(tree, groups, wrench):
        return []
    if len(children) == 1:
        key, below = f"{next(iter(groups))}/", _path(children[0], wrench)
        of_other = _one_wrench([tree]) and not any(has_forces(path) for path, _ in leaves(children[0]))
        return None if below is None or of_other else [key, *below]
    # Beside a group of recordings there may be one of splits.
    for name, child in groups.items():
        below = _path(child, wrench)
        if below is not None and are_numbered(_groups(_at(child, below))):
            return [f"{name}/", *below]
    return None


def _are_of_one_wrench(groups: Mapping[str, Tree]) -> bool:
    """Whether groups, equally long, have names that say what was done to a wrench, each another: raw and tared."""
    if len(set(map(preference, groups))) < len(groups):
        return False
    return len({max((max(one.shape or (0,)) for _, one in leaves(group)), default=0) for group in groups.values()}) == 1


def _are_recordings(tree: Tree, groups: Mapping[str, Tree], wrench: bool) -> bool:
    children = list(groups.values())
    if wrench or _one_wrench(children):
        return _one_wrench(children)
    arrays = [one for child in children for one in leaves(child)]
    alike = len({tuple(sorted(child)) for child in children}) == 1 and len(children[0]) > 0
    columns = {name: _columns((path, one.shape[1:]) for path, one in leaves(child)) for name, child in groups.items()}
    alike = alike and not are_quantities(columns)
    beside = _one_wrench([tree]) and not any(has_forces(path) for path, _ in arrays)
    return (alike and not beside) or are_numbered(groups)


def _at(tree: Tree, path: Iterable[str]) -> Tree:
    for key in path:
        tree = tree[key]
    return tree


def _one_wrench(trees: Sequence[Tree]) -> bool:
    """Whether all groups have a wrench of the same name."""
    arrays = [{key: one.shape[1:] for key, one in tree.items() if not isinstance(one, dict) and one.size > 1}
              for tree in trees]  # fmt: skip
    shared = [(key, width) for key, width in arrays[0].items() if all(one.get(key) == width for one in arrays)]
    return bool(wrenches(_columns(shared)))


def are_quantities(groups: Mapping[str, Iterable[str]]) -> bool:
    """Whether names of columns are those of a wrench only with the name of their group, and not of one in each.

    >>> are_quantities({"force": "xyz", "torque": "xyz"}), are_quantities({"force": "xyz", "position": "xyz"})
    (True, True)
    >>> are_quantities({"insert": ["Fx", "Fy", "Fz"], "remove": ["Fx", "Fy", "Fz"]}), are_quantities({"a": "xyz"})
    (False, False)
    """
    names = {group: list(columns) for group, columns in groups.items()}
    owners = {f"{group}/{column}": group for group, columns in names.items() for column in columns}
    found = [{owners[column] for column in wrench.values()} for wrench in wrenches(owners)]
    apart = all(len(one) == 1 for one in found) and len(found) == len(names)
    return bool(found) and not apart and not any(map(wrenches, names.values()))


def _columns(widths: Iterable[tuple[str, tuple[int, ...]]]) -> list[str]:
    """The names of the columns of arrays by their names and the shape of a row."""
    return [
        name
        for key, width in widths
        if len(width) < 2
        for name in ([f"{key}_{number}" for number in range(min(width[0], 6))] if width else [key])
    ]


def are_numbered(names: Iterable[str]) -> bool:
    """Whether names are trial_0, trial_1, ... or the like.

    >>> are_numbered(["trial_0", "trial_1"]), are_numbered(["ft1", "ft2"])
    (True, False)
    """
    return all(numbered(name.rstrip("0123456789")) in GROUPS for name in names)
