"""Hook of mkdocs: the committed results of the experiments are part of the site.

Pages link to them where they lie in the repository, so that the links work there as well.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).resolve().parents[1] / "experiments" / "results"
_LINK = re.compile(r"\]\(((?:\.\./)+)experiments/results/")


def on_files(files: Any, config: Any) -> Any:
    """Add the results to the site as ``results/*.json``."""
    from mkdocs.structure.files import File

    for path in sorted(RESULTS.glob("*.json")):
        files.append(File.generated(config, f"results/{path.name}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Point links to results at their place in the site: one ``../`` leads out of the folder docs."""
    return _LINK.sub(lambda match: f"]({match[1].removeprefix('../')}results/", markdown)
