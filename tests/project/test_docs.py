"""The documentation does what it says: its code runs, its commands parse, the tutorial works as it stands."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from markdown.extensions.toc import slugify

import rcbht_jax as rj
from rcbht_jax.cli.main import command_name, main, parse
from rcbht_jax.errors import InputError
from tests.support.pages import NOTEBOOKS, PAGES, ROOT, notebook_cells, python_blocks, run
from tests.support.snaps import marked
from tests.support.store_cases import simple


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.S | re.M)


def commands(page: Path) -> list[str]:
    """Calls of rcbht, continued lines joined, without comments, pipes and redirections."""
    lines = [line for block in blocks(page, "sh") for line in re.sub(r"\\\n\s*", "", block).splitlines()]
    matches = [re.search(r"\brcbht [^|#<>]*", line) for line in lines]
    return [match[0].strip() for match in matches if match]


CODE = [page for page in PAGES if python_blocks(page)]
CALLS = [(page, line) for page in PAGES for line in commands(page)]


def test_something_is_tested() -> None:
    assert len(CODE) >= 5
    assert sum(bool(output) for page in CODE for _, output in python_blocks(page)) >= 5
    assert NOTEBOOKS
    assert len(CALLS) >= 30


@pytest.fixture
def trials_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The store ``trials.zarr`` that pages read, in the current folder."""
    monkeypatch.chdir(tmp_path)
    onset = np.tile([0.0, 0.5, 1.0, 1.5], (12, 1))
    rj.write_recordings(tmp_path / "trials.zarr", marked(simple(12, 400), onset, onset), {})


@pytest.mark.usefixtures("trials_store")
@pytest.mark.parametrize("page", CODE, ids=lambda page: page.stem)
def test_python_runs_and_prints_what_the_page_shows(page: Path) -> None:
    """Blocks of a page share their names, as in a session."""
    namespace = {"__name__": "docs"}
    for code, output in python_blocks(page):
        printed = run(code, namespace)
        assert not output or printed == output, f"{page.name}:\n{code}prints\n{printed}"


def test_three_recipes_of_the_readme_are_short() -> None:
    """Lines of code without imports and output: labels of an array, a classifier, a store."""
    recipes = (ROOT / "README.md").read_text().split("## Three recipes")[1]
    blocks = [code for code, _ in python_blocks(ROOT / "README.md") if code in recipes]
    lines = [
        [line for line in code.splitlines() if line and not line.startswith(("from ", "print("))] for code in blocks
    ]
    labels, _, classifier, store = map(len, lines)  # the second block makes the data
    assert labels <= 2
    assert classifier <= 5
    assert store <= 5


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(notebook: Path) -> None:
    namespace = {"__name__": "notebook"}
    assert [run(cell, namespace) for cell in notebook_cells(notebook)]


@pytest.mark.parametrize(("page", "line"), CALLS, ids=lambda value: getattr(value, "stem", value))
def test_commands_have_these_options(page: Path, line: str) -> None:
    words = shlex.split(line)[1:]
    name = command_name(words)
    assert name, f"{page.name}: {line}"
    try:
        parse(name, [word for word in words[name.count(" ") + 1 :] if word != "--json"])
    except InputError as error:
        pytest.fail(f"{page.name}: {line}: {error}")


def test_the_tutorial_works_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for line in commands(ROOT / "docs" / "tutorial.md"):
        assert main(shlex.split(line)[1:]) == 0, f"{line}\n{capsys.readouterr().err}"
    output = capsys.readouterr().out
    assert "duration alone" in output
    beliefs = [json.loads(line) for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert any(event["event"] == "Belief" and event["head"] == "states" for event in beliefs)
    assert (tmp_path / "report.html").read_text().startswith("<!doctype html>")
    assert (tmp_path / "trials-csv" / "trials.csv").exists()
    assert (tmp_path / "trial.png").read_bytes().startswith(b"\x89PNG")


def test_the_page_about_snaps_shows_what_its_commands_print(
    hiro_store: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = "".join(blocks(ROOT / "docs" / "measurements" / "snaps.md", "sh")).splitlines()
    for line in lines:
        call, _, shown = line.partition(" # ")
        assert main([str(hiro_store) if word == "hiro.zarr" else word for word in shlex.split(call)[1:]]) == 0
        output = capsys.readouterr().out
        pattern = ".*".join(re.escape(part.strip()) for part in shown.split("..."))
        assert re.search(pattern, output), f"{call} does not print {shown}"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documentation, built."""
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("docs") / "site"
    build = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_fetches_nothing(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 15
    for page in pages:
        for kind, address in re.findall(r'<(script|link|img)\b[^>]*?(?:src|href)="([^"]*)"', page.read_text()):
            assert not address.startswith(("http", "//")), f"{page.name}: {kind} {address}"
    for result in (ROOT / "experiments" / "results").glob("*.json"):
        assert (site / "results" / result.name).read_bytes() == result.read_bytes()


def test_the_site_can_be_searched_without_a_server(site: Path) -> None:
    assert (site / "search" / "search_index.js").read_text().startswith("var __index = ")
    assert 'src="assets/iframe-worker.js"' in (site / "index.html").read_text()


def test_roles_of_docstrings_are_links_or_code(site: Path) -> None:
    links = 0
    for page in site.rglob("*.html"):
        text = page.read_text()
        left = re.search(r":(?:class|func|mod|meth|attr|data|exc|obj):", text)
        assert left is None, f"{page.name}: {text[left.start() : left.end() + 40]}"
        assert "<autoref" not in text
        links += len(re.findall(r'<a class="autorefs[^>]*><code>', text))
    assert links > 10


def test_the_reference_shows_how_samples_are_pushed_to_each_reader(site: Path) -> None:
    page = (site / "reference" / "introspection.html").read_text()
    for name in ("snaps.SnapDetector", "nominal_watch.NominalWatch", "segmenter_stream.SegmenterStream"):
        assert f'id="rcbht_jax.introspection.{name}.push"' in page


def test_links_of_the_pages_lead_to_files_and_headings() -> None:
    """And images are there. What is in the reference, only the site knows."""
    texts = {page: re.sub(r"^```.*?^```", "", page.read_text(), flags=re.S | re.M) for page in PAGES}
    headings = {page: [slugify(one, "-") for one in re.findall(r"^#+ (.*)", texts[page], re.M)] for page in PAGES}
    for page, text in texts.items():
        for link in re.findall(r"\]\((?!https?:)([^)\s]*)\)", text):
            name, _, heading = link.partition("#")
            target = (page.parent / name).resolve() if name else page
            assert target.exists(), f"{page.name}: {link}"
            assert not heading or "." in heading or heading in headings[target], f"{page.name}: {link}"
