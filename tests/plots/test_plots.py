"""Figures: they show what the tracks say, are saved whole or not at all, and mistakes are sentences."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from rcbht_jax.cli import main
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.encoder import EncoderConfig
from rcbht_jax.encoding.thresholds import preset
from rcbht_jax.errors import InputError
from rcbht_jax.io.label_store import write_tracks
from rcbht_jax.io.store import write_recordings
from rcbht_jax.labels import AXES, COLORS, LAYER_SIZES, LAYERS, name
from rcbht_jax.plots import label_map, save, trial_figure
from rcbht_jax.plots.label_map import POINTS_PER_STATE
from rcbht_jax.robots.snap_assembly import snap_recordings
from rcbht_jax.types import LabelTrack, LabelTracks, Recordings

DT = 0.005
SAMPLES = (900, 600, 400)  # of the recordings below
WORDS = 12  # most words of a sentence below


@pytest.fixture
def recordings() -> Recordings:
    """Two successes of session B and a failure of session A, the latter without insertion and mating."""
    rng = np.random.default_rng(0)
    wrench = np.zeros((3, 900, 6), np.float32)
    for row, samples in enumerate(SAMPLES):
        wrench[row, :samples] = rng.normal(size=(samples, 6)).cumsum(0)
    onset = np.array([[0, 1, 2, 3], [0, 1, 1.005, 2], [0, 1, np.nan, np.nan]])
    harmonised = onset.copy()
    harmonised[1, 2] = 1.8
    return snap_recordings(
        wrench=wrench,
        length=np.array(SAMPLES, np.int32),
        dt=DT,
        onset=onset,
        onset_harmonised=harmonised,
        trial=np.array(["t2", "t1", "t1"]),
        arm=np.array(["R", "R", "R"]),
        source=np.array(["GOOD", "GOOD", "BAD"]),
        session=np.array(["B", "B", "A"]),
        outcome=np.array(["success", "success", "failure"]),
        failure_type=np.array(["", "", "+x-r"]),
        deviation=np.full((3, 3), np.nan),
        note=np.array(["", "", ""]),
    )


@pytest.fixture
def tracks() -> LabelTracks:
    """Random labels on spans of random length; the padding slots are where the dense form may have them."""
    rng = np.random.default_rng(1)
    return LabelTracks(*(_random_track(rng, size) for size in LAYER_SIZES))


def _random_track(rng: np.random.Generator, size: int) -> LabelTrack:
    shape = (len(SAMPLES), len(AXES), WORDS)
    label = rng.integers(1, size + 1, shape).astype(np.int8)
    edges = np.sort(rng.integers(0, 380, (*shape[:2], WORDS + 1)), axis=-1) + np.arange(WORDS + 1)
    label[rng.random(shape) < 0.3] = 0
    values = {key: np.where(label > 0, rng.normal(size=shape), 0.0) for key in ("vmax", "vmin", "avg", "grad")}
    t0, t1 = (np.where(label > 0, edges[..., part], 0).astype(np.int32) for part in (slice(0, -1), slice(1, None)))
    return LabelTrack(label, t0, t1, np.where(label > 0, t1, 0).astype(np.int32), **values)


def _axes(figure: Figure, kind: str, axis: int) -> Axes:
    (found,) = (ax for ax in figure.axes if ax.get_gid() == f"{kind}-{AXES[axis]}")
    return found


def _child(ax: Axes, gid: str) -> Any:
    (found,) = (artist for artist in [*ax.collections, *ax.lines] if artist.get_gid() == gid)
    return found


def _check_bands(figure: Figure, tracks: LabelTracks, index: int) -> None:
    """One patch per label, at its span, in its colour."""
    for axis in range(len(AXES)):
        for row, layer in enumerate(LAYERS):
            band, track = _child(_axes(figure, "labels", axis), layer), getattr(tracks, layer)
            assert isinstance(band, PolyCollection)
            used = np.asarray(track.label[index, axis]) > 0
            codes, t0, t1 = (np.asarray(x[index, axis])[used] for x in (track.label, track.t0, track.t1))
            codes, t0, t1 = (x[np.argsort(t0 - t1, kind="stable")] for x in (codes, t0, t1))  # short ones on top
            spans = [(path.vertices[:, 0].min(), path.vertices[:, 0].max()) for path in band.get_paths()]
            np.testing.assert_allclose(spans, np.stack([t0, t1], -1) * DT)
            assert all(row < y < row + 1 for path in band.get_paths() for y in path.vertices[:, 1])
            np.testing.assert_allclose(band.get_facecolor()[:, :3], [to_rgb(COLORS[layer][c - 1]) for c in codes])


@pytest.mark.parametrize("index", range(3))
def test_bands_are_the_labels(recordings: Recordings, tracks: LabelTracks, index: int) -> None:
    _check_bands(trial_figure(recordings, tracks, index), tracks, index)


def test_lines_are_the_fits(recordings: Recordings, tracks: LabelTracks) -> None:
    figure = trial_figure(recordings, tracks, 1)
    for axis in range(len(AXES)):
        lines = _child(_axes(figure, "signal", axis), "fits")
        assert isinstance(lines, LineCollection)
        track = tracks.primitive
        used = np.flatnonzero(track.label[1, axis])
        assert len(lines.get_segments()) == len(used)
        for slot, ((x0, y0), (x1, y1)) in zip(used, lines.get_segments(), strict=True):
            t0, t1 = track.t0[1, axis, slot], track.t1[1, axis, slot]
            assert (x0, x1) == pytest.approx((t0 * DT, (t1 - 1) * DT))
            assert (y0 + y1) / 2 == pytest.approx(track.avg[1, axis, slot])
            assert y1 - y0 == pytest.approx(track.grad[1, axis, slot] * (x1 - x0))


def test_boundaries_are_at_the_onsets(recordings: Recordings, tracks: LabelTracks) -> None:
    for index, expected, dashed in ((0, [0, 1, 2, 3], []), (1, [0, 1, 1.005, 2], [1.8]), (2, [0, 1], [])):
        figure = trial_figure(recordings, tracks, index)
        for ax in figure.axes:
            lines = [line for line in ax.lines if line.get_gid() == "state"]
            at = {style: [x.get_xdata()[0] for x in lines if (x.get_linestyle() == "--") == style] for style in (0, 1)}
            assert at == {0: pytest.approx(expected), 1: pytest.approx(dashed)}
        texts = [text.get_text() for text in _axes(figure, "signal", 0).texts]
        assert len(texts) == len(expected) + len(dashed)
        assert ("insertion, harmonised" in texts) == bool(dashed)


def test_names_stand_in_wide_spans_only(recordings: Recordings, tracks: LabelTracks) -> None:
    figure = trial_figure(recordings, tracks, 0)
    figure.canvas.draw()
    shown = 0
    for axis in range(len(AXES)):
        ax = _axes(figure, "labels", axis)
        for text in ax.texts:
            (low, row), (high, _) = ax.transData.inverted().transform(text.get_window_extent())
            layer = LAYERS[int(row)]
            track = getattr(tracks, layer)
            inside = (track.t0[0, axis] * DT <= low) & (high <= track.t1[0, axis] * DT)
            assert [name(layer, int(code)) for code in track.label[0, axis][inside]] == [text.get_text()]
            shown += 1
    assert shown > 20


def test_title_and_legends(recordings: Recordings, tracks: LabelTracks) -> None:
    figure = trial_figure(recordings, tracks, 2, window=20)
    assert figure.get_suptitle().split("\n") == [
        "t1   ·   BAD",
        "session A, failure (failure type: +x-r), window 20 samples (100 ms)",
    ]
    legends = {legend.get_gid(): [text.get_text().split()[0] for text in legend.texts] for legend in figure.legends}
    for layer in LAYERS:
        codes = np.unique(getattr(tracks, layer).label[2])
        assert legends[f"legend-{layer}"] == [name(layer, int(code)) for code in codes if code]


def test_seconds_choose_a_part(recordings: Recordings, tracks: LabelTracks) -> None:
    figure = trial_figure(recordings, tracks, 0, seconds=(0.5, 1.5))
    assert _axes(figure, "signal", 0).get_xlim() == (0.5, 1.5)
    track = tracks.llb
    seen = (track.label[0, 3] > 0) & (track.t1[0, 3] * DT > 0.5) & (track.t0[0, 3] * DT < 1.5)
    assert len(_child(_axes(figure, "labels", 3), "llb").get_paths()) == seen.sum() < (track.label[0, 3] > 0).sum()
    assert [text.get_text() for text in _axes(figure, "signal", 0).texts] == ["rotation"]


def test_map_by_word_shows_every_sentence(recordings: Recordings, tracks: LabelTracks) -> None:
    for layer in LAYERS:
        figure = label_map(recordings, tracks, layer)
        assert [ax.get_title(loc="left") for ax in figure.axes] == list(AXES)
        for axis, ax in enumerate(figure.axes):
            shown = np.asarray(ax.images[0].get_array())
            for row, index in enumerate((2, 1, 0)):  # session A first, then the names in order
                sentence = getattr(tracks, layer).label[index, axis]
                sentence = sentence[sentence > 0]
                assert shown[row, : len(sentence)].tolist() == sentence.tolist()
                assert not shown[row, len(sentence) :].any()


def test_map_colors_are_those_of_the_labels(recordings: Recordings, tracks: LabelTracks) -> None:
    image = label_map(recordings, tracks, "mc").axes[0].images[0]
    colors = image.cmap(image.norm(np.arange(LAYER_SIZES[1] + 1)))[:, :3]
    np.testing.assert_allclose(colors, [to_rgb(color) for color in ("white", *COLORS["mc"])])


def test_map_separates_sessions(recordings: Recordings, tracks: LabelTracks) -> None:
    ax = label_map(recordings, tracks, "llb").axes[0]
    assert [line.get_ydata()[0] for line in ax.lines] == [0.5]
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["A, failure (1)", "B, success (2)"]


def test_map_sorts_rows_by_session_and_outcome(recordings: Recordings, tracks: LabelTracks) -> None:
    same = np.array(["A"] * 3)
    mixed = replace(recordings, session=same, source=same, outcome=np.array(["success", "failure", "success"]))
    ax = label_map(mixed, tracks, "llb").axes[0]
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["A, failure (1)", "A, success (2)"]


def test_map_by_state_holds_time_within_states(recordings: Recordings, tracks: LabelTracks) -> None:
    figure = label_map(recordings, tracks, "llb", by="state", select=np.array([True, False, True]))
    for axis, ax in enumerate(figure.axes):
        shown = np.asarray(ax.images[0].get_array()).reshape(2, 4, POINTS_PER_STATE)
        assert not shown[0, 2:].any()  # the failure has neither insertion nor mating
        for row, index, edges in ((0, 2, (0, 200, 400)), (1, 0, (0, 200, 400, 600, 900))):
            for state, (start, stop) in enumerate(itertools.pairwise(edges)):
                moments = start + (stop - start) * (np.arange(POINTS_PER_STATE) + 0.5) / POINTS_PER_STATE
                expected = [_label_at(tracks.llb, index, axis, moment) for moment in moments]
                assert shown[row, state].tolist() == expected


def _label_at(track: LabelTrack, index: int, axis: int, moment: float) -> int:
    for code, t0, t1 in zip(*(x[index, axis] for x in (track.label, track.t0, track.t1)), strict=True):
        if code and t0 <= moment < t1:
            return int(code)
    return 0


def test_map_cuts_long_sentences_and_says_so(recordings: Recordings, tracks: LabelTracks) -> None:
    figure = label_map(recordings, tracks, "llb", words=8)
    assert all(ax.images[0].get_array().shape == (3, 8) for ax in figure.axes)
    longer = int(((tracks.llb.label > 0).sum(-1) > 8).sum())
    assert 0 < longer < 18
    assert f"{longer} of 18 rows are truncated" in figure.get_suptitle()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"layer": "words"}, "'words'"),
        ({"layer": "llb", "words": 0}, "number of words to show is 0"),
        ({"layer": "llb", "select": np.zeros(3, bool)}, "No recording is selected"),
        ({"layer": "llb", "select": np.ones(4, bool)}, "There are 3 recordings; expected numbers of some of them"),
        ({"layer": "llb", "select": np.array([3])}, "There are 3 recordings; expected numbers of some of them"),
    ],
)
def test_wrong_maps_are_refused(
    recordings: Recordings, tracks: LabelTracks, options: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        label_map(recordings, tracks, **options)


def test_wrong_trials_are_refused(recordings: Recordings, tracks: LabelTracks) -> None:
    with pytest.raises(InputError, match="Recording 3 does not exist; the data set has 3"):
        trial_figure(recordings, tracks, 3)
    with pytest.raises(InputError, match=r"between 5 s and 6 s; the recording lasts 4\.5 s"):
        trial_figure(recordings, tracks, 0, seconds=(5.0, 6.0))
    short = LabelTracks(
        *(LabelTrack(*(x[:2] for x in vars(track).values())) for track in (tracks.primitive, tracks.mc, tracks.llb))
    )
    with pytest.raises(InputError, match=r"shape \(2, 6, 12\); expected \[3 recordings"):
        trial_figure(recordings, short, 0)


def test_a_recording_without_labels_is_drawn(recordings: Recordings, tracks: LabelTracks, tmp_path: Path) -> None:
    empty = LabelTracks(
        *(LabelTrack(*(np.zeros_like(x) for x in vars(t).values())) for t in (tracks.primitive, tracks.mc, tracks.llb))
    )
    save(trial_figure(recordings, empty, 0), tmp_path / "trial.png")
    save(label_map(recordings, empty, "llb"), tmp_path / "map.png")
    save(label_map(recordings, empty, "llb", by="state"), tmp_path / "states.png")
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize(("suffix", "magic"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".PDF", b"%PDF")])
def test_save_writes_the_format_of_the_suffix(tmp_path: Path, suffix: str, magic: bytes) -> None:
    path = tmp_path / f"figure{suffix}"
    path.write_text("older")
    with path.open() as reader:
        save(Figure(figsize=(1, 1)), path)
        assert reader.read() == "older"  # replaced as a whole, not written over
    assert path.read_bytes().startswith(magic)
    assert list(tmp_path.iterdir()) == [path]


def test_save_keeps_the_older_file_when_it_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, figure = tmp_path / "figure.png", Figure(figsize=(1, 1))
    path.write_text("older")

    def fail(draft: Path, **_: object) -> None:
        draft.write_text("half")
        raise PermissionError(13, "Permission denied", str(draft))

    monkeypatch.setattr(figure, "savefig", fail)
    with pytest.raises(InputError, match=r"figure\.png cannot be written: Permission denied\.$"):
        save(figure, path)
    assert path.read_text() == "older"
    assert list(tmp_path.iterdir()) == [path]


def test_save_refuses_wrong_places(tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    for path, sentence in (
        (tmp_path / "figure.jpg", r"does not end in \.png, \.svg, \.pdf"),
        (tmp_path / "no" / "figure.png", "is not a folder; create it first"),
        (tmp_path / "folder.png", "is a folder; choose another name"),
    ):
        with pytest.raises(InputError, match=sentence):
            save(Figure(figsize=(1, 1)), path)


def test_settings_are_untouched_and_threads_work(recordings: Recordings, tracks: LabelTracks, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    paths = [tmp_path / f"{layer}.png" for layer in LAYERS]

    def draw(layer: str, path: Path) -> None:
        save(label_map(recordings, tracks, layer), path)

    with ThreadPoolExecutor() as pool:
        list(pool.map(draw, LAYERS, paths))
    assert all(path.is_file() for path in paths)
    assert dict(mpl.rcParams) == before


@pytest.fixture
def store(recordings: Recordings, tracks: LabelTracks, tmp_path: Path) -> Path:
    path = tmp_path / "s.zarr"
    write_recordings(path, recordings, {})
    write_tracks(path, "online-W5", tracks, {"window": 5})
    return path


def test_commands_write_figures(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = store.with_name("t.png")
    assert main.main(["plot", "trial", str(store), "t2", "-o", str(out)]) == 0
    made = "online-W5-fit made now (--tracks shows those of the store: online-W5)"
    assert capsys.readouterr().out == f"{out}: GOOD t2, labels {made}\n"
    assert out.is_file()
    out = store.with_name("m.svg")
    assert main.main(["plot", "map", str(store), "-o", str(out), "--source", "GOOD", "--layer", "mc", "--json"]) == 0
    assert f'"figure": "{out}", "tracks": "online-W5-fit", "layer": "mc", "recordings": 2' in capsys.readouterr().out
    assert out.is_file()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["trial", "t1"],
            "Several recordings are called t1; choose one with --arm or --source: GOOD arm R, BAD arm R.",
        ),
        (["trial", "t22"], "There is no trial t22; similar names: t2, t1."),
        (["trial", "t2", "--arm", "L"], "There is no trial t2 of arm L; similar names: t2, t1."),
        (["map", "--source", "UGLY"], "No data set begins with 'UGLY'; the store has: GOOD, BAD."),
        (["map", "--tracks", "W20"], 'has no label tracks W20; run "rcbht encode" first, or choose one it has'),
    ],
)
def test_commands_refuse_in_sentences(
    store: Path, words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    kind, *rest = words
    assert main.main(["plot", kind, str(store), *rest, "-o", str(store.with_name("x.png"))]) == 2
    assert sentence in capsys.readouterr().err
    assert not store.with_name("x.png").exists()


def test_commands_ask_for_labels(
    recordings: Recordings, tracks: LabelTracks, store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = tmp_path / "bare.zarr"
    write_recordings(bare, recordings, {})
    assert main.main(["plot", "map", str(bare), "-o", str(tmp_path / "x.png")]) == 2
    assert f'bare.zarr has no label tracks; run "rcbht encode {bare}" first.' in capsys.readouterr().err
    write_tracks(store, "offline-master", tracks, {})
    assert main.main(["plot", "map", str(store), "--rule", "paper", "-o", str(tmp_path / "x.png")]) == 2
    assert "choose one with --tracks: offline-master, online-W5." in capsys.readouterr().err


def test_a_recorded_trial(hiro_recordings: Recordings, tmp_path: Path) -> None:
    keep = np.flatnonzero(hiro_recordings.session == "B")[:2]
    few = hiro_recordings.take(keep)
    labels = encode_batch(EncoderConfig(), preset(), few.wrench, few.length)
    figure = trial_figure(few, labels, 0, window=5)
    _check_bands(figure, labels, 0)
    for axis in range(len(AXES)):
        _check_fits_against_the_wrench(_axes(figure, "signal", axis))
    assert "insertion, harmonised" in [text.get_text() for text in _axes(figure, "signal", 0).texts]
    save(figure, tmp_path / "trial.png")
    save(label_map(few, labels, "llb", by="state"), tmp_path / "map.png")


def _check_fits_against_the_wrench(ax: Axes) -> None:
    """Lines of a single window are least-squares fits of the samples under them."""
    times, values = _child(ax, "wrench").get_data()
    single = 0
    for (x0, y0), (x1, y1) in _child(ax, "fits").get_segments():
        first, last = round(x0 / DT), round(x1 / DT)
        if last - first == 4:
            slope, offset = np.polyfit(times[first : last + 1], values[first : last + 1].astype(float), 1)
            assert (y0, y1) == pytest.approx((slope * x0 + offset, slope * x1 + offset), abs=1e-3)
            single += 1
    assert single > 10
