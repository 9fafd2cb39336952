"""Python files that users name: each is run once, with the modules beside it that it imports."""

from __future__ import annotations

import hashlib
import sys
import sysconfig
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

from rcbht_jax._util.digest import files_hash
from rcbht_jax.errors import InputError

_PREFIX = "rcbht_own_"  # of the names of users' modules
_OURS = ("rcbht_jax", "sim_mjx", "__main__")
_LIBRARIES, _STANDARD = ("site-packages", "dist-packages"), Path(sysconfig.get_path("stdlib"))


class OwnFile(NamedTuple):
    """A file that has been run."""

    module: ModuleType
    files: tuple[Path, ...]  # absolute: it, and sorted the neighbours that it imports
    digest: str  # of their content when they were run, which later edits do not change


def run_file(path: str) -> OwnFile:
    """Run a Python file, which may import modules and packages of its folder at the top, unless it has been run.

    These neighbours belong to this file alone: another file that imports the same names, or a neighbour of the same
    name in another folder, gets its own.

    Args:
        path: of the file, which has the suffix ".py".

    Raises:
        InputError: there is no such file, or running it raises anything.

    >>> run_file("nothere.py")
    Traceback (most recent call last):
    rcbht_jax.errors.InputError: There is no Python file nothere.py.
    """
    file = Path(path)
    if file.suffix != ".py" or not file.is_file():
        raise InputError(f"There is no Python file {path}.")
    try:
        return _run(file.absolute())
    except InputError:  # its message already says what is wrong
        raise
    except Exception as error:
        raise InputError(f"{path} cannot be imported: {error}.") from error


@cache
def _run(file: Path) -> OwnFile:
    """Run a file, whose path is absolute."""
    # two files of one stem must not take each other's place in sys.modules
    name = f"{_PREFIX}{file.stem}_{hashlib.sha256(str(file).encode('utf-8', 'surrogateescape')).hexdigest()[:12]}"
    spec = spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    hidden = _neighbours(file.parent)  # imported by others; what this file imports must not depend on them
    for known in hidden:
        del sys.modules[known]
    sys.modules[name] = module  # dataclasses look their module up
    sys.path.append(str(file.parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(file.parent))
        found = _neighbours(file.parent)
        for known in found:
            del sys.modules[known]
        sys.modules.update(hidden)
    _rename(name, found)
    paths = {Path(one.__file__) for one in found.values() if getattr(one, "__file__", None)}
    files = (file, *sorted(one for one in paths - {file} if one.is_relative_to(file.parent)))
    return OwnFile(module, files, files_hash(file.parent, files))


def _neighbours(folder: Path) -> dict[str, Any]:
    """Imported modules that lie in a folder, and all modules of packages that do."""
    if folder.name in _LIBRARIES or folder == _STANDARD:  # whose modules all code shares
        return {}
    known = dict(sys.modules)  # other threads import, too
    tops = {name for name, module in known.items() if "." not in name and _lies_in(folder, module)}
    tops = {name for name in tops if name not in _OURS and not name.startswith(_PREFIX)}
    return {name: module for name, module in known.items() if name.partition(".")[0] in tops}


def _lies_in(folder: Path, module: Any) -> bool:
    """Whether it is a module or a package of this folder, not of one below it."""
    try:  # any other access would load a module that is imported lazily
        values: Mapping[str, Any] = object.__getattribute__(module, "__dict__")
    except AttributeError:
        return False
    package = values.get("__path__")
    file = values.get("__file__")
    places = [file] if package is None else [*package]
    return any(isinstance(place, str) and Path(place).parent == folder for place in places)


def _rename(owner: str, found: Mapping[str, Any]) -> None:
    """Keep an own file's neighbours under names of their own, since their dataclasses look their module up."""
    for old, module in found.items():
        name = f"{owner}.{old}"
        sys.modules[name] = module
        module.__name__ = name
        if module.__spec__ is not None:
            module.__spec__.name = name
            module.__package__ = module.__spec__.parent
        for value in vars(module).values():
            if isinstance(value, type | FunctionType) and value.__module__ == old:
                with suppress(TypeError):  # a compiled class
                    value.__module__ = name
