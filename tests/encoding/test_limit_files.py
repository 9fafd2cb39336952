"""Units in files of limits, and of presets: limits mean the same in whatever unit an axis is recorded."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.encoding.limit_files import read_limits, write_limits
from rcbht_jax.encoding.thresholds import GradientThresholds, preset, read_thresholds, write_thresholds
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError

GRADIENTS = np.array([[40.0, 30.0, 20.0, 10.0]] * 2)
AXES = ("Fz", "My")


@pytest.mark.parametrize(
    ("units", "factors"),
    [(("N", "Nm"), (1, 1e-3)), (("kN", "N·m"), (1e-3, 1e-3)), (("mN", "Ncm"), (1e3, 0.1)), (("", ""), (1, 1)), ((), 1)],
)
def test_limits_and_tolerances_are_converted_to_the_units_of_the_axes(
    units: tuple[str, ...], factors: tuple[float, ...], tmp_path: Path
) -> None:
    path, expected = tmp_path / "limits.json", GRADIENTS * np.reshape(factors, (-1, 1))
    write_thresholds(path, GRADIENTS, {}, AXES, ("N", "Nmm"))
    np.testing.assert_allclose(read_thresholds(path, AXES, units)[0].limits, expected, rtol=1e-15)
    write_limits(path, FitLimits(GRADIENTS, np.array([1.0, 2.0])), {}, AXES, ("N", "Nmm"))
    found, _ = read_limits(path, AXES, units)
    assert isinstance(found, FitLimits)
    np.testing.assert_allclose(found.gradients, expected, rtol=1e-15)
    np.testing.assert_allclose(found.tolerance, np.array([1.0, 2.0]) * factors, rtol=1e-15)


def test_a_unit_without_a_known_factor_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    write_limits(path, GradientThresholds(GRADIENTS), {}, AXES, ("N", "Nmm"))
    with pytest.raises(InputError, match="has thresholds for My in Nmm; it is in A here, and no factor is known"):
        read_limits(path, AXES, ("N", "A"))
    with pytest.raises(InputError, match="There are 1 units for 2 axes"):
        read_limits(path, AXES, ("N",))
    with pytest.raises(InputError, match="There are 3 units for 2 axes"):
        write_limits(path, GradientThresholds(GRADIENTS), {}, AXES, ("N", "Nmm", "Nmm"))


def test_a_file_states_the_units_that_are_known_and_no_others(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    write_limits(path, GradientThresholds(GRADIENTS), {}, AXES, ("", "Nmm"))
    written = json.loads(path.read_text())
    assert {axis: row.get("unit") for axis, row in written["limits"].items()} == {"Fz": None, "My": "Nmm"}
    assert "N/s" not in written["units"]
    assert read_limits(path, AXES, ("kN", "Nm"))[0].limits[:, 0].tolist() == [40.0, 0.04]
    written["limits"]["My"]["unit"] = 5
    path.write_text(json.dumps(written))
    with pytest.raises(InputError, match="unit of My is '5', int; expected str"):
        read_limits(path, AXES)
    written["limits"]["My"] = [[]]
    path.write_text(json.dumps(written))
    with pytest.raises(InputError, match=r"limits.json: what it has for My is '\[\[\]\]', list; expected dict"):
        read_limits(path, AXES)


def test_a_file_of_an_earlier_version_is_read_as_it_is(tmp_path: Path) -> None:
    path, row = tmp_path / "limits.json", {"impulse": 4.0, "big": 3.0, "medium": 2.0, "small": 1.0}
    top = {"format": "rcbht-thresholds", "format_version": 1, "provenance": {}, "limits": {"My": row}}
    path.write_text(json.dumps({**top, "units": "unit of the axis per second; of a wrench N/s (forces), Nm/s"}))
    assert read_limits(path, ["My"], ["Nmm"])[0].limits.tolist() == [[4.0, 3.0, 2.0, 1.0]]


def test_presets_are_converted_to_the_units_of_the_axes() -> None:
    found = preset("hiro", ["Fz", "My", "joint_1", "Mx"], ["kN", "Nmm", "Nm", ""]).limits[:, 0]
    np.testing.assert_allclose(found, [0.07, 7000.0, 7.0, 7.0])
    np.testing.assert_array_equal(preset(units=["N"] * 3 + ["Nm"] * 3).limits, preset().limits)
    with pytest.raises(InputError, match="of hiro are for forces and moments, and current is in A; choose thresholds"):
        preset("hiro", ["Fz", "current"], ["N", "A"])
