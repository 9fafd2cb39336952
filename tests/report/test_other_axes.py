"""The report of recordings that are no wrench of six axes, or in other units: their samples, words and names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rcbht_jax.cli.main import main
from rcbht_jax.io.label_store import read_tracks
from rcbht_jax.io.store import write_recordings
from rcbht_jax.labels import name
from rcbht_jax.types import Recordings
from tests.support.browser import browser


@pytest.mark.parametrize("units", [("mN",), ("Nm", "Nm", "", "N", "N", "N", "N")])
def test_report_of_any_number_of_axes(units: tuple[str, ...], tmp_path: Path) -> None:
    axes = [f"a_long_name_{number}" for number in range(len(units))]
    force = np.random.default_rng(0).normal(size=(1, 401, len(axes))) * 0.02
    force[:, 200:] += np.interp(np.arange(201), [0, 4, 100, 200], [0, 4, 4, 9])[:, None]
    recordings = Recordings.from_arrays(force, 200.0, axes=axes, units=list(units))
    store, page = tmp_path / "s.zarr", tmp_path / "s.html"
    write_recordings(store, recordings, {})
    assert main(["encode", str(store), "--rule", "fit"]) == 0
    assert main(["report", str(store), "-o", str(page)]) == 0
    tracks, _ = read_tracks(store, "online-W5-fit")
    with browser(1280, 900) as driver:
        driver.get(page.as_uri())
        driver.implicitly_wait(5)
        assert driver.find_element("css selector", "#plot[aria-label^='trial-0']")
        decoded = np.array(driver.execute_script("return view.trial.wrench.map(values => Array.from(values))"))
        np.testing.assert_allclose(decoded.T, force[0], atol=1e-3)
        for axis, unit in enumerate(units):
            driver.execute_script("say(2, arguments[0], 1)", axis)
            said = driver.find_element("id", "word").text
            second = tracks.llb.label[0, axis][tracks.llb.label[0, axis] > 0][1]
            assert said.startswith(f"{axes[axis]} llb: {name('llb', int(second))} (")
            assert said.count(f"{unit}/s") == 1
            assert (" N" in said, " Nm" in said) == (unit in ("N", "Nm"), unit == "Nm")
        measure = (
            "const pen = plot.getContext('2d'); pen.font = '12px system-ui'; return pen.measureText(axes[0]).width"
        )
        assert driver.execute_script(measure) + 4 <= driver.execute_script("return LEFT")
        assert [entry["message"] for entry in driver.get_log("browser")] == []


def test_arms_are_called_as_elsewhere_and_lines_are_not_called_samples(tmp_path: Path) -> None:
    """An arm without a name left empty brackets, "left" was no arm; extremes of lines looked like those of samples."""
    rng, store, page = np.random.default_rng(0), tmp_path / "s.zarr", tmp_path / "s.html"
    force = list(rng.normal(size=(3, 401, 1)))
    force[0] = np.tile(force[0], (4, 1))  # so that they are encoded one at a time, as above
    write_recordings(store, Recordings.from_arrays(force, 200.0, axes=["Fz"], arm=["left", "ur5", ""]), {})
    assert main(["report", str(store), "-o", str(page)]) == 0
    with browser(1280, 900) as driver:
        driver.get(page.as_uri())
        driver.implicitly_wait(5)
        assert driver.find_element("css selector", "#plot[aria-label^='trial-0']")
        names = driver.execute_script("return Array.from(byId('trial').options, option => option.text)")
        assert names == ["trial-0 (left)", "trial-1 (ur5)", "trial-2"]
        about = "const done = arguments[1]; show(arguments[0]).then(() => done(byId('about').textContent.split(', ')))"
        facts = [driver.execute_async_script(about, number)[2:] for number in range(3)]
        assert facts == [
            ["outcome unknown", "left arm", "8.02 s"],
            ["outcome unknown", "arm ur5", "2.00 s"],
            ["outcome unknown", "2.00 s"],
        ]
        driver.execute_script("byId('list').closest('details').open = true; say(2, 0, 0); draw()")
        assert driver.find_element("id", "caption").text.endswith("; smallest and largest of the fitted lines")
        smallest, largest = driver.execute_script("const w = view.trial.words[2][0][0]; return [w.vmin, w.vmax]")
        assert force[2].min() < smallest < largest < force[2].max()
        assert "lines from" in driver.find_element("id", "word").text


@pytest.mark.parametrize(("unit", "title"), [("A", "Signal introspection"), ("N", "Wrench introspection")])
def test_what_is_no_force_is_not_called_a_wrench(unit: str, title: str, tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=(1, 400, 1)).cumsum(1)
    store, page = tmp_path / "s.zarr", tmp_path / "s.html"
    write_recordings(store, Recordings.from_arrays(values, 200.0, axes=["motor"], units=[unit]), {})
    assert main(["report", str(store), "-o", str(page)]) == 0
    assert f"<h1>{title}</h1>" in page.read_text()
    assert main(["export", str(store), "-o", str(tmp_path / "out"), "--format", "csv"]) == 0
    assert (tmp_path / "out" / "README.md").read_text().startswith(f"# {title.split()[0]} recordings")


def test_a_signal_in_large_units_fills_its_panel(tmp_path: Path) -> None:
    """In kN, where a push is 0.0001; the numbers beside the panel are whole."""
    force = np.random.default_rng(0).normal(size=(1, 401, 1)).cumsum(1) * 1e-5
    store, page = tmp_path / "s.zarr", tmp_path / "s.html"
    write_recordings(store, Recordings.from_arrays(force, 200.0, axes=["Fz"], units=["kN"]), {})
    assert main(["report", str(store), "-o", str(page)]) == 0
    with browser(1280, 900) as driver:
        driver.get(page.as_uri())
        driver.implicitly_wait(5)
        assert driver.find_element("css selector", "#plot[aria-label^='trial-0']")
        ys, texts = driver.execute_script(
            "const ys = [], texts = [], own = { lineTo: (x, y) => ys.push(y), fillText: text => texts.push(text) };"
            "view.trial.words[0][0] = []; const pen = new Proxy(own, { get: (own, key) => own[key] ?? (() => 0) });"
            "drawSignal(pen, 800, 0, 0, 100); return [ys, texts];"
        )
    assert (min(ys), max(ys)) == pytest.approx((4.0, 96.0), abs=0.1)
    assert texts[:2] == ["Fz", "kN"]
    assert np.float64(texts[2:4]) == pytest.approx([force.max(), force.min()], rel=0.1)
    assert max(map(len, texts)) <= 8


@pytest.mark.parametrize(("force", "mean"), [([[7.0]], 7.0), ([[1e30]] * 400, 1e30)])
def test_one_sample_and_a_huge_constant_are_drawn(force: list[list[float]], mean: float, tmp_path: Path) -> None:
    store, page = tmp_path / "s.zarr", tmp_path / "s.html"
    write_recordings(store, Recordings.from_arrays(np.array([force]), 200.0, axes=["Fz"], units=["N"]), {})
    assert main(["report", str(store), "-o", str(page)]) == 0
    with browser(1280, 900) as driver:
        driver.get(page.as_uri())
        driver.implicitly_wait(5)
        assert driver.find_element("css selector", "#plot[aria-label^='trial-0']")
        ys, texts, dots = driver.execute_script(
            "const ys = [], texts = [], dots = [], own = { lineTo: (x, y) => ys.push(y), arc: (x, y) => dots.push(y),"
            "fillText: text => texts.push(text) }; view.trial.words[0][0] = [];"
            "const pen = new Proxy(own, { get: (own, key) => own[key] ?? (() => 0) });"
            "drawSignal(pen, 800, 0, 0, 100); return [ys, texts, dots];"
        )
    assert ys == pytest.approx([50.0] * len(force))  # in the middle of the panel
    assert dots == pytest.approx([50.0] if len(force) == 1 else [])
    assert np.float64(texts[2:4]) == pytest.approx([1.05 * mean, 0.95 * mean], rel=0.01)
