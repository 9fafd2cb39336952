"""Write the software bill of materials (CycloneDX 1.6, JSON) of what is installed, or the table of its licences.

Run: python -m tools.sbom sbom.json                        # what "pip install rcbht-jax[all]" brings
     python -m tools.sbom --extra dev sbom.json
     python -m tools.sbom --table docs/licences.md
"""

from __future__ import annotations

import argparse
import json
import tomllib
from collections import deque
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from rcbht_jax._util.atomic import atomic_write

PYPROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
OURS = "rcbht-jax"
_HEAD = """# Licences

The table lists the packages that `pip install 'rcbht-jax[all]'` installed when this page was written, with the licence
that each package states (`python -m tools.sbom --table docs/licences.md`); `make sbom` writes the same list as a
CycloneDX file. Direct dependencies are **bold**. rcbht-jax itself has the BSD-3-Clause licence.

| package | version | licence |
|---|---|---|
"""


def requirements(extras: set[str]) -> list[Requirement]:
    """What the project itself needs with some extras; extras of its own are followed."""
    project = tomllib.loads(PYPROJECT.read_text())["project"]
    lines, waiting, seen = list(project["dependencies"]), sorted(extras), set[str]()
    while waiting:
        if (extra := waiting.pop()) in seen:
            continue
        seen.add(extra)
        for line in project["optional-dependencies"][extra]:
            needed = Requirement(line)
            if needed.name == OURS:
                waiting += sorted(needed.extras)
            else:
                lines.append(line)
    return [Requirement(line) for line in lines]


def closure(needed: list[Requirement]) -> tuple[dict[str, Distribution], dict[str, list[str]]]:
    """All installed packages that these need, by name, and what each of them needs; others are not there."""
    found: dict[str, Distribution] = {}
    edges: dict[str, set[str]] = {}
    done: set[tuple[str, str]] = set()
    waiting = deque((one, "") for one in needed)
    while waiting:
        one, parent = waiting.popleft()
        name = canonicalize_name(one.name)
        try:
            package = distribution(one.name)
        except PackageNotFoundError:  # of another system
            continue
        edges.setdefault(parent, set()).add(name)
        found[name] = package
        for extra in sorted({"", *one.extras} - {extra for known, extra in done if known == name}):
            done.add((name, extra))
            for line in package.requires or []:
                more = Requirement(line)
                if more.marker is None or more.marker.evaluate({"extra": extra}):
                    waiting.append((more, name))
    return dict(sorted(found.items())), {name: sorted(edges.get(name, ())) for name in ["", *found]}


def licence_of(package: Distribution) -> str:
    """The licence that a package states: an SPDX expression, its classifiers, or the first line of its text."""
    about = package.metadata
    if expression := about.get("License-Expression"):
        return str(expression)
    classifiers = [
        line.split(" :: ")[-1] for line in about.get_all("Classifier") or [] if line.startswith("License ::")
    ]
    if named := [name for name in classifiers if name != "OSI Approved"]:
        return " or ".join(named)
    return (about.get("License") or "not stated").strip().splitlines()[0][:80]


def bill(extras: set[str]) -> dict[str, Any]:
    """The bill of materials as JSON values; equal installations give equal ones."""
    found, edges = closure(requirements(extras))
    root = {"type": "library", "bom-ref": OURS, "name": OURS, "licenses": [{"license": {"id": "BSD-3-Clause"}}]}
    refs = {name: f"pkg:pypi/{name}@{package.version}" for name, package in found.items()}
    components = [
        {
            "type": "library", "bom-ref": refs[name], "name": name, "version": package.version, "purl": refs[name],
            "licenses": [{"license": {"name": licence_of(package)}}],
        }
        for name, package in found.items()
    ]  # fmt: skip
    dependencies = [
        {"ref": refs.get(name, OURS), "dependsOn": [refs[one] for one in needed]} for name, needed in edges.items()
    ]
    return {
        "bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1, "metadata": {"component": root},
        "components": components, "dependencies": dependencies,
    }  # fmt: skip


def table(extras: set[str]) -> str:
    """The packages and their licences as a page."""
    needed = requirements(extras)
    direct = {canonicalize_name(one.name) for one in needed}
    rows = [
        f"| {f'**{name}**' if name in direct else name} | {package.version} | {licence_of(package).replace('|', '/')} |"
        for name, package in closure(needed)[0].items()
    ]
    return _HEAD + "\n".join(rows) + "\n"


def main() -> None:
    """Write the file that the options name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--extra", action="append", help="extras of rcbht-jax; default all")
    parser.add_argument("--table", action="store_true", help="write the licences as a page")
    options = parser.parse_args()
    extras = set(options.extra or ["all"])
    text = table(extras) if options.table else json.dumps(bill(extras), indent=1) + "\n"
    with atomic_write(options.out) as draft:
        draft.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
