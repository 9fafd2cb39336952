"""What users install: the light core, the extras, the metadata and the conda recipe. .ci/packages installs them."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import markdown
import numpy as np
import pytest
import yaml

import rcbht_jax

ROOT = Path(__file__).resolve().parents[2]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CORE = {"jax", "jaxtyping", "numpy"}
CONDA_NAMES = {"flatbuffers": "python-flatbuffers", "matplotlib": "matplotlib-base"}
WITHOUT_EXTRAS = """
import importlib, pkgutil, sys

class Without:
    def __init__(self, finder):
        self.finder = finder
        self.find_distributions = getattr(finder, "find_distributions", lambda context: iter(()))

    def find_spec(self, name, path=None, target=None):
        return None if name.split(".")[0] in sys.argv[1:] else self.finder.find_spec(name, path, target)

sys.meta_path[:] = [Without(finder) for finder in sys.meta_path]
"""
# Import names of what the extras install; JAX brings scipy.
OPTIONAL = {
    "aeon": {"aeon"}, "cli": {"tqdm", "tyro"}, "export": {"flatbuffers", "pandas", "pyarrow"},
    "frames": {"pandas", "xarray"}, "import": {"h5py", "pyarrow"}, "learn": {"optax", "sklearn"},
    "report": {"matplotlib"}, "sim": {"mujoco"}, "store": {"google_crc32c", "numcodecs", "zarr"}, "stream": {"rosbags"},
}  # fmt: skip


def without_extras(program: str, *but: str) -> str:
    """Standard output of a program that cannot import what the extras install, apart from those named."""
    kept = set().union(*(OPTIONAL[extra] for extra in but))
    absent = sorted(set().union(*OPTIONAL.values()) - kept)
    command = [sys.executable, "-c", WITHOUT_EXTRAS + program, *absent]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def names(requirements: list[str]) -> dict[str, str]:
    """``{package: range}``, our own extras left out."""
    parts = [re.fullmatch(r"([\w-]+)(\[[^\]]*\])? ?(.*)", line) for line in requirements]
    return {part[1]: part[3] for part in parts if part and part[1] != "rcbht-jax"}


def extras(name: str) -> dict[str, str]:
    """All packages of an extra, those of the extras that it names included."""
    lines: list[str] = PROJECT["optional-dependencies"][name]
    own = [re.fullmatch(r"rcbht-jax\[([\w,]+)\]", line) for line in lines]
    nested = [extras(other) for match in own if match for other in match[1].split(",")]
    return names(lines) | {package: bound for packages in nested for package, bound in packages.items()}


def test_the_core_depends_on_three_packages() -> None:
    assert set(names(PROJECT["dependencies"])) == CORE


def test_the_core_encodes_without_any_extra() -> None:
    out = without_extras("""
import numpy as np
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset

wrench = np.zeros((1, 400, 6), np.float32)
wrench[0, 200:, 2] = np.linspace(0, 12, 200)
tracks = encode_batch(EncoderConfig(window=5, dt=0.005), preset("hiro"), wrench, np.array([400], np.int32))
print((np.asarray(tracks.primitive.label) > 0).sum())
""")
    assert int(out) > 0


def test_every_module_imports_or_names_the_extra_that_it_needs() -> None:
    """Commands are imported by ``rcbht``, which names the extra ``all``."""
    out = without_extras("""
from rcbht_jax._util.optional import MissingPackage

def walk(package):
    try:
        module = importlib.import_module(package)
    except MissingPackage as error:
        print(error)
        return
    for found in pkgutil.iter_modules(module.__path__, package + "."):
        if ".cli." in found.name:
            continue
        if found.ispkg:
            walk(found.name)
        else:
            try:
                importlib.import_module(found.name)
            except MissingPackage as error:
                print(error)

walk("rcbht_jax")
walk("sim_mjx")
""")
    asked = set(re.findall(r'^(\w+) is not installed: pip install "rcbht-jax\[(\w+)\]"\.$', out, re.M))
    assert {("zarr", "store"), ("matplotlib", "report"), ("mujoco", "sim"), ("rosbags", "stream")} <= asked
    assert {extra for _, extra in asked} <= set(PROJECT["optional-dependencies"])


def test_the_list_of_commands_needs_no_extra() -> None:
    out = without_extras("""
from rcbht_jax.cli.main import main

assert main(["--help"]) == 0
""")
    assert "\n  encode " in out
    assert "\n  simulate " in out


@pytest.mark.parametrize("command", ["encode", "simulate"])
def test_a_command_without_its_packages_says_what_to_install(command: str) -> None:
    out = without_extras(f"""
from contextlib import redirect_stderr
from rcbht_jax.cli.main import main

with redirect_stderr(sys.stdout):
    assert main([{command!r}, "x.zarr"]) == 2
""")
    assert out == 'rcbht: tyro is not installed: pip install "rcbht-jax[all]".\n'


@pytest.mark.parametrize(
    ("extra", "commands"),
    [
        ("store", ["encode a.zarr", "stream a.zarr --robot hiro --speed 0"]),
        ("report", ["report a.zarr -o a.html"]),
        ("export", [f"export a.zarr --format {kind} -o {kind}" for kind in ("csv", "parquet", "lerobot")]),
        ("stream", ["export a.zarr --format mcap -o mcap"]),
    ],
)
def test_a_command_needs_no_other_extra(extra: str, commands: list[str], tmp_path: Path) -> None:
    """As the install page promises."""
    wrench = np.random.default_rng(0).normal(size=(40, 6))
    rcbht_jax.write_recordings(tmp_path / "a.zarr", rcbht_jax.Recordings.from_arrays([wrench], outcome="success"), {})
    program = "import os\nfrom rcbht_jax.cli.main import main\n"
    program += f"os.chdir({str(tmp_path)!r})\nassert [main(words.split()) for words in {commands!r}].count(0)"
    without_extras(f"{program} == {len(commands)}", "cli", "store", extra)


def test_all_is_everything_but_hardware_peers_and_tools() -> None:
    assert set(extras("all")) == {
        *("mujoco", "mujoco-mjx", "optax", "scikit-learn", "scipy", "zarr", "rosbags", "matplotlib"),
        *("flatbuffers", "google-crc32c", "h5py", "numcodecs", "pandas", "pyarrow", "xarray", "tqdm", "tyro"),
    }


def test_a_pin_is_explained() -> None:
    for line in (ROOT / "pyproject.toml").read_text().splitlines():
        if re.search(r'"[\w-]+==', line):
            assert "  # " in line, line


def test_the_conda_recipe_agrees_with_the_wheel() -> None:
    recipe = yaml.safe_load((ROOT / "conda/recipe/recipe.yaml").read_text())
    assert recipe["context"]["version"] == rcbht_jax.__version__
    assert recipe["build"]["python"]["entry_points"] == [f"rcbht = {PROJECT['scripts']['rcbht']}"]
    run = names(recipe["requirements"]["run"])
    assert run.pop("python") == PROJECT["requires-python"]
    assert run == names(PROJECT["dependencies"])
    wheel = {CONDA_NAMES.get(package, package): bound for package, bound in extras("all").items()}
    assert names(recipe["requirements"]["run_constraints"]) == wheel


def test_one_version_everywhere() -> None:
    assert f"\nversion: {rcbht_jax.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    newest = re.search(r"^## \[([^\]]+)\]", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert newest is not None
    assert newest[1] == rcbht_jax.__version__


def test_the_long_description_needs_no_repository() -> None:
    spec = importlib.util.spec_from_file_location("setup_script", ROOT / "setup.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    readme = (ROOT / "README.md").read_text()

    def targets(text: str) -> list[str]:
        return re.findall(r'(?:href|src|srcset)="([^"]*)"', markdown.markdown(text, extensions=["tables"]))

    def relative(text: str) -> list[str]:
        return [target for target in targets(text) if not re.match(r"https?://|#", target)]

    assert relative(readme)  # there is something to do
    short = script.outside_the_repository(readme)
    assert relative(short) == []
    assert re.findall(r"^#+ .*|^```.*", short, re.M) == re.findall(r"^#+ .*|^```.*", readme, re.M)


def test_the_install_page_lists_the_extras() -> None:
    listed = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs/install.md").read_text(), re.M)
    experiments = {"peers", "search"}
    assert set(listed) == set(PROJECT["optional-dependencies"]) - experiments


def test_the_moves_of_the_changelog_lead_to_modules() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    tables = re.findall(r"^`(\w+)`:\n\n\| module of 0\.1 \| module \|\n\|[-|]+\n((?:\|.*\n)+)", text, re.M)
    assert [package for package, _ in tables] == ["rcbht_jax", "sim_mjx"]
    for package, rows in tables:
        for target in re.findall(r"\| `([\w.]+)` \|$", rows, re.M):
            module = ROOT / (target if target.startswith("rcbht_jax.") else f"{package}.{target}").replace(".", "/")
            assert module.is_dir() or module.with_suffix(".py").is_file(), target
