"""What pyproject.toml cannot say: the long description is README.md without what leads into the repository."""

import re
from pathlib import Path

from setuptools import setup


def outside_the_repository(readme: str) -> str:
    """The README as an index page shows it: relative pictures left out, relative links reduced to their words."""
    readme = re.sub(r"!\[[^\]]*\]\((?!https?:)[^)]*\)\n*", "", readme)
    readme = re.sub(r"<(img|source|video)\b(?![^>]*=\"https?:)[^>]*>\n*", "", readme)
    return re.sub(r"\[([^\]]*)\]\((?!https?:)[^)]*\)", r"\1", readme)


if __name__ == "__main__":
    text = Path(__file__).with_name("README.md").read_text(encoding="utf-8")
    setup(long_description=outside_the_repository(text), long_description_content_type="text/markdown")
