import importlib

import pytest

from rcbht_jax._util.optional import MissingPackage, needs_extra, require
from rcbht_jax.errors import InputError


def test_a_missing_package_is_named_with_its_extra() -> None:
    sentence = r'^missing is not installed: pip install "rcbht-jax\[store\]"\.$'
    with pytest.raises(InputError, match=sentence):
        require("missing.part", "store")
    with pytest.raises(ImportError, match=sentence), needs_extra("all"):
        require("missing", "store")  # the innermost extra is named


def test_an_error_of_our_own_is_not_taken_for_a_missing_package() -> None:
    with pytest.raises(ModuleNotFoundError) as caught, needs_extra("store"):
        importlib.import_module("rcbht_jax.no_such_module")
    assert not isinstance(caught.value, MissingPackage)


def test_an_installed_package_is_imported() -> None:
    assert require("numpy.linalg", "store").__name__ == "numpy.linalg"
