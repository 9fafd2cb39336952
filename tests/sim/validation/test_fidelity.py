"""Fidelity: its measures obey their definitions, its report is whole, resumed and honest."""

from __future__ import annotations

import importlib.metadata
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from matplotlib.figure import Figure

from rcbht_jax.cli import main
from rcbht_jax.errors import InputError
from rcbht_jax.io.store import write_recordings
from rcbht_jax.robots.snap_assembly import RECORDED
from rcbht_jax.types import Recordings
from sim_mjx import engines
from sim_mjx.assembly.rollout import Rollouts
from sim_mjx.assembly.task import CONTROL_PERIOD
from sim_mjx.cli.fidelity import Fidelity, Session, table
from sim_mjx.cli.fidelity_fit import BOUNDS
from sim_mjx.engines import native
from sim_mjx.presets import preset
from sim_mjx.randomization import overrides
from sim_mjx.synthesis import plan
from sim_mjx.validation import dynamics, fidelity, gate, sessions, signature, snaps

SAMPLES = 400
QUIET = dynamics.Dynamics(np.zeros(0), None)
SOLVER = {
    "step": {"force": 3.0, "moment": 0.1}, "limits": {"force": 0.05, "moment": 0.005}, "trials": 4, "touched": 4,
    "holds": False,
}  # fmt: skip


def run_of(seed: int, trials: int = 3) -> Rollouts:
    """Numbers in place of physics."""
    rng = np.random.default_rng(seed)
    wrench = np.cumsum(rng.normal(0, 0.3, (trials, SAMPLES, 6)), axis=1).astype(np.float32)
    length = np.array([SAMPLES, SAMPLES - 40, SAMPLES - 7][:trials], np.int32)
    for row, samples in enumerate(length):
        wrench[row, samples:] = 0
    onset = np.array([0.0, 0.2, 0.4, 0.7]) + np.zeros((trials, 1))
    joints = np.zeros_like(wrench)
    past = np.zeros((*wrench.shape[:2], 4), bool)
    return Rollouts(wrench, joints, length, onset, np.ones((trials, 4), bool), np.zeros(trials, bool), past)


def test_rings_are_found() -> None:
    times = np.arange(2000) * CONTROL_PERIOD
    after = np.maximum(times - 3.0, 0.0)
    push = np.where(times < 3.0, 12.0, 30.0)
    force = push + 12.0 * np.exp(-after) * np.sin(2 * np.pi * 2.34 * after) + 0.05 * times
    found = dynamics.ringing(np.stack([force, force]), np.array([2000, 1300]), np.array([3.0, 3.0]))
    assert found is not None
    assert found.hertz == pytest.approx(2.34, abs=0.03)
    assert found.peak == pytest.approx(force.max())
    assert found.damping == pytest.approx(1 / (2 * np.pi * 2.34), rel=0.1)
    assert dynamics.ringing(force[None], np.array([1300]), np.array([3.0])) is None
    assert dynamics.ringing(force[None], np.array([2000]), np.array([np.nan])) is None


def test_profiles_leave_out_what_never_mated() -> None:
    run = run_of(0)
    run = replace(run, onset=np.array([[0.0, 0.2, 0.5, 0.9], [0.0, 0.2, np.nan, np.nan], [0.0, 0.2, 0.5, 1.5]]))
    found = sessions.profiles(run)
    assert found.shape == (1, 4, 100, 6)
    edges = [0.0, 0.2, 0.5, 0.9, 1.9]
    for state, (low, high) in enumerate(pairwise(edges)):
        times = np.arange(SAMPLES) * CONTROL_PERIOD
        expected = np.interp(np.linspace(low, high, 100), times, run.wrench[0, :, 3])
        np.testing.assert_allclose(found[0, state, :, 3], expected, atol=1e-5)
    assert sessions.profiles(run, [1, 2]).shape == (0, 4, 100, 6)


def test_the_loss_is_least_for_the_session_itself() -> None:
    run = run_of(0)
    own = sessions.Target(preset("B"), sessions.profiles(run), np.array([0.2, 0.4, 0.7]), QUIET, None)
    itself = sessions.loss(own, run, outcomes=False)
    assert itself == pytest.approx(0.0, abs=0.15)
    assert sessions.loss(own, run_of(1), outcomes=False) > itself + 0.2
    later = replace(run, onset=run.onset + np.array([0.0, 0.0, 0.0, 0.06]))
    assert sessions.loss(own, later, outcomes=False) > itself
    lost = replace(run, onset=np.full((3, 4), np.nan))
    assert sessions.loss(own, lost, outcomes=False) == pytest.approx(sessions.LOST + 1 + sessions.WORST_CELL)
    # three seated trials against the first three cells: only the third, (0, -2), was recorded off-seat
    assert sessions.agreement(preset("B"), run) == 2
    assert sessions.loss(own, run, outcomes=True) == pytest.approx(itself + 1 / 3)


def test_missing_snaps_are_a_loss() -> None:
    snap = snaps.Snap(8.0, 17.0, 11.0)
    target = sessions.Target(
        preset("B"), np.zeros((1, 4, 100, 6)), np.zeros(3), QUIET, snaps.summary([[snap], [snap], [snap], []])
    )
    assert sessions.missing_snaps(target, snaps.summary([[], []])) == 0.75
    assert sessions.missing_snaps(target, snaps.summary([[snap], []])) == 0.25
    assert sessions.missing_snaps(target, snaps.summary([[snap]])) == 0.0
    assert sessions.missing_snaps(replace(target, snaps=None), snaps.summary([[]])) == 0.0


def test_session_b_is_a_grid_and_a_repeats_one_pose() -> None:
    grid = sessions.trials_of(preset("B"))
    moved = grid.task.way_position[:, 0, :2] - grid.task.way_position[0, 0, :2]
    assert sorted(map(tuple, np.round(moved * 1e3).astype(int).tolist())) == sorted(preset("B").placements)
    repeats = sessions.trials_of(preset("A"), 5, physical=(("parts.friction", 0.4),))
    assert np.ptp(repeats.parts.tab_stiffness, axis=0).max() == 0
    assert repeats.parts.friction.tolist() == [0.4] * 5
    short = sessions.trials_of(preset("B"), 2, whole=False)
    assert short.task.mating_time.tolist() == [pytest.approx(signature.MATING + 0.1)] * 2
    with pytest.raises(InputError, match="count is 26; session B has 25 cells"):
        sessions.trials_of(preset("B"), 26)


def test_the_model_stands_where_the_recorded_arm_stood(hiro_dir: Path, tmp_path: Path) -> None:
    found = fidelity.kinematics(hiro_dir)
    assert set(found) == {"A", "B", "C", "openhrp"}
    for session, row in found.items():
        assert row["holds"], session
        assert row["trials"] >= 5
    for session in ("B", "C", "openhrp"):
        assert found[session]["rms_mm"] <= 0.01
        assert found[session]["rms_degrees"] <= 0.002
    assert found["A"]["rms_mm"] <= 0.3
    with pytest.raises(InputError, match="holds no trial"):
        fidelity.kinematics(tmp_path)


LOOSE = gate.GateLimits(
    coverage=0, w1_over_sd=9, dtw_over_sd=9, auc=1, spread=9, impact=9, ring=9, ring_peak=9, damping=9, fewer_snaps=1,
    late=9,
)  # fmt: skip


def test_a_session_is_held_against_its_recordings(monkeypatch: pytest.MonkeyPatch) -> None:
    run, snap = run_of(0), snaps.Snap(8.0, 17.0, 11.0)
    run.seated[1] = [True, True, False, True]
    events = dynamics.Dynamics(np.array([10.0, 11, 12]), dynamics.Ring(2.0, 30.0, 0.1))
    known = dynamics.Dynamics(np.array([20.0]), dynamics.Ring(2.5, 40.0, 0.2))
    found, recorded = snaps.summary([[snap], [], []]), snaps.summary([[snap], [snap]])
    monkeypatch.setattr(fidelity, "rerun", lambda *_: (run, events, found))
    monkeypatch.setattr(signature, "signature_figure", lambda *_: Figure())  # other tests draw it
    strict = replace(LOOSE, impact=1.5)
    target = sessions.Target(
        replace(preset("B"), gate=strict), sessions.profiles(run), np.array([0.3, 0.4, 0.9]), known, recorded
    )
    said, picture = fidelity.session(target)
    expected = gate.checks(strict, target.profiles, target.profiles, (known, events), (1.0, 1 / 3), 0.2)
    values = {name: check["value"] for name, check in said["gate"].items()}
    assert values == pytest.approx({name: check.value for name, check in expected.items()})
    assert [name for name, check in said["gate"].items() if not check["holds"]] == ["first impact"]
    assert (said["trials"], said["recorded_trials"], said["mated"], said["holds"]) == (3, 3, 3, False)
    assert said["seated"] == pytest.approx(2 / 3)
    assert said["onsets"] == pytest.approx([0.2, 0.4, 0.7])
    assert said["outcomes_as_recorded"] == [sessions.agreement(target.session, run), 3]
    assert (said["ring"]["hertz"], said["recorded_ring"]["hertz"]) == (2.0, 2.5)
    assert picture is not None
    loose = replace(target, session=replace(preset("B"), gate=LOOSE))
    assert fidelity.session(loose)[0]["holds"]
    assert fidelity.snap_shares(replace(target, snaps=snaps.summary([])), found) is None
    monkeypatch.setattr(fidelity, "rerun", lambda *_: (replace(run, onset=np.full((3, 4), np.nan)), events, found))
    lost, picture = fidelity.session(loose)
    assert (lost["mated"], lost["onsets"], lost["gate"], lost["holds"], picture) == (0, None, {}, False, None)


def test_events_are_those_of_the_force_at_touch_and_mating(monkeypatch: pytest.MonkeyPatch) -> None:
    run = run_of(0)
    run = replace(run, length=np.full(3, SAMPLES, np.int32))
    monkeypatch.setattr(native, "simulate", lambda *_, **__: run)
    monkeypatch.setattr(fidelity, "seated_snaps", lambda *_: {})
    _, events, _ = fidelity.rerun(preset("B"), 3)
    first = round(0.2 / CONTROL_PERIOD)
    near = run.wrench[:, first : first + round(dynamics.IMPACT / CONTROL_PERIOD), 2]
    np.testing.assert_allclose(events.impact, near.max(1))


def test_another_engine_is_held_against_the_native_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def off(scene: Any, params: Any, _: str) -> Rollouts:
        out = native.simulate(scene, params)
        return replace(out, wrench=out.wrench + np.float32(0.3), seated=out.seated)

    monkeypatch.setattr(engines, "simulate", off)
    said = fidelity.parity("mjx", preset("hooked-B"), trials=4, longest=1.0)
    assert said["force_until_contact"] == pytest.approx(0.3, abs=1e-4)
    assert said["same_outcome"] == 1.0
    assert not said["holds"]
    line = table({"engine mjx hooked-B": json.loads(json.dumps(said)), "left_out": []})
    assert line.startswith("engine mjx hooked-B")
    assert line.endswith("MISSED")


def test_the_command_reports_resumes_and_leaves_nothing_out_silently(
    hiro_store: Path,
    hiro_recordings: Recordings,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out, calls = tmp_path / "out", list[str]()
    real = fidelity.convergence

    def counted(*args: Any) -> dict[str, Any]:
        calls.append("solver")
        return real(*args)

    def few(target: sessions.Target, count: int | None, seed: int) -> Any:
        calls.append(target.session.name)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return fidelity_session(target, 2, seed)

    fidelity_session = fidelity.session
    monkeypatch.setattr(fidelity, "convergence", counted)
    monkeypatch.setattr(fidelity, "session", few)
    options = "--session C --trials 4 --max-seconds 0.3"
    words = f"fidelity -o {out} --recorded {hiro_store} {options}".split()
    assert main.main(words) == 130
    assert not (out / "report.json").exists()
    assert main.main(words) == 0
    assert calls == ["solver", "C", "C"]  # the solver's part was kept
    text = capsys.readouterr().out
    assert "skipped without recordings: kinematics" in text
    assert "session C" in text
    assert "0 of 4 trials touched" in text
    assert "report.json, report.txt, pictures" in text
    report = json.loads((out / "report.json").read_text())
    assert (
        report["session C"]["recorded_trials"]
        == (np.isfinite(hiro_recordings.starts(RECORDED)).all(1) & (hiro_recordings.session == "C")).sum()
    )
    assert (out / "session-C.png").stat().st_size > 10_000
    assert (out / "report.txt").read_text().rstrip() in text
    assert main.main([*words, "--seed", "1"]) == 0
    assert calls[3:] == ["solver", "C"]  # other options: measured again


def test_other_data_or_versions_are_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "20121127" / "trial").mkdir(parents=True)
    angles = tmp_path / "20121127" / "trial" / "R_Torques.dat"
    angles.write_text("0 1\n")
    command = Fidelity(data=tmp_path)
    first = command._made_by()
    assert command._made_by() == first
    angles.write_text("0 1\n0.005 1\n")
    second = command._made_by()
    assert second != first
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "0")
    assert command._made_by() != second


def test_a_picture_that_is_gone_is_drawn_again(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    made: list[int] = []

    def job() -> tuple[dict[str, Any], Figure | None]:
        made.append(len(made))
        return {"mated": mated}, Figure() if mated else None

    for mated, times in ((3, 2), (0, 1)):  # without a trial that mated there is no picture to miss
        name, picture = f"session {mated}", tmp_path / f"session-{mated}.png"
        made.clear()
        for _ in range(2):
            assert Fidelity(out=tmp_path)._part(name, job) == {"mated": mated}
            assert len(made) == 1
        picture.unlink(missing_ok=True)
        assert Fidelity(out=tmp_path)._part(name, job) == {"mated": mated}
        assert (len(made), picture.is_file()) == (times, bool(mated))


def test_without_a_contact_nothing_is_certified() -> None:
    said = fidelity.convergence(preset("C"), trials=2, longest=0.3)
    assert (said["step"]["force"], said["touched"], said["holds"]) == (0.0, 0, False)
    line = table({"solver C": said, "left_out": []})
    assert "0 of 2 trials touched" in line
    assert line.endswith("MISSED")
    text = Fidelity().text({"solver C": said, "left_out": [], "folder": "out", "seconds": 1.0})
    assert text.endswith("out: report.json, report.txt (1 s)")


@pytest.mark.parametrize("name", get_args(Session))
def test_every_preset_lies_within_the_ranges_of_a_fit(name: str) -> None:
    for parameter, (low, high, _) in BOUNDS.items():
        assert low <= overrides.value(preset(name).parts, preset(name).sensor, parameter) <= high, parameter
        overrides.check(((parameter, low), (parameter, high)))


def test_misses_are_said() -> None:
    said = {
        "solver A": SOLVER,
        "session A": {
            "mated": 0, "trials": 4, "holds": False, "onsets": None, "ring": None, "recorded_ring": None, "seated": 0.0,
            "snaps": None, "recorded_snaps": None, "gate": {},
        },
        "left_out": [],
    }  # fmt: skip
    lines = table(said).splitlines()
    assert lines[0].endswith("MISSED")
    assert lines[1].endswith("MISSED")
    rng = np.random.default_rng(0)
    reference, test = (rng.normal(size=(6, 4, 100, 6)) for _ in range(2))
    test[..., 2] += 5
    limits = gate.GateLimits(coverage=0.5, w1_over_sd=1, dtw_over_sd=1, auc=0.8)
    row = {**said["session A"], "mated": 4, "gate": gate.as_json(gate.checks(limits, reference, test))}
    lines = table({**said, "session A": json.loads(json.dumps(row))}).splitlines()
    missed = [line for line in lines if "AUC" in line]
    assert "AUC 1.00" in missed[0]
    assert "<= 0.80" in missed[0]
    assert missed[0].endswith("MISSED")
    assert not any("spread" in line for line in lines)  # what holds is not listed


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--trials", "2"], "--trials is 2 and --max-seconds 13.0"),
        (["--trials", "9" * 20], "expected 4 to 100000"),
        (["--data", "nowhere"], "nowhere is not a folder"),
        (["--data", "."], "holds no trial"),
        (["-o", "file"], "file is a file; expected a folder"),
        (["--recorded", "nowhere.zarr"], "nowhere.zarr"),
        (["--recorded", "own.zarr"], "no trial of session hooked-A"),
        (["--session"], "--session has no value; expected one or more"),
    ],
)
def test_mistakes_are_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    write_recordings(tmp_path / "own.zarr", Recordings.example(), {})
    assert main.main(["fidelity", "-o", "out", *words]) == 2
    assert sentence in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_the_fit_lowers_the_loss_and_writes_parameters(
    hiro_store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "c.json"
    words = ["fidelity", "fit", str(hiro_store), "--session", "C", "-o", str(out), "--trials", "1"]
    bare = [*words, "--population", "4"]
    words = [*bare, "--parameters", "parts.friction"]
    assert main.main([*words, "--generations", "1", "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    assert 0.05 <= first["values"]["parts.friction"] <= 0.6
    assert json.loads(out.read_text())["values"] == first["values"]
    assert main.main([*words, "--generations", "2", "--json"]) == 0
    second = json.loads(capsys.readouterr().out)
    assert (second["generations"], second["loss"] <= first["loss"]) == (2, True)
    assert main.main([*words, "--seed", "5"]) == 2
    assert "other data or options (seed 0, not 5)" in capsys.readouterr().err
    with monkeypatch.context() as other:  # losses of other code cannot be compared with these
        other.setattr(plan, "code_hash", lambda: "other")
        assert main.main([*words, "--generations", "3"]) == 2
        assert "about.sim_mjx_sha256" in capsys.readouterr().err
    assert main.main([*words, "-o", str(tmp_path / "s.json"), "--snaps", "--generations", "1"]) == 0
    for wrong, sentence in (
        (["--parameters", "parts.colour"], "no physical parameter"),
        (["--parameters", "parts.position[0]"], "has no default range"),
        (["--bound", "parts.roll=0:1"], "not fitted"),
        (["--bound", "parts.friction"], "has no =; expected NAME=VALUE"),
        (["--bound", "parts.friction=0.1"], "has no :; expected NAME=LOW:HIGH"),
        (["--fixed", "parts.friction=0.1"], "parts.friction is given twice in --parameters and --fixed"),
        (["--parameters", "sensor.step"], "sensor.step has no default range"),
        (["--parameters", "sensor.step", "--bound", "sensor.step=0:1"], "sensor.step is 0; expected more than zero"),
        (["--parameters", "sensor.delay", "--bound", "sensor.delay=0:99"], "sensor.delay is 99; expected 0 to 11"),
        (["--trials", "0"], "--trials is 0; expected 1 to 100000"),
        (["--trials", "-2"], "--trials is -2"),
        (["--fixed", "parts.friction=much"], "not a number"),
    ):
        assert main.main([*(bare if "--parameters" in wrong else words), *wrong]) == 2
        assert sentence in capsys.readouterr().err
