"""``rcbht_jax.encode`` and what it returns: any array library, any number of axes, the labels of the pure core."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import rcbht_jax as rj
from rcbht_jax._util.svg import Bar, bands
from rcbht_jax.encoding import encoder
from rcbht_jax.encoding.batch import encode_batch
from rcbht_jax.encoding.tolerance import FitLimits
from rcbht_jax.errors import InputError
from tests.support.trees import assert_trees_equal

RNG = np.random.default_rng(0)
WRENCH = RNG.normal(size=(3, 300, 6)).cumsum(1).astype(np.float32)
NAMES = ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
DATES = pd.date_range("2024-05-01", periods=300, freq="5ms")


def labels_only(tracks: rj.LabelTracks) -> tuple:
    return tracks.primitive, tracks.mc, tracks.llb


EXPECTED = encode_batch(rj.EncoderConfig(), rj.preset(), WRENCH, np.full(3, 300, np.int32))


def test_several_recordings_have_the_labels_of_the_core() -> None:
    assert_trees_equal(labels_only(rj.encode(WRENCH)), labels_only(EXPECTED))


@pytest.mark.parametrize(
    "wrench",
    [
        WRENCH[1],
        WRENCH[1].tolist() and jnp.asarray(WRENCH[1]),
        pd.DataFrame(WRENCH[1], columns=NAMES),
        pd.DataFrame(WRENCH[1], columns=NAMES).assign(time=np.arange(300) * 0.005),
        xr.DataArray(WRENCH[1].T, dims=("axis", "time"), coords={"axis": NAMES, "time": np.arange(300) * 0.005}),
        pd.DataFrame(WRENCH[1], columns=NAMES).assign(time=DATES.tz_localize("Europe/Berlin")),
        pd.DataFrame(WRENCH[1], columns=NAMES, index=DATES - DATES[0]),
        xr.DataArray(WRENCH[1].T, dims=("channel", "time"), coords={"channel": NAMES, "time": DATES}),
    ],
    ids=["numpy", "jax", "pandas", "with time", "xarray, transposed", "with dates", "with durations", "time last"],
)
def test_one_recording_needs_no_batch_axis(wrench: object) -> None:
    tracks = rj.encode(wrench)
    assert tracks.llb.label.shape[0] == 6
    assert tracks.words("Fy") == rj.encode(WRENCH).words("Fy", recording=1)
    assert tracks.to_frame().equals(rj.encode(WRENCH[1]).to_frame())


def test_unequal_recordings_and_lengths() -> None:
    short = rj.encode([WRENCH[0], WRENCH[1, :77]])
    assert short.words(0, "mc", recording=1) == rj.encode(WRENCH[1, :77]).words(0, "mc")
    padded = rj.encode(WRENCH[:2], lengths=[300, 77])
    assert_trees_equal(labels_only(padded), labels_only(short))


@pytest.mark.parametrize("axes", [1, 2, 7, 12])
def test_any_number_of_axes(axes: int) -> None:
    wrench = np.tile(WRENCH[0], 2)[:, :axes]
    tracks = rj.encode(wrench, thresholds=np.tile(rj.preset().limits[:1], (axes, 1)))
    alone = [rj.encode(wrench[:, [axis]], thresholds=rj.preset().limits[:1]).words(0) for axis in range(axes)]
    assert [tracks.words(axis) for axis in range(axes)] == alone


def test_names_decide_which_axes_are_moments() -> None:
    frame = pd.DataFrame({"Tz": WRENCH[0, :, 5], "Fz": WRENCH[0, :, 2]})
    tracks = rj.encode(frame)
    assert tracks.words("Tz") == rj.encode(WRENCH[0]).words("Mz")
    assert tracks.words("Fz") == rj.encode(WRENCH[0]).words("Fz")


def test_more_axes_than_samples_are_noticed_unless_names_say_which_is_which() -> None:
    for form in (WRENCH[0].T, WRENCH.swapaxes(1, 2), [WRENCH[0].T], pd.DataFrame(WRENCH[0].T)):
        with pytest.warns(UserWarning, match="300 axes and only 6 samples; recordings are"):
            rj.encode(form)
    with pytest.warns(UserWarning, match="300 axes"):
        rj.Recordings.from_arrays([WRENCH[0].T])
    with pytest.warns(UserWarning, match="300 axes"):
        rj.NominalMonitor().fit(WRENCH.swapaxes(1, 2))
    with pytest.warns(UserWarning, match="300 axes"):
        rj.WrenchFeatures().fit(WRENCH.swapaxes(1, 2))
    rj.encode([WRENCH[0], WRENCH[1, :3], WRENCH[2, :0]])  # the tests make an error of every warning
    rj.encode(pd.DataFrame(WRENCH[0, :3], columns=NAMES))
    rj.encode(xr.DataArray(WRENCH[0, :3].T, dims=("axis", "time")))
    rj.Encoder(rj.EncoderConfig(), rj.preset()).push(WRENCH[0, :3])


def test_numbers_are_no_names() -> None:
    """As pandas numbers columns by itself: six of them are Fx to Mz, as those of an array."""
    expected = rj.encode(WRENCH[0]).to_frame()
    numbered = xr.DataArray(WRENCH[0], dims=("time", "axis"), coords={"axis": range(6)})
    for form in (pd.DataFrame(WRENCH[0]), pd.DataFrame(WRENCH[0]).assign(time=np.arange(300) * 0.005), numbered):
        assert rj.encode(form).to_frame().equals(expected)
        assert rj.Recordings.from_arrays([form]).axes == tuple(NAMES)


def test_columns_that_hold_no_numbers_are_named() -> None:
    frame = pd.DataFrame(WRENCH[0], columns=NAMES).assign(note="x", day=DATES)
    with pytest.raises(InputError, match="columns note, day hold no numbers; drop them"):
        rj.encode(frame)
    with pytest.raises(InputError, match="An xarray Dataset holds several arrays; make one of them"):
        rj.Encoder(rj.EncoderConfig(), rj.preset()).push(xr.Dataset({"Fz": ("time", WRENCH[0, :, 2])}))


def test_thresholds_are_equal_by_their_numbers() -> None:
    assert rj.preset() == rj.preset()
    assert rj.preset() != rj.preset("pa10")
    assert rj.preset() != rj.preset().limits.tolist()
    assert rj.preset("pa10") in [rj.preset(), rj.preset("pa10")]
    fitted = FitLimits(rj.preset().limits, np.ones(6))
    assert fitted == FitLimits(rj.preset().limits, np.ones(6)) != FitLimits(rj.preset().limits, np.full(6, 2.0))


def test_labels_and_data_sets_are_equal_by_their_values() -> None:
    tracks, marks = rj.encode(WRENCH), [(1, "phase", "push", 0.0, np.nan)]  # an end that is unknown in both is the same
    assert tracks == rj.encode(WRENCH.copy())
    assert tracks.llb == jax.tree.map(jnp.asarray, tracks.llb)
    assert tracks != rj.encode(-WRENCH)
    assert tracks != rj.encode(WRENCH, rate=100, thresholds=rj.preset().limits / 2)
    assert tracks != tracks.to_frame().to_dict()
    one, other = (rj.Recordings.from_arrays(WRENCH, annotations=marks, grip=[1.0, np.nan, 3.0]) for _ in range(2))
    assert one == other
    assert one.annotations == other.annotations != rj.Recordings.from_arrays(WRENCH).annotations
    assert one != rj.Recordings.from_arrays(WRENCH, annotations=marks, grip=[1.0, 2.0, 3.0])
    assert one != rj.Recordings.from_arrays(WRENCH, annotations=marks)
    assert rj.Recordings.join([one.take([0, 1]), other.take(2)]) == one


def test_none_of_the_rows_is_a_choice() -> None:
    none = rj.encode(WRENCH).take([])
    assert len(none.llb.label) == 0
    assert none._repr_html_() == f"<div>{none!r}</div>"
    assert len(rj.Recordings.example().take(3)) == 1


def test_frame_has_a_row_per_word() -> None:
    tracks = rj.encode(WRENCH)
    frame = tracks.to_frame()
    columns = ["recording", "axis", "layer", "label", "t0", "t1", "emit", "vmax", "vmin", "avg", "grad"]
    assert sorted(frame.columns) == sorted(columns)
    for layer in ("primitive", "mc", "llb"):
        track = getattr(tracks, layer)
        some = frame[(frame.layer == layer) & (frame.recording == 2) & (frame["axis"] == "My")]
        used = track.label[2, 4] > 0
        assert some.label.tolist() == tracks.words("My", layer, 2)
        for name in ("t0", "t1", "emit", "vmax", "vmin", "avg", "grad"):
            np.testing.assert_array_equal(some[name], getattr(track, name)[2, 4][used])


def test_xarray_names_its_coordinates() -> None:
    source = xr.DataArray(WRENCH, dims=("trial", "time", "axis"), coords={"trial": ["a", "b", "c"], "axis": NAMES})
    data = rj.encode(source).to_xarray()
    assert data.recording.values.tolist() == ["a", "b", "c"]
    assert data.axis.values.tolist() == NAMES
    assert data.attrs["rate"] == 200
    np.testing.assert_array_equal(data.llb_label, EXPECTED.llb.label)


def test_recordings_are_taken_with_their_names() -> None:
    source = xr.DataArray(WRENCH, dims=("trial", "time", "axis"), coords={"trial": ["a", "b", "c"], "axis": NAMES})
    tracks = rj.encode(source)
    taken = tracks.take([2, 0])
    assert taken.words("Fy", recording="c") == taken.words("Fy", recording=0) == tracks.words("Fy", recording=2)
    assert taken.to_xarray().recording.values.tolist() == ["c", "a"]
    mask = tracks.take(np.array([False, True, False])).to_frame()
    assert mask.equals(tracks.to_frame().query("recording == 'b'").reset_index(drop=True))
    assert tracks.take(1).words("Fx") == tracks.words("Fx", recording=1)
    with pytest.raises(InputError, match="no recording 'd'; there are a, b, c"):
        tracks.words("Fx", recording="d")


def test_a_name_of_several_recordings_chooses_none() -> None:
    source = xr.DataArray(WRENCH, dims=("trial", "time", "axis"), coords={"trial": ["a", "b", "a"], "axis": NAMES})
    tracks = rj.encode(source)
    assert tracks.words("Fz", recording="b") == tracks.words("Fz", recording=1)
    with pytest.raises(InputError, match="2 of them have the name a; choose the recording by its number"):
        tracks.words("Fz", recording="a")


def test_arrays_that_were_cut_are_not_called_by_other_names() -> None:
    tracks = rj.encode(WRENCH)
    assert jax.tree.map(lambda leaf: leaf[1:], tracks).to_xarray().sizes["recording"] == 2
    some = jax.tree.map(lambda leaf: leaf[1, 2:4], tracks)
    assert repr(some).startswith("LabelTracks(1 recording, 2 axes")
    assert set(some.to_frame()["axis"]) == {"axis0", "axis1"}
    two_arms = rj.encode(pd.DataFrame(np.zeros((50, 12)), columns=[f"{arm}_{axis}" for arm in "LR" for axis in NAMES]))
    right = jax.tree.map(lambda leaf: leaf[6:], two_arms)  # six axes, but not known to be those of a wrench
    assert right.to_xarray().axis.values.tolist() == [f"axis{number}" for number in range(6)]


def test_missing_values_of_masked_arrays_and_pandas_are_seen() -> None:
    frame, expected = pd.DataFrame(WRENCH[1], columns=NAMES), rj.encode(WRENCH[1]).to_frame()
    for dtype in ("Float32", "float[pyarrow]"):
        assert rj.encode(frame.astype(dtype)).to_frame().equals(expected)
    counts = rj.encode(frame.round().astype("Int64")).to_frame()
    assert counts.equals(rj.encode(WRENCH[1].round()).to_frame())
    high = float(WRENCH[1].max())
    for form in (np.ma.masked_equal(WRENCH[1], high), frame.mask(frame == high).astype("Float32")):
        with pytest.raises(InputError, match="not finite"):
            rj.encode(form)


def test_streams_see_missing_values_too() -> None:
    high = float(WRENCH[1].max())
    frame = pd.DataFrame(WRENCH[1], columns=NAMES)
    for form in (np.ma.masked_equal(WRENCH[1], high), frame.mask(frame == high).astype("Float32")):
        encoder = rj.Encoder(rj.EncoderConfig(), rj.preset())
        with pytest.raises(InputError, match="not a finite number"):
            encoder.push(form)
        with pytest.raises(InputError, match="not a finite number"):
            rj.SnapDetector(200.0, NAMES, least=3.0).push(form)
        assert encoder.received == 0


NUMBERS = {
    "half": WRENCH.astype(np.float16),
    "bfloat16": WRENCH.astype(jnp.bfloat16),
    "on the device": jnp.asarray(WRENCH, jnp.bfloat16),
    "other bytes": WRENCH.astype(">f4"),
    "objects": WRENCH.astype(object),
    "whole": WRENCH.round().astype(np.int16),
}


@pytest.mark.parametrize("form", NUMBERS)
def test_numbers_of_any_type_are_those_of_single_precision(form: str) -> None:
    given, plain = NUMBERS[form], np.asarray(NUMBERS[form]).astype(np.float32)
    assert_trees_equal(labels_only(rj.encode(given)), labels_only(rj.encode(plain)))
    np.testing.assert_array_equal(rj.Recordings.from_arrays(given).wrench, plain)
    streams = [rj.Encoder(rj.EncoderConfig(), rj.preset()).push(one[0, :50]) for one in (given, plain)]
    assert_trees_equal(*streams)


def test_limits_that_are_changed_later_change_no_encoder() -> None:
    memory = np.zeros(6 * 4 * 4 + 64, np.uint8)
    start = -memory.ctypes.data % 64  # memory as JAX itself would use without a copy
    limits = memory[start : start + 96].view(np.float32).reshape(6, 4)
    limits[:] = rj.preset().limits
    used, later = (rj.Encoder(rj.EncoderConfig(), limits) for _ in range(2))
    features = rj.WrenchFeatures(thresholds=limits.astype(float))
    published, learned = used.push(WRENCH[0]), features.fit(WRENCH).transform(WRENCH)
    limits[:] = features.thresholds[:] = 1e6
    assert_trees_equal(later.push(WRENCH[0]), published)
    np.testing.assert_array_equal(features.transform(WRENCH), learned)


READERS = {
    "encode": lambda values: rj.encode([values]),
    "from_arrays": lambda values: rj.Recordings.from_arrays([values]),
    "features": lambda values: rj.WrenchFeatures().fit([values]),
    "nominal": lambda values: rj.NominalMonitor().fit([values] * 3),
    "stream": lambda values: rj.Encoder(rj.EncoderConfig(), rj.preset()).push(values),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    "values",
    [WRENCH[0] + 1j, WRENCH[0].astype(str), np.full((9, 6), "x"), np.zeros((9, 6), "M8[s]"), [[1.0] * 6, [1.0]]],
    ids=["complex", "digits", "text", "dates", "ragged"],
)
def test_what_is_no_number_is_refused_by_every_reader(reader: str, values: object) -> None:
    with pytest.raises(InputError, match=r"expected numbers|different lengths"):
        READERS[reader](values)


@pytest.mark.parametrize("reader", ["encode", "features", "stream"])
def test_numbers_beyond_single_precision_are_refused_without_a_warning(reader: str) -> None:
    with pytest.raises(InputError, match="finite number"):
        READERS[reader](np.full((50, 6), 1e300))


def test_whole_numbers_keep_their_digits_in_double_precision() -> None:
    counts = np.cumsum(RNG.integers(-9, 10, (300, 1)), 0)
    with jax.enable_x64(True):
        near, far = (rj.encode(counts + offset).primitive for offset in (0, 2**31))
    np.testing.assert_array_equal(near.label, far.label)


def test_repr_is_short_and_the_picture_shows_every_word() -> None:
    tracks = rj.encode(WRENCH[0])
    assert repr(tracks).startswith("LabelTracks(1 recording, 6 axes at 200 Hz: ")
    assert len(repr(tracks)) < 120
    words = sum(len(tracks.words(axis, layer)) for axis in range(6) for layer in ("primitive", "mc", "llb"))
    assert tracks._repr_html_().count("<rect") == words > 30
    repr(jax.eval_shape(lambda: EXPECTED))


def test_the_picture_of_a_long_recording_stays_small() -> None:
    """Ten minutes of noise made thirty megabytes of a notebook; a long word among short ones is drawn as before."""
    short = [Bar(k, k + 1, "#000000", "short") for k in range(100_000)]
    bars = [*short[:50_000], Bar(50_000, 60_000, "#000000", "long"), *short[60_000:]]
    picture = bands([("axis", bars)], "s")
    assert len(picture) < 2e5
    assert picture.count("short, ") == pytest.approx(0.9 * 720, abs=2)
    assert picture.count("long, 50000 to 60000 s") == 1


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: rj.encode(np.zeros(5)), "shape"),
        (lambda: rj.encode(np.zeros((5, 0))), "shape"),
        (lambda: rj.encode([]), "no recording"),
        (lambda: rj.encode([["a", "b"]]), "expected numbers"),
        (lambda: rj.encode(np.full((50, 6), np.nan)), "not finite"),
        (lambda: rj.encode(np.full((50, 6), np.nan), rule="fit"), "not finite"),
        (lambda: rj.encode(np.full((50, 6), np.inf), rule="fit"), "not finite"),
        (lambda: rj.encode(np.full((50, 6), 3e38)), "beyond 1e"),  # whose sums are infinite
        (lambda: rj.Encoder(rj.EncoderConfig(), rj.preset()).push(np.full((50, 6), 3e38)), "beyond 1e"),
        (lambda: rj.encode(WRENCH[0], rate=0), "rate"),
        (lambda: rj.encode(WRENCH[0], window=1), "window"),
        (lambda: rj.encode(WRENCH[0], 1000, config=rj.EncoderConfig()), "rate is 1000, in the config 200"),
        (lambda: rj.encode(WRENCH[0], window=7, config=rj.EncoderConfig()), "window is 7, in the config 5"),
        (lambda: rj.encode(WRENCH[0], rule="fit", config=rj.EncoderConfig()), "rule is fit, in the config paper"),
        (lambda: rj.encode(WRENCH[0], thresholds="r2d2"), "r2d2"),
        (lambda: rj.encode(WRENCH[0], thresholds=np.ones((2, 4))), "shape"),
        (lambda: rj.encode(WRENCH[0], thresholds=rj.GradientThresholds(np.tile([1.0, 2, 3, 4], (6, 1)))), "ordered"),
        (lambda: rj.encode([WRENCH[0], WRENCH[0, :, :3]]), "different axes"),
        (lambda: rj.encode([WRENCH[0]], lengths=[3]), "Lengths"),
        (lambda: rj.encode(WRENCH[:1], lengths=[2.9]), "whole numbers"),
        (lambda: rj.encode(WRENCH[:1], lengths=[2**32 + 100]), "whole numbers"),
        (lambda: rj.encode(pd.DataFrame(WRENCH[0]).assign(time=np.arange(300) * 0.01)), "100 samples per second"),
        (lambda: rj.encode(pd.DataFrame(WRENCH[0], pd.Index(np.arange(300) / 1e3, name="time"))), "1000 samples per"),
        (
            lambda: rj.encode(xr.DataArray(WRENCH[0], {"time": 2 * (DATES - DATES[0])}, ("time", "axis"))),
            "100 samples per",
        ),
        (
            lambda: rj.encode(pd.DataFrame(WRENCH[0]).assign(time=np.arange(300) * 0.005 + 98 * (np.arange(300) > 99))),
            r"jumps by 98.005 s after 0.495 s",
        ),
        (lambda: rj.encode(pd.DataFrame(WRENCH[0]).assign(time="noon")), "expected seconds or dates"),
        (lambda: rj.encode(pd.DataFrame(WRENCH[0], columns=["time", *NAMES[1:-1], "time"])), "2 columns of the name"),
        (lambda: rj.Recordings.from_arrays(WRENCH[0]), r"shapes \[\(6,\)\]"),
        (lambda: rj.Recordings.from_arrays(None), "NoneType; expected an array"),
        (lambda: rj.encode(xr.Dataset({"Fz": ("time", WRENCH[0, :, 2])})), "to_array"),
        (lambda: rj.encode(WRENCH[0]).words("Fw"), "Fw"),
        (lambda: rj.encode(WRENCH[0]).words(0, "word"), "word"),
        (lambda: rj.encode(WRENCH[0]).words(0, recording=1), "recording"),
    ],
)
def test_mistakes_are_one_sentence(call: object, sentence: str) -> None:
    with pytest.raises(InputError, match=f"(?i){sentence}"):
        call()  # type: ignore[operator]


@pytest.mark.parametrize("samples", [3, 7])
def test_a_window_of_another_length_is_refused(samples: int) -> None:
    config = rj.EncoderConfig(window=5)
    with pytest.raises(InputError, match=f"{samples} samples"):
        encoder.step(config, rj.preset(), encoder.init((6,)), jnp.zeros((samples, 6)))


def test_thresholds_are_a_pytree_that_can_be_differentiated() -> None:
    thresholds = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), rj.preset())
    gradient = jax.device_get(jax.grad(lambda x: -(x.limits**2).sum())(thresholds))
    np.testing.assert_allclose(gradient.limits, -2 * thresholds.limits)
    assert isinstance(gradient, rj.GradientThresholds)


def test_pure_core_takes_the_object_or_its_limits_under_jit_vmap_and_scan() -> None:
    config, state = rj.EncoderConfig(), encoder.init((6,))
    windows = jnp.asarray(WRENCH[0].reshape(60, 5, 6))
    object_ = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), rj.preset())

    def run(thresholds: object) -> object:
        return jax.lax.scan(lambda carry, window: encoder.step(config, thresholds, carry, window), state, windows)

    assert_trees_equal(jax.jit(run)(object_), jax.jit(run)(object_.limits))
    many = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), object_)
    assert_trees_equal(jax.tree.map(lambda leaf: leaf[1], jax.vmap(run)(many)), jax.jit(run)(object_))
