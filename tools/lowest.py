"""Print the lower end of every dependency range in pyproject.toml as constraints for pip.

Run: python tools/lowest.py > lowest.txt
"""

import re
import tomllib
from pathlib import Path


def lowest(project: dict[str, object]) -> list[str]:
    """``name==version`` for each dependency of the package and of its extras that has a lower end."""
    extras: dict[str, list[str]] = project["optional-dependencies"]  # type: ignore[assignment]
    every = [*project["dependencies"], *(line for name in extras for line in extras[name])]  # type: ignore[misc]
    bounds = [re.match(r"([\w-]+)(?:\[\w+\])?[>=]=([\w.]+)", line) for line in every]
    return sorted({f"{found[1]}=={found[2]}" for found in bounds if found})


if __name__ == "__main__":
    pyproject = Path(__file__).resolve().parents[1] / "pyproject.toml"
    print("\n".join(lowest(tomllib.loads(pyproject.read_text())["project"])))
