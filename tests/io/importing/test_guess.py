"""What names say about columns, as a table."""

from __future__ import annotations

import numpy as np
import pytest

from rcbht_jax._util.columns import base_and_unit
from rcbht_jax.errors import InputError
from rcbht_jax.io.importing.guess import guess, outcome_words
from rcbht_jax.io.importing.mapping import Channel, Mapping, Track, Value
from rcbht_jax.io.importing.names import column_name, wrenches
from rcbht_jax.io.importing.table import Table
from rcbht_jax.labels import AXES

N = 30


def table(*names: str, **values: object) -> Table:
    """Columns of numbers that never repeat, but for those given."""
    rng = np.random.default_rng(0)
    columns = {name: rng.normal(size=N) for name in names}
    return Table("a.csv", {name: np.asarray(values.get(name, column)) for name, column in columns.items()})


def test_a_time_that_runs_backwards_does_not_make_each_sample_a_recording() -> None:
    backwards = table("t", "Fx", t=-0.01 * np.arange(N), Fx=np.arange(N, dtype=float))
    assert guess(backwards)[0].group == ""


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.inf, 1e308])
def test_infinite_and_huge_values_are_no_warning_of_numpy(value: float) -> None:
    mapping, _ = guess(table("t", "Fx", t=np.arange(N) * 0.01, Fx=np.resize([0.0, value, -value, value, value], N)))
    assert [channel.name for channel in mapping.channels] == ["Fx"]


@pytest.mark.parametrize(
    ("names", "axes", "units"),
    [
        ("Fx Fy Fz Mx My Mz", "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("Fx Fy Fz Tx Ty Tz px py", "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("fx_N fy_N fz_N tx_Nm ty_Nm tz_Nm", "Fx Fy Fz Mx My Mz", "N,N,N,Nm,Nm,Nm"),
        ("force_x force_y force_z torque_x torque_y torque_z q_0", "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("field.wrench.force.x field.wrench.force.y field.wrench.force.z field.wrench.torque.x field.wrench.torque.y"
         " field.wrench.torque.z", "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("Fx[N] Fy[N] Fz[N] Mx[Nm] My[Nm] Mz[Nm]", "Fx Fy Fz Mx My Mz", "N,N,N,Nm,Nm,Nm"),
        ("actual_TCP_force_0 actual_TCP_force_1 actual_TCP_force_2 actual_TCP_force_3 actual_TCP_force_4"
         " actual_TCP_force_5 actual_q_0", "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("F_0 F_1 F_2 T_0 T_1 T_2", "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("wrench_0 wrench_1 wrench_2 wrench_3 wrench_4 wrench_5 quat_0", "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("F.x F.y F.z speed", "Fx Fy Fz", ",,"),
        ("force_norm torque_norm", "force_norm torque_norm", ","),
        ("position.x position.y position.z", "position.x position.y position.z", ",,"),
        ("tx ty tz px", "tx ty tz px", ",,,"),
        ("strain [mm]", "strain", "mm"),
        ("q_0 " + " ".join(f"{frame}_F_ext_hat_K_{k}" for frame in "OK" for k in range(6)), "Fx Fy Fz Mx My Mz",
         ",,,,,"),
        ("wrench[0] wrench[1] wrench[2] wrench[3] wrench[4] wrench[5]", "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("F_ext_x F_ext_y F_ext_z q", "Fx Fy Fz", ",,"),
        ("Kraft_x_N Kraft_y_N Kraft_z_N Drehmoment_x_Nm Drehmoment_y_Nm Drehmoment_z_Nm", "Fx Fy Fz Mx My Mz",
         "N,N,N,Nm,Nm,Nm"),
        ("Weg_x Weg_y Weg_z", "Weg_x Weg_y Weg_z", ",,"),
        ("cartForce1_X cartForce1_Y cartForce1_Z cartTorque1_TauX cartTorque1_TauY cartTorque1_TauZ cartPosCmd1_X",
         "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("tcpForceX tcpForceY tcpForceZ tcpSpeedX", "Fx Fy Fz", ",,"),
        ("s.force[1] s.force[2] s.force[3] s.torque[1] s.torque[2] s.torque[3]", "Fx Fy Fz Mx My Mz", ",,,,,"),
        (" ".join(f"wrench.signals.values_{k}" for k in range(6)), "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("F_1 F_2 F_3", "F_1 F_2 F_3", ",,"),
        ("F1 F2 F3 F4 F5 F6", "F1 F2 F3 F4 F5 F6", ",,,,,"),
        ("FT1 FT2 FT3 FT4 FT5 FT6", "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("x_force_N y_force_N z_force_N x_torque_Nmm y_torque_Nmm z_torque_Nmm", "Fx Fy Fz Mx My Mz",
         "N,N,N,Nmm,Nmm,Nmm"),
        ("x_speed y_speed z_speed", "x_speed y_speed z_speed", ",,"),
        ("Fx_tool Fy_tool Fz_tool Mx_tool My_tool Mz_tool", "Fx Fy Fz Mx My Mz", ",,,,,"),
        (" ".join(f"ee_force_filtered_{k}" for k in range(6)), "Fx Fy Fz Mx My Mz", ",,,,,"),
        ("Fx_dot Fy_dot Fz_dot Fx Fy Fz", "Fx Fy Fz", ",,"),
        ("Fx_tool Fy_tool Fz_tool Fx Fy Fz", "Fx Fy Fz", ",,"),
        ("Fx/N Fy/N Fz/N Mx/Ncm My/Ncm Mz/Ncm", "Fx Fy Fz Mx My Mz", "N,N,N,Ncm,Ncm,Ncm"),
        ("force_x force_y force_z " + " ".join(f"joint_torque_{k}" for k in range(7)), "Fx Fy Fz", ",,"),
    ],
)  # fmt: skip
def test_channels(names: str, axes: str, units: str) -> None:
    listed = [names] if "strain" in names else names.split()
    mapping, _ = guess(table("t", *listed, t=np.arange(N) * 0.1))
    assert mapping.axes == ((axes,) if "strain" in axes else tuple(axes.split()))
    assert mapping.units == tuple(units.split(","))
    assert mapping.time == "t"


@pytest.mark.parametrize("names", ["tx ty tz fx fy fz mx my mz", "fx fy fz mx my mz tx ty tz"])
def test_beside_moments_a_t_is_a_translation(names: str) -> None:
    mapping, _ = guess(table("t", *names.split(), t=np.arange(N) * 0.1))
    assert [channel.column for channel in mapping.channels] == ["fx", "fy", "fz", "mx", "my", "mz"]


@pytest.mark.parametrize("demanded", ["desired_wrench", "cmd/wrench", "next_obs/wrench", "targetWrench.wrench"])
def test_what_was_measured_comes_before_what_was_wanted(demanded: str) -> None:
    both = [f"{name}_{k}" for name in (demanded, "wrench") for k in range(6)]
    mapping, _ = guess(table("t", *both, t=np.arange(N) * 0.1))
    assert mapping.channels[0].column == "wrench_0"


@pytest.mark.parametrize(
    ("name", "values", "unit"),
    [
        ("time", np.arange(N) * 0.1, "s"),
        ("Time [ms]", np.arange(N) * 10.0, "ms"),
        ("ts", np.arange(N) * 0.01, "s"),
        ("t_us", np.arange(N) * 10.0, "us"),
        ("timestamp", 1.5e18 + np.arange(N) * 1e7, "ns"),
        ("stamp", 1.5e15 + np.arange(N) * 1e4, "us"),
        ("%time", 1.5e12 + np.arange(N) * 10, "ms"),
        ("timestamp", 1.5e9 + np.arange(N) * 0.01, "s"),
        ("c0", np.arange(N) * 0.05, "s"),
        ("Zeit [ms]", np.arange(N) * 5.0, "ms"),
        ("time", np.arange(N).astype("datetime64[s]").astype(str), "s"),
        ("Date/Time", np.arange(N).astype("datetime64[s]").astype(str), "s"),
        ("Aufgenommen", np.arange(N).astype("datetime64[s]").astype(str), "s"),
        ("simTime", np.arange(N) * 0.05, "s"),
        ("duration", np.arange(N) * 2.0, "ms"),
        ("Time", 45321.43 + np.arange(N) * 0.005 / 86400, "d"),
        ("Gemessen", 739311.43 + np.arange(N) * 0.005 / 86400, "d"),
        ("time values", np.arange(N) * 0.05, "s"),
        ("Time (min)", np.arange(N) * 0.001, "min"),
        ("time, s", np.arange(N) * 0.05, "s"),
        ("X_Value", np.arange(N) * 0.001, "s"),
    ],
)
def test_time(name: str, values: np.ndarray, unit: str) -> None:
    mapping, _ = guess(Table("a.csv", {name: values, "Fz": np.ones(N)}))
    assert (mapping.time, mapping.time_unit) == (name, unit)
    assert mapping.axes == ("Fz",)


@pytest.mark.parametrize(
    ("axes", "step", "unit"), [(["Fx", "Fy", "Fz"], 1.0, "ms"), (["Fx", "Fy", "Fz"], 0.8, "s"), (["level"], 1.0, "s")]
)
def test_a_wrench_is_not_logged_once_a_second(axes: list[str], step: float, unit: str) -> None:
    mapping, _ = guess(Table("a.csv", {"time": np.arange(N) * step} | {axis: np.ones(N) for axis in axes}))
    assert mapping.time_unit == unit


def test_a_step_of_time_is_a_counter() -> None:
    assert guess(Table("a.csv", {"time_step": np.arange(N) * 1.0, "level": np.ones(N)}))[0].time == ""


@pytest.mark.parametrize("name", ["contact", "in_contact", "activity"])
def test_numbers_of_a_contact_are_labels(name: str) -> None:
    columns = {"t": np.arange(N) * 0.1, "Fx": np.ones(N), "Fy": np.ones(N), "Fz": np.ones(N)}
    mapping, _ = guess(Table("a.csv", columns | {name: np.repeat([0.0, 1.0], N // 2)}))
    assert [track.track for track in mapping.annotations] == [name]


def test_a_time_stops_no_stated_rate_if_it_repeats() -> None:
    columns = {"Time": np.repeat(np.arange(N / 2) * 0.016, 2), "Fz": np.ones(N)}
    assert guess(Table("a.csv", columns, rate=125.0))[0].time == ""


@pytest.mark.parametrize("names", [("ZeitInSec", "ZeitInNanoSec"), ("c0", "c1")])
def test_seconds_and_nanoseconds_of_other_names(names: tuple[str, str]) -> None:
    stamps = np.arange(N) * 100_000_000
    columns = {names[0]: 1.7e9 + stamps // 10**9, names[1]: stamps % 10**9 * 1.0, "Fz": np.ones(N)}
    mapping, _ = guess(Table("a.csv", columns))
    assert (mapping.time, mapping.nanoseconds) == names


def test_seconds_and_nanoseconds() -> None:
    columns = {"sec": np.repeat([5.0, 6.0], N // 2), "nanosec": np.tile(np.arange(N // 2) * 1e7, 2), "Fz": np.ones(N)}
    mapping, _ = guess(Table("a.csv", columns))
    assert (mapping.time, mapping.nanoseconds) == ("sec", "nanosec")


def test_a_step_in_words_is_no_counter() -> None:
    steps = np.repeat(["find", "screw"], N // 2)
    mapping, _ = guess(Table("a.csv", {"t": np.arange(N) * 0.1, "Fz": np.ones(N), "Step": steps}))
    assert [track.column for track in mapping.annotations] == ["Step"]


def test_a_counter_is_neither_time_nor_channel() -> None:
    mapping, _ = guess(
        Table("a.csv", {"c0": np.arange(N) * 1.0, "sample": np.arange(N) * 1.0, "Fz": np.ones(N)}, rate=5.0)
    )
    assert mapping.time == ""
    assert mapping.axes == ("Fz",)


def test_words_are_annotations_or_columns() -> None:
    phase = np.array(["a"] * 10 + ["b"] * 20)
    number = np.repeat([1.0, 2.0], N // 2)
    columns = {"t": np.arange(N) * 0.1, "Fz": np.ones(N), "phase": phase, "label": number, "part": np.full(N, "peg")}
    columns |= {
        "success": np.ones(N),
        "session": np.full(N, 3.0),
        "remark": np.array([f"row {k}" for k in range(N)] * 1),
    }
    mapping, rows = guess(Table("a.csv", columns))
    assert [(track.track, track.column) for track in mapping.annotations] == [("phase", "phase"), ("remark", "remark")]
    assert set(mapping.columns) == {"part", "outcome", "success", "session"}
    assert mapping.columns["outcome"].words["1"] == "success"
    assert {row.column: row.role for row in rows}["label"] == "left out"
    del columns["phase"], columns["remark"]
    mapping, _ = guess(Table("a.csv", columns))
    assert [track.column for track in mapping.annotations] == ["label"]


def test_a_group_separates_recordings_only_if_it_changes() -> None:
    columns = {"t": np.tile(np.arange(15) * 0.1, 2), "Fz": np.ones(N), "instance": np.repeat([0.0, 1.0], 15)}
    columns["class"] = np.repeat(["ok", "stuck"], 15)
    mapping, _ = guess(Table("a.csv", columns))
    assert mapping.group == "instance"
    assert set(mapping.columns) == {"class"}
    columns["instance"] = np.zeros(N)
    assert guess(Table("a.csv", columns))[0].group == ""


@pytest.mark.parametrize("name", ["trial_id", "Sample", "Versuch"])
def test_what_changes_where_the_time_starts_anew_separates_recordings(name: str) -> None:
    """Numbers that change only there describe recordings: as channels, they would tell a classifier what they say."""
    columns = {
        "time": np.tile(np.arange(10) * 0.1, 3),
        name: np.repeat([4.0, 2.0, 7.0], 10),
        "load": np.arange(N) % 7.0,
    }
    columns |= {"anomaly": np.repeat([0.0, 1.0, 0.0], 10), "mass": np.repeat([0.5, 0.7, 0.7], 10), "dead": np.ones(N)}
    mapping, _ = guess(Table("a.csv", columns))
    assert mapping.group == name
    assert mapping.axes == ("load", "dead")
    assert set(mapping.columns) == {"anomaly", "mass"}


def test_the_name_of_a_folder_says_nothing() -> None:
    mapping, _ = guess(Table("my_unsuccessful_runs/failure.csv", {"t": np.arange(N) * 0.1, "Fz": np.ones(N)}))
    assert "outcome" not in mapping.columns


def test_stated_parts_are_not_guessed_again() -> None:
    mapping, rows = guess(table("clock", "t", "Fz", t=np.arange(N) * 0.1), Mapping(time="clock"))
    assert mapping.time == "clock"
    assert [row.role for row in rows] == ["time", "left out", "channel Fz"]


def test_too_many_channels_are_refused() -> None:
    with pytest.raises(InputError, match="70 columns of numbers and none is a wrench"):
        guess(table("t", *(f"x{k}" for k in range(70)), t=np.arange(N) * 1.0))


def test_two_wrenches_are_two() -> None:
    names = [f"{side}.{kind}.{axis}" for side in ("left", "right") for kind in ("force", "torque") for axis in "xyz"]
    assert [wrench["Mx"] for wrench in wrenches(names)] == ["left.torque.x", "right.torque.x"]


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("Fx", ("fx", "")),
        ("Fx (N)", ("fx", "N")),
        ("a_N", ("a", "N")),
        ("T [N m]", ("t", "Nm")),
        ("grip_n", ("grip_n", "")),
    ],
)
def test_units_in_names(name: str, parts: tuple[str, str]) -> None:
    assert base_and_unit(name) == parts


@pytest.mark.parametrize(
    ("steps", "unit"),
    [(5.0, "ms"), (2000.0, "us"), (1e6, "ns"), (0.005, "s"), (1.0, "s"), (200.0, "s")],  # the last may be two units
)
def test_the_unit_of_bare_stamps_follows_from_their_steps(steps: float, unit: str) -> None:
    first = 5e12 if unit == "ns" else 0.0  # since the machine started
    mapping, _ = guess(Table("a.csv", {"timestamp": first + np.arange(N) * steps, "Fz": np.ones(N)}))
    assert mapping.time_unit == unit


@pytest.mark.parametrize("step", [0.01, 1.0, 2.0])
def test_seconds_since_1970_are_seconds_in_steps_of_any_size(step: float) -> None:
    mapping, _ = guess(Table("a.csv", {"timestamp": 1.7e9 + np.arange(N) * step, **dict.fromkeys(AXES, np.ones(N))}))
    assert mapping.time_unit == "s"


def test_an_arm_that_changes_separates_recordings() -> None:
    arms = np.array(["left", "right"] * (N // 2))
    mapping, _ = guess(table("t", "arm", "Fz", t=np.arange(N) // 2 * 0.1, arm=arms))
    assert (mapping.group, mapping.columns, mapping.annotations) == ("arm", {"arm": Value("arm")}, ())


def test_a_label_of_some_rows_marks_those_and_a_word_describes_the_recording() -> None:
    some = np.array([""] * 10 + ["contact"] * 20)
    number = np.where(some == "", np.nan, 1.0)
    mapping, _ = guess(table("t", "Fz", "phase", "part", t=np.arange(N) * 0.1, phase=some, part=some))
    assert (mapping.annotations, set(mapping.columns)) == ((Track("phase", "phase"),), {"part"})
    assert guess(table("t", "Fz", "label", t=np.arange(N) * 0.1, label=number))[0].annotations == (
        Track("label", "label"),
    )


@pytest.mark.parametrize("cell", ["1.258,95", "3.2 N"])
def test_an_axis_of_text_is_not_left_out_of_its_wrench(cell: str) -> None:
    columns = {"t": np.arange(9) * 0.1, "Fx [mN]": np.full(9, cell), "Fy [mN]": np.ones(9), "Fz [mN]": np.ones(9)}
    how = r"Write plain numbers, and their unit in the name of the column: Fx \[N\]\.$"
    with pytest.raises(InputError, match=rf"column 'Fx \[mN\]' holds '{cell}', which is not a number\. {how}"):
        guess(Table("a.csv", columns))


def test_the_time_of_simulink_is_one() -> None:
    mapping, _ = guess(Table("a.mat", {"tout": np.arange(9) * 0.1, "Fz": np.ones(9)}))
    assert mapping.time == "tout"


def test_a_sensor_of_three_forces_and_one_moment_keeps_it() -> None:
    assert wrenches(["Fx", "Fy", "Fz", "Mz"]) == [{"Fx": "Fx", "Fy": "Fy", "Fz": "Fz", "Mz": "Mz"}]


@pytest.mark.parametrize(
    ("seconds", "rest", "receipt"),
    [
        ("header.stamp.secs", "header.stamp.nsecs", "Time"),  # bagpy
        ("header.stamp.sec", "header.stamp.nsec", "log_time"),  # Foxglove
        ("stamp_sec", "stamp_nanosec", "t"),
    ],
)
def test_stamps_of_a_header_in_two_columns_are_the_time(seconds: str, rest: str, receipt: str) -> None:
    count = np.arange(400.0)
    late = 5.0 + count * 0.01 + 0.004 * (count % 2)
    columns = {receipt: late, seconds: 5 + count // 100, rest: count % 100 * 1e7, "Fz": np.sin(count)}
    mapping, _ = guess(Table("a.csv", columns))
    assert (mapping.time, mapping.time_unit, mapping.nanoseconds) == (seconds, "s", rest)
    unset = columns | {seconds: 0 * count, rest: 0 * count}  # where the driver states none
    assert guess(Table("a.csv", unset))[0].time == receipt


@pytest.mark.parametrize("name", ["__time", "log_time", "publish_time"])
def test_times_of_exports_of_plotjuggler_and_foxglove(name: str) -> None:
    mapping, _ = guess(Table("a.csv", {name: 1.7e18 + np.arange(9) * 1e7, "Fz": np.ones(9)}))
    assert (mapping.time, mapping.time_unit) == (name, "ns")


@pytest.mark.parametrize("base", [Mapping(time="nope"), Mapping(group="nope"), Mapping((Channel("nope"),))])
def test_a_named_column_that_is_missing_is_told(base: Mapping) -> None:
    with pytest.raises(InputError, match=r"^a\.csv has no column 'nope'; it has t, Fz\.$"):
        guess(Table("a.csv", {"t": np.arange(9) * 0.1, "Fz": np.ones(9)}), base)


@pytest.mark.parametrize(
    "column", ["anomaly", "isFaulty", "error_code", "NOK", "not_ok", "non-success", "unsuccessful"]
)
def test_what_is_true_in_a_column_named_after_an_error_is_a_failure(column: str) -> None:
    words = outcome_words(column)
    assert (words["1"], words["0"], words["ok"]) == ("failure", "success", "success")


@pytest.mark.parametrize("column", ["result", "default", "ok", "no_fault", "failure_free", "errorless", "fehlerfrei"])
def test_what_is_true_in_a_column_that_denies_an_error_is_a_success(column: str) -> None:
    words = outcome_words(column)
    assert (words["true"], words["false"], words["nok"]) == ("success", "failure", "failure")


def test_the_unit_of_a_speed_of_rotation_is_known() -> None:
    columns = {"t": np.arange(9.0), "speed [rpm]": np.arange(9.0) ** 2}
    assert guess(Table("a.csv", columns))[0].units == ("rpm",)


@pytest.mark.parametrize("text", ["remark of the operator " * 20, "é" * 300, "部品" * 90])
def test_a_long_title_becomes_a_name_that_a_store_accepts(text: str) -> None:
    """The import ended with an error of the file system."""
    assert len(column_name(text).encode()) <= 200
    assert column_name(text) != column_name(text + "!?x")
    assert column_name("zarr.json") == "c_zarr.json"
