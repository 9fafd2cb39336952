"""The report: what it shows is what the store and the result files hold, in a browser, by mouse and by keyboard."""

from __future__ import annotations

import base64
import dataclasses
import functools
import json
import re
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import hypothesis.extra.numpy as hnp
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from rcbht_jax._util.digest import data_hash
from rcbht_jax.cli.main import main
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.events import Belief
from rcbht_jax.introspection.description import describe_recording
from rcbht_jax.introspection.introspector import Introspector
from rcbht_jax.introspection.model import IntrospectionModel, save
from rcbht_jax.introspection.session import Session
from rcbht_jax.io.export import Block, DataSet, load
from rcbht_jax.io.playback import play
from rcbht_jax.io.store import read_recordings, write_recordings
from rcbht_jax.labels import LAYERS, MEANING, name
from rcbht_jax.report import Options, page
from rcbht_jax.report.pack import LEVELS, infer_beliefs, pack, quantised, rounded
from rcbht_jax.report.page import chosen
from rcbht_jax.report.results import read_results
from rcbht_jax.robots.snap_assembly import RECORDED
from rcbht_jax.types import Recordings
from tests.support.browser import browser
from tests.support.introspection_models import CONFIG, head
from tests.support.snaps import marked
from tests.support.store_cases import encoded_store, folder_is_clean, simple

RESULTS = Path(__file__).resolve().parents[2] / "experiments" / "results"
NASTY = "</script><b>Ü'\"&"


def signals(samples: int = 600) -> Recordings:
    """Four recordings with slopes, steps and noise; one with a name that breaks careless pages."""
    rng = np.random.default_rng(1)
    slopes = np.repeat(rng.normal(size=(4, samples // 100, 6)), 100, 1) * 0.02
    wrench = (np.cumsum(slopes, 1) + rng.normal(size=(4, samples, 6)) * 0.02).astype(np.float32)
    onset = np.tile([0.0, 0.7, 1.4, 2.1], (4, 1))
    plain = dataclasses.replace(
        simple(4, samples), wrench=wrench,
        trial=np.array(["one", "two", NASTY, "four"]), outcome=np.array(["success", "success", "failure", "failure"]),
    )  # fmt: skip
    return marked(plain, onset, onset + np.array([0, 0.1, 0, 0]))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encoded_store(tmp_path_factory.mktemp("report") / "set.zarr", signals())


@pytest.fixture(scope="module")
def data(store: Path) -> DataSet:
    return load(store)


@pytest.fixture(scope="module")
def block(data: DataSet) -> Block:
    """All of the store, which fits into one block."""
    [block] = data.blocks()
    return block


@pytest.fixture(scope="module")
def report(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    save(folder / "m.model", model())
    words = ["report", str(store), "--rule", "paper", "-o", str(folder / "report.html")]
    words += ["--model", str(folder / "m.model")]
    assert main([*words, "--results", str(RESULTS)]) == 0
    return folder / "report.html"


@functools.cache
def model() -> IntrospectionModel:
    heads = (head("states", "subtask", ("calm", "push", "shake"), "linear"),)
    return IntrospectionModel(CONFIG, np.asarray(preset().limits), heads, "abc", extra={})


def unpack(about: dict[str, Any], blob: str) -> dict[str, Any]:
    """The blob as its layout is described, read independently of the page."""
    raw, at = zlib.decompress(base64.b64decode(blob)), 0

    def take(kind: str, count: int) -> np.ndarray:
        nonlocal at
        part = np.frombuffer(raw, kind, count, at)
        at += part.nbytes
        return part

    found: dict[str, Any] = {layer: {} for layer in LAYERS}
    for layer, counts in zip(LAYERS, about["words"], strict=True):
        if total := sum(counts):
            found[layer] = {key: take("<i4", total) for key in ("t0", "t1", "emit")}
            found[layer] |= {key: take("<f4", total) for key in ("vmax", "vmin", "avg", "grad")}
            for key in ("t0", "t1"):
                found[layer][key] = np.cumsum(found[layer][key])
    steps = [np.cumsum(take("<i4", belief["steps"])) for belief in about["beliefs"]]
    codes = np.cumsum(take("<u2", 6 * about["samples"]).reshape(6, -1), 1, dtype=np.uint16)
    found["wrench"] = np.array(about["low"])[:, None] + np.array(about["step"])[:, None] * codes
    for layer, counts in zip(LAYERS, about["words"], strict=True):
        if total := sum(counts):
            found[layer]["label"] = take("u1", total)
    found["beliefs"] = []
    for belief, step in zip(about["beliefs"], steps, strict=True):
        probability = take("u1", belief["steps"] * len(belief["classes"])).reshape(len(step), -1)
        found["beliefs"].append((step, probability / 255))
    assert at == len(raw)
    return found


def test_blob_holds_words_and_beliefs(block: Block, store: Path) -> None:
    introspector = Introspector(model())
    about, blob = pack(block.recordings, block.tracks, 1, infer_beliefs(introspector, block.recordings, 1))
    found = unpack(about, blob)
    assert (np.abs(found["wrench"].T - block.recordings.wrench[1]) <= np.array(about["step"]) * 0.51).all()
    for layer, counts in zip(LAYERS, about["words"], strict=True):
        track = getattr(block.tracks, layer)
        used = track.label[1] > 0
        assert counts == used.sum(1).tolist()
        for field in ("label", "t0", "t1", "emit"):
            np.testing.assert_array_equal(found[layer][field], getattr(track, field)[1][used])
        for field in ("vmax", "vmin", "avg", "grad"):
            np.testing.assert_allclose(found[layer][field], getattr(track, field)[1][used], rtol=3e-4)
    session = Session(Introspector(model()))
    events = [event for event in session.run(play(read_recordings(store), ("two",))) if isinstance(event, Belief)]
    for known, (step, probability) in zip(model().heads, found["beliefs"], strict=True):
        expected = [event for event in events if event.head == known.name]
        assert step.tolist() == [event.sample for event in expected]
        np.testing.assert_allclose(probability, [event.probabilities for event in expected], atol=0.6 / 255)


@given(hnp.arrays(np.float32, (6, 40), elements=st.floats(-1e5, 1e5, width=32)))
def test_quantised_within_half_a_step(signal: np.ndarray) -> None:
    codes, low, step = quantised(signal)
    assert codes.min() >= 0
    assert codes.max() <= LEVELS
    error = np.abs(low[:, None] + step[:, None] * codes - signal.astype(np.float64))
    assert (error <= step[:, None] * 0.5000001 + 1e-12 * np.abs(signal)).all()


def test_small_numbers_are_quantised_as_finely() -> None:
    codes, _, _ = quantised(np.float32([[0.0, 1e-11, 3e-11], [2.0, 2.0, 2.0]]))
    np.testing.assert_array_equal(codes, [[0, round(LEVELS / 3), LEVELS], [0, 0, 0]])


@given(hnp.arrays(np.float32, 20, elements=st.floats(-(2.0**100), 2.0**100, width=32, allow_subnormal=False)))
def test_rounded_keeps_four_digits(values: np.ndarray) -> None:
    np.testing.assert_allclose(rounded(values), values, rtol=2.0**-13)


class Parts(HTMLParser):
    """Addresses and scripts of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for key, value in attrs if key in ("src", "href", "action", "srcset", "data")]


def test_page_fetches_nothing_and_survives_any_name(report: Path) -> None:
    text = report.read_text()
    parts = Parts(text)
    assert all(address.startswith("#") for address in parts.addresses)
    assert "default-src 'none'" in text
    assert not re.search(r"https?://|@import|url\(", text)
    assert "b" not in parts.tags  # the trial's name is text, not an element
    facts = json.loads(re.search(r'id="facts">(.*?)</script>', text, re.S)[1])
    assert [trial["trial"] for trial in facts["trials"]] == ["one", "two", NASTY, "four"]


def test_a_page_names_the_fault_that_a_trial_was_given(data: DataSet) -> None:
    kinds = np.array(["none", "jamming", "pose", "wedging"])
    given = dataclasses.replace(data, simulation=lambda: iter([{"fault": kinds[:3]}, {"fault": kinds[3:]}]))
    for one, expected in ((given, "success (fault: jamming)"), (data, "success")):
        text = page(one, Options(trials=("two",)))
        [trial] = json.loads(re.search(r'id="facts">(.*?)</script>', text, re.S)[1])["trials"]
        assert trial["facts"] == expected


def test_links_of_a_page_lead_somewhere(data: DataSet, report: Path) -> None:
    for text, links in ((page(data), 2), (report.read_text(), 3)):
        nav = re.search(r"<nav.*?</nav>", text)
        assert nav is not None
        places = re.findall(r'href="#(\w+)"', nav[0])
        assert len(places) == links
        assert all(f'id="{place}"' in text for place in places)


def test_a_store_without_labels_gets_words_on_the_way(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, out = signals().take(np.array([0])), tmp_path / "r.html"
    write_recordings(tmp_path / "bare.zarr", one, {})
    assert main(["report", str(tmp_path / "bare.zarr"), "-o", str(out)]) == 0
    assert "1 of 1 recording, labels online-W5-fit, 0 results" in capsys.readouterr().out
    text = out.read_text()
    assert "<p>1 recording of set: 1 success; 3.0 s at 200 Hz; labels online-W5-fit, words by the fit rule" in text
    assert "rule. It is in the browser below" in text
    [trial] = json.loads(re.search(r'id="facts">(.*?)</script>', text, re.S)[1])["trials"]
    assert all(min(counts) > 0 for counts in trial["words"])


def test_choice_of_trials(data: DataSet) -> None:
    assert chosen(data.recordings, Options(trials=("two", "four"))).tolist() == [1, 3]
    assert chosen(data.recordings, Options(most=2)).tolist() == [0, 3]
    assert chosen(data.recordings, Options(most=99)).tolist() == [0, 1, 2, 3]
    for options in (Options(trials=("nobody",)), Options(most=0)):
        with pytest.raises(InputError):
            chosen(data.recordings, options)
    slow = dataclasses.replace(data, recordings=dataclasses.replace(data.recordings, dt=0.01))
    with pytest.raises(InputError, match=r"0\.005 s apart"):
        page(slow, Options(model=model()))


def test_beliefs_about_trials_seen_in_training_are_marked(
    data: DataSet, block: Block, report: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(page.__globals__, "infer_beliefs", lambda *_: [])  # whatever they are
    assert "Whether the model was trained on recordings in the browser is not known." in report.read_text()
    older = dataclasses.replace(model(), data_hash=data_hash(block.recordings))
    assert "recordings of this store; it is not known on which" in page(data, Options(model=older, trials=("one",)))
    seen = dataclasses.replace(model(), digests=data.digests[1:])
    shown = page(data, Options(model=seen, trials=("one", "two", "four")))
    assert "trained on 2 of the 3 recordings in the browser: its beliefs about those are optimistic." in shown
    held_out = page(data, Options(model=dataclasses.replace(seen, data_hash=older.data_hash), trials=("one",)))
    assert "trained on none of the recordings in the browser." in held_out
    assert "Beliefs:" not in page(data, Options(trials=("one",)))
    arms = dataclasses.replace(data.recordings, arm=np.array(["L", "R", "L", "R"]))
    other = dataclasses.replace(model(), extra=model().extra | {"arm": "L"})
    mixed = page(dataclasses.replace(data, recordings=arms), Options(model=other, trials=("one", "two", "four")))
    assert "It learned the left arm: do not rely on its beliefs about the 2 recordings of another arm." in mixed
    assert "another arm" not in page(data, Options(model=other, trials=("one",)))  # it names no arm


def test_command_refuses_and_replaces(store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "r.html"
    for words in (["-o", str(tmp_path / "r.txt")], ["-o", str(tmp_path / "no/r.html")], ["-o", str(tmp_path)]):
        assert main(["report", str(store), *words]) == 2
    assert main(["report", str(store), "-o", str(out), "--results", str(tmp_path / "none")]) == 2
    assert main(["report", str(store), "-o", str(out), "--trial", "nobody"]) == 2
    assert main(["report", str(store), "-o", str(out), "--window", "0"]) == 2
    folder_is_clean(tmp_path)
    out.write_text("old")
    capsys.readouterr()
    assert main(["report", str(store), "-o", str(out), "--trial", "one", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["shown"] == 1
    assert out.read_text().startswith("<!doctype html>")
    folder_is_clean(tmp_path, "r.html")


# ---- in a browser ----


def opened(driver: Any, path: Path) -> float:
    """Open a report; milliseconds from the start of loading until the first trial is drawn."""
    from selenium.webdriver.support.ui import WebDriverWait

    driver.get(path.as_uri())
    WebDriverWait(driver, 60).until(lambda d: d.execute_script("return document.body.dataset.ready") == "yes")
    return float(driver.execute_script("return performance.now()"))


@pytest.mark.parametrize(("width", "height"), [(1280, 900), (390, 844)])
def test_page_works_at_this_width(width: int, height: int, report: Path, data: DataSet, block: Block) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    with browser(width, height) as driver:
        opened(driver, report)
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        plot, said = driver.find_element(By.ID, "plot"), driver.find_element(By.ID, "word")
        decoded = np.array(driver.execute_script("return view.trial.wrench.map(values => Array.from(values))"))
        np.testing.assert_allclose(decoded.T, block.recordings.wrench[0], atol=1e-3)
        pixels = "c.getContext('2d').getImageData(0, 0, c.width, c.height).data"
        assert driver.execute_script(f"const c = arguments[0]; return new Set({pixels}).size", plot) > 20
        told = describe_recording(block.recordings, 0)
        rows = driver.execute_script(
            "return Array.from(document.querySelectorAll('#description li'), row => row.textContent)"
        )
        assert rows == [f"{seconds:.2f} s {text}" for seconds, text in told]
        driver.execute_script("look(0, 1)")
        driver.execute_script("document.querySelectorAll('#description button')[1].click()")
        assert driver.execute_script("return view.to - view.from") == pytest.approx(3.0)  # the whole: it has no 4 s
        # Keyboard: the first word of Fx's behaviours, then the next one, zoom, next trial.
        driver.execute_script("arguments[0].focus()", plot)
        plot.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
        track = block.tracks.llb
        word = np.flatnonzero(track.label[0, 0])[1]
        code, t0 = int(track.label[0, 0, word]), int(track.t0[0, 0, word])
        assert said.text.startswith(f"Fx llb: {name('llb', code)} ({MEANING['llb'][code - 1]}), {t0 * 0.005:.3f} to")
        assert "states believed:" in said.text
        plot.send_keys("+")
        assert driver.execute_script("return view.to - view.from") == pytest.approx(1.5)
        plot.send_keys("nn")
        driver.implicitly_wait(2)
        assert driver.find_element(By.CSS_SELECTOR, "#plot[aria-label^='</script><b>Ü']")
        assert NASTY in driver.find_element(By.ID, "about").text
        controls = [c for c in driver.find_elements(By.CSS_SELECTOR, "button, select, canvas") if c.is_displayed()]
        assert len(controls) == 11
        assert all(control.accessible_name for control in controls)
        assert [entry["message"] for entry in driver.get_log("browser")] == []


def test_mouse_words_and_print(report: Path, data: DataSet, block: Block) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.by import By
    from selenium.webdriver.support.ui import Select

    with browser(1280, 900) as driver:
        opened(driver, report)
        Select(driver.find_element(By.ID, "axis")).select_by_visible_text("My")
        plot = driver.find_element(By.ID, "plot")
        driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
        # The middle of the canvas is 1.5 s less half of the margins; the lowest band is that of the behaviours.
        height = plot.size["height"]
        ActionChains(driver).move_to_element_with_offset(plot, 0, height // 2 - 24 - 16 - 15).perform()
        sample = driver.execute_script("return tOf(plot.clientWidth / 2, plot.clientWidth) / dt")
        track = block.tracks.llb
        [code] = [
            int(c)
            for c, t0, t1 in zip(track.label[0, 4], track.t0[0, 4], track.t1[0, 4], strict=True)
            if c and t0 <= sample < t1
        ]
        assert driver.find_element(By.ID, "word").text.startswith(f"My llb: {name('llb', code)} ")
        ActionChains(driver).drag_and_drop_by_offset(plot, 200, 0).perform()
        shown = driver.execute_script("return [view.from, view.to]")
        assert 0.3 < shown[1] - shown[0] < 0.7
        ActionChains(driver).double_click(plot).perform()
        assert driver.execute_script("return [view.from, view.to]") == [0, 3]
        driver.find_element(By.XPATH, "//summary[contains(., 'as a table')]").click()
        Select(driver.find_element(By.ID, "layer")).select_by_visible_text("mc")
        rows = driver.find_elements(By.CSS_SELECTOR, "#list tr")
        assert len(rows) == np.count_nonzero(block.tracks.mc.label[0, 4])
        pdf = base64.b64decode(driver.execute_cdp_cmd("Page.printToPDF", {})["data"])
        assert pdf.startswith(b"%PDF")
        found = read_results(RESULTS)  # a page holds at least fifteen of their rows, or twenty of their sources
        most = 3 + len(found.rows) // 15 + len(found.sources) // 20
        assert 2 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= most


def test_a_hundred_long_trials_open_within_two_seconds(data: DataSet, tmp_path: Path) -> None:
    """33 s each, as long as the longest recorded session, of noise that hardly deflates."""
    long = marked(signals(6600), data.recordings.starts(RECORDED), data.recordings.starts(RECORDED))
    write_recordings(tmp_path / "long.zarr", long, {})
    [few] = load(tmp_path / "long.zarr", window=5).blocks()
    rows = np.arange(100) % 4
    many = few.recordings.take(rows)
    layers = {}
    for layer in LAYERS:
        track = getattr(few.tracks, layer)
        fields = {f.name: getattr(track, f.name)[rows] for f in dataclasses.fields(track)}
        layers[layer] = dataclasses.replace(track, **fields)
    text = page(DataSet.of(many, dataclasses.replace(few.tracks, **layers)))
    assert len(text) < 15e6
    path = tmp_path / "report.html"
    path.write_text(text)
    with browser(1280, 900) as driver:
        assert opened(driver, path) < 2000
