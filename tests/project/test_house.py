"""Rules of the house that no linter checks: the length of files, and where public names are explained."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import rcbht_jax

ROOT = Path(__file__).resolve().parents[2]
MOST_LINES = 400
FOLDERS = ("rcbht_jax", "sim_mjx", "experiments", "examples", "tests", "tools", ".ci")
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp)


def sources() -> list[Path]:
    return [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]


def test_no_file_is_longer_than_400_lines() -> None:
    lines = {path: path.read_text().count("\n") for path in sources()}
    assert len(lines) > 200
    assert {str(path): count for path, count in lines.items() if count > MOST_LINES} == {}


def test_every_public_name_is_in_the_reference() -> None:
    pages = "\n".join(page.read_text() for page in (ROOT / "docs/reference").glob("*.md"))
    entries = re.findall(r"^::: rcbht_jax\.(\w+)$", pages, re.M)
    assert set(rcbht_jax.__all__) <= set(entries)


def test_contributing_names_what_is_at_the_root_of_each_package() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text()
    for package in ("rcbht_jax", "sim_mjx"):
        table = re.search(rf"^\| in `{package}` \| content \|\n((?:\|.*\n)+)", text, re.M)
        assert table is not None
        named = set(re.findall(r"`([\w.]+/?)`", "\n".join(row.split("|")[1] for row in table[1].splitlines())))
        folders = {f"{path.parent.name}/" for path in (ROOT / package).glob("*/*.py")}
        modules = {path.name for path in (ROOT / package).glob("*.py")} - {"__init__.py"}
        assert named == folders | modules


def gather(node: ast.AST, hidden: frozenset[str], variables: set[str], names: dict[str, set[type]]) -> None:
    """Variables of the comprehensions of a function, and how it uses other names; without functions inside it."""
    if isinstance(node, COMPREHENSIONS):
        own = {name.id for part in node.generators for name in ast.walk(part.target) if isinstance(name, ast.Name)}
        variables.update(own)
        hidden |= own
    elif isinstance(node, ast.arg):
        names.setdefault(node.arg, set()).add(ast.Store)
    elif isinstance(node, ast.Name) and node.id not in hidden:
        names.setdefault(node.id, set()).add(type(node.ctx))
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, SCOPES):
            gather(child, hidden, variables, names)


def taken_twice(source: str) -> Iterator[str]:
    """Names that are a variable of a comprehension and a global in one function."""
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, SCOPES):
            variables, names = set[str](), dict[str, set[type]]()
            gather(function, frozenset(), variables, names)
            yield from (name for name in variables if names.get(name) == {ast.Load})


def test_no_comprehension_takes_the_name_of_a_global_that_its_function_reads() -> None:
    """Python 3.12.3, which runs comprehensions in the frame of their function, took one for the other."""
    assert list(taken_twice("def f(x):\n    return [len for len in x], {a: {len(a): b for b in a} for a in x}")) == [
        "len"
    ]
    assert not list(taken_twice("def f(x, y):\n    y = [y for y in x]\n    return y"))
    found = {path: list(taken_twice(path.read_text())) for path in sources()}
    assert {str(path): names for path, names in found.items() if names} == {}
