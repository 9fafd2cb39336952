"""The bill of materials and the page of licences are about what the project needs."""

from __future__ import annotations

import re

from packaging.utils import canonicalize_name

from tests.support.pages import ROOT
from tools.sbom import bill, closure, requirements


def test_the_bill_lists_what_is_needed_and_who_needs_it() -> None:
    made = bill({"all"})
    names = {part["name"]: part for part in made["components"]}
    assert {"jax", "numpy", "zarr", "rosbags", "mujoco", "tyro", "jaxlib"} <= set(names)
    assert names["jaxlib"]["purl"] == f"pkg:pypi/jaxlib@{names['jaxlib']['version']}"
    assert names["numpy"]["licenses"][0]["license"]["name"].startswith("BSD")
    refs = {part["bom-ref"] for part in made["components"]} | {"rcbht-jax"}
    needs = {one["ref"]: one["dependsOn"] for one in made["dependencies"]}
    assert set(needs) == refs
    assert names["jaxlib"]["bom-ref"] in needs[names["jax"]["bom-ref"]]
    assert {ref for many in needs.values() for ref in many} <= refs
    assert "pytest" not in names
    assert "pytest" in {canonicalize_name(one.name) for one in requirements({"dev"})}


def test_the_page_has_the_licence_of_everything() -> None:
    rows = re.findall(r"^\| (\**)([\w-]+)\** \| \S+ \| (.+) \|$", (ROOT / "docs/licences.md").read_text(), re.M)
    stated = {name: licence for _, name, licence in rows}
    needed = requirements({"all"})
    assert set(closure(needed)[0]) <= set(stated), "run: python -m tools.sbom --table docs/licences.md"
    assert {name for star, name, _ in rows if star} == {canonicalize_name(one.name) for one in needed}
    assert "not stated" not in stated.values()
