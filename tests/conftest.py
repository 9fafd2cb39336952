"""Shared fixtures and the strictness under which every test runs."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

from jaxtyping import install_import_hook

import tests.support.typechecking  # the hook below finds it by attribute
from tests.support.compiler import UNOPTIMISED
from tests.support.garbage import collect_rarely, set_aside
from tests.support.long_tests import HELP, OPTION, chosen
from tests.support.order import LONGEST, place
from tests.support.small_blocks import shrink

# Shapes and types are checked at run time under pytest only; must come before any import of the packages.
install_import_hook(["rcbht_jax", "sim_mjx"], "tests.support.typechecking.check")
sys.meta_path.insert(0, tests.support.typechecking.Unhooked())

# Both workers and all commands that tests start share what one of them has compiled: half of the time is compilation.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# Most of a test's compilation is optimisation that its few short runs never pay back. Results must not depend on how a
# compiler fuses; test_standard_compiler.py runs the tests of equal bits again, compiled as users compile.
if os.environ.get("RCBHT_STANDARD_COMPILER") is None:
    for name, value in UNOPTIMISED.items():
        os.environ.setdefault(name, value)

import hypothesis  # noqa: E402
import jax  # noqa: E402
import pytest  # noqa: E402

from rcbht_jax.io.hiro.importer import import_hiro  # noqa: E402
from rcbht_jax.io.store import read_recordings  # noqa: E402
from rcbht_jax.types import Recordings  # noqa: E402

if os.environ.get("RCBHT_STANDARD_COMPILER") is None:
    shrink()

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

collect_rarely()

# No test cuts the power, and to wait for the disk is most of the time of writing a small store.
os.fsync = lambda handle: None

hypothesis.settings.register_profile("dev", deadline=None, max_examples=60)
hypothesis.settings.register_profile("ci", deadline=None, max_examples=30, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "dev")

ROOT = Path(__file__).resolve().parents[1]


def pytest_configure() -> None:
    """Ctrl-C interrupts, also where a shell has started the tests in the background, for which it is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Long tests can be left out."""
    parser.addoption(OPTION, default="all", help=HELP)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Long files first; what pytest has ordered stays in its order otherwise."""
    runs = chosen(config.getoption(OPTION))
    config.hook.pytest_deselected(items=[item for item in items if not runs(item.nodeid)])
    items[:] = [item for item in items if runs(item.nodeid)]
    missing = [name for name in LONGEST if not (ROOT / name).is_file()]
    assert not missing, f"tests/support/order.py names files that are not there: {missing}"
    items.sort(key=lambda item: place(item.nodeid))


@pytest.fixture(scope="module", autouse=True)
def garbage_of_one_file() -> None:
    """Collections look at nothing that earlier files have made."""
    set_aside()


def _external(variable: str, default: str) -> Path:
    """A folder outside the project, or the reason why its tests are skipped."""
    folder = Path(os.environ.get(variable) or ROOT / default)
    if not folder.is_dir():
        reason = f"the recorded data is not here; set {variable} to its folder (default {default})"
        if os.environ.get("RCBHT_REQUIRE_DATA"):
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


@pytest.fixture(scope="session")
def hiro_dir() -> Path:
    """The authors' data sets."""
    return _external("RCBHT_DATA", "../shared/data/hiro")


@pytest.fixture(scope="session")
def golden_dir() -> Path:
    """Reference results of the authors' programs and of the design."""
    return _external("RCBHT_GOLDEN", "../shared/golden")


@pytest.fixture(scope="session")
def external_dir() -> Path:
    """Recordings of other robots and laboratories; parts of each set are absent."""
    return _external("RCBHT_EXTERNAL", "../shared/data/external")


@pytest.fixture(scope="session")
def hiro_store(hiro_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All data sets imported once per session; read only."""
    path = tmp_path_factory.mktemp("store") / "hiro.zarr"
    import_hiro(hiro_dir, path)
    return path


@pytest.fixture(scope="session")
def hiro_recordings(hiro_store: Path) -> Recordings:
    """The content of ``hiro_store``; do not change its arrays."""
    return read_recordings(hiro_store)
