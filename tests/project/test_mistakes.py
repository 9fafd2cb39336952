"""Values of another type are refused in one sentence by every name of the face, also where nothing checks annotations.

The test runs them in a process of its own: here, beartype would refuse them before the package sees them.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest

SETUP = """
import json, pathlib, tempfile, jax, numpy as np, pandas as pd, rcbht_jax as rj
from rcbht_jax.encoding import encoder as core
from rcbht_jax.encoding.fit import FitConfig
from rcbht_jax.introspection.fault_monitor import FaultMonitorConfig, SubtaskSnapshots
from rcbht_jax.introspection.segmenter import WrenchSegmenter
from rcbht_jax.introspection.snap_rule import SnapConfig
from rcbht_jax.introspection.training import HeadSpec, train_model
from rcbht_jax.learning.evaluation import EvaluationProtocol
from rcbht_jax.learning.svm import Grid
wrench, x, y = np.zeros((4, 30, 6)), np.eye(4), ["a", "b"] * 2  # N and Nm
config, limits, series = rj.EncoderConfig(), rj.preset(), np.random.default_rng(0).normal(size=(4, 30, 2))
recordings = rj.Recordings.example()
tracks, task, spec = rj.encode(wrench), rj.TaskSpec("outcome"), rj.FeatureSpec(("histogram",))
folder = pathlib.Path(tempfile.mkdtemp())
counts = np.arange(3)
introspector = rj.Introspector(train_model(recordings, (HeadSpec(task, families=("histogram",)),)), rate=2)
detector = rj.SnapDetector(200.0, ["Fz"], 3.0)
snapshots = SubtaskSnapshots(counts, 0 * counts, 0 * counts, 1 + counts, np.zeros((3, 1)), 0.1)
"""
NUMBERS = {
    "rj.encode(wrench, rate='200')": "rate is '200'; expected a number",
    "rj.encode(wrench, rate=None)": "rate is 'None'",
    "rj.encode(wrench, rate=[200])": "expected a number",
    "rj.encode(wrench, '200', config=config)": "expected a number",
    "rj.encode(wrench, window='5')": "window of EncoderConfig is '5'; expected a whole number",
    "rj.encode(wrench, window=5.0)": "expected a whole number",
    "rj.encode(wrench, thresholds={})": "is dict; expected an array of numbers",
    "rj.encode(wrench, thresholds=[['a'] * 4] * 6)": "expected numbers",
    "rj.encode(wrench, thresholds=[[1], [2, 3]])": "rows of different lengths",
    "rj.encode(wrench, thresholds=1j * np.ones((6, 4)))": "expected numbers",
    "rj.encode(wrench, config={'window': 5})": "expected EncoderConfig or FitConfig",
    "rj.encode(wrench, rule=np.array(['fit']))": "no rule",
    "rj.encode(wrench, lengths=5)": r"Lengths have shape \(\)",
    "rj.encode([wrench[0], wrench])": "recordings of a list have the shapes",
    "rj.encode(wrench[:0])": "no recording",
    "jax.jit(lambda w: rj.encode(w).llb.label)(wrench)": "inside jit",
    "rj.Encoder(None, limits)": "expected EncoderConfig or FitConfig",
    "rj.Encoder(config, 'hiro')": "expected numbers",
    "rj.EncoderConfig(dt='0.005')": "dt of EncoderConfig is '0.005'; expected a finite number",
    "rj.EncoderConfig(latency_cap='x')": "expected a finite number or None",
    "rj.EncoderConfig(noise_below=None)": "noise_below",
    "rj.EncoderConfig(gate='no')": "expected True or False",
    "rj.EncoderConfig(pipe='three')": "expected 'two-slot' or 'one-slot'",
    "FitConfig(evidence=[1.0])": "evidence",
    "rj.FeatureSpec(families='histogram')": "families of FeatureSpec is 'histogram'; expected a tuple",
    "rj.FeatureSpec(slots=64)": "expected a tuple of 3",
    "rj.FeatureSpec(ngram='2')": "ngram",
    "rj.FeatureSpec(weighing=None)": "weighing",
    "rj.TaskSpec('states', sessions='AB')": "sessions of TaskSpec is 'AB'",
    "EvaluationProtocol(folds='5')": "folds",
    "Grid(costs=1.0)": "costs",
    "SnapConfig(within='x')": "within",
    "FaultMonitorConfig(holds=())": "holds",
    "FaultMonitorConfig(rate=0)": "positive rate",
    "rj.WrenchFeatures(rate='200').fit(wrench)": "rate is '200'",
    "rj.WrenchFeatures(thresholds={}).fit(wrench)": "is dict; expected an array of numbers",
    "rj.WrenchFeatures().fit([])": "no recording",
    "rj.SvmClassifier(cost='7').fit(x, y)": "cost",
    "rj.SvmClassifier(floor=-1.0).fit(x, y)": "zero or more",
    "rj.SvmClassifier(floor='x').fit(x, y)": "floor",
    "rj.SvmClassifier(balanced='x').fit(x, y)": "True or False",
    "rj.SvmClassifier(feature_weight='x').fit(x, y)": "feature_weight",
    "rj.SvmClassifier().fit(x, y, sample_weight=['a'] * 4)": "sample_weight",
    "rj.SvmClassifier(probability=True, cv='5').fit(x, y)": "expected a number, or a scikit-learn splitter",
    "rj.NominalMonitor(rate='20').fit(series)": "rate is '20'",
    "rj.NominalMonitor(folds=0.5).fit(series)": "folds is 0.5",
    "rj.NominalMonitor(baseline=-1).fit(series)": "baseline is -1",
    "rj.NominalMonitor(slack=float('nan')).fit(series)": "slack is nan",
    "rj.NominalMonitor(lags=0.2).fit(series)": "lags 0.2",
    "rj.NominalMonitor(lags=(-1.0,)).fit(series)": "lags",
    "rj.NominalMonitor(levels=(0.5,)).fit(series)": "levels",
    "rj.NominalMonitor(neighbours=1.5).fit(series)": "neighbours",
    "rj.NominalMonitor().fit(series).threshold('x')": "share of false alarms",
    "rj.NominalMonitor().fit(series, groups=np.ones((4, 2)))": r"Groups have the shape \(4, 2\)",
    "rj.NominalMonitor().fit(None)": "expected an array",
    "rj.SnapDetector('200', ['Fz'], 3.0)": "rate is '200'",
    "rj.SnapDetector(200.0, ['Fz'], 3.0, load=5)": "load must be numbers",
    "rj.SnapDetector(200.0, ['Fz'], 3.0, tolerance='x')": "expected numbers",
    "rj.SnapDetector(200.0, ['Fz'], 3.0, config='x')": "expected SnapConfig",
    "rj.Introspector(None)": "expected IntrospectionModel",
    "rj.Introspector(introspector.model, rate='x')": "rate of beliefs is 'x'",
    "rj.Introspector(introspector.model, k='x')": "certainty level is 'x'",
    "rj.Introspector(introspector.model, hold='x')": "hold time is 'x'",
    "introspector.push(pd.DataFrame(np.ones((50, 6)), columns=recordings.axes[::-1]))": "samples have the axes Mz, My",
    "detector.push(pd.DataFrame({'Fx': [1.0]}))": "samples have the axes Fx; the stream has Fz",
    "introspector.push(np.ones((50, 6)), time='now')": "time is 'now'; expected a number",
    "detector.push(np.ones((50, 1)), time='now')": "time is 'now'; expected a number",
    "rj.FaultMonitor.fit(snapshots, ['none'] * 2)": "2 trials, and snapshots of a trial of number 2",
    "SubtaskSnapshots(counts, counts, counts, counts, np.zeros((2, 1)), 0.1)": "different lengths",
    "WrenchSegmenter(window='5').fit(recordings, [np.arange(300) // 150] * 8)": "window",
    "WrenchSegmenter().fit(wrench, [])": "expected Recordings",
}
NAMES = {
    "rj.SnapDetector(200.0, 'Fz', 3.0)": "axes are 'Fz'; expected names",
    "rj.SnapDetector(200.0, ['Fz', 'Fz'], 3.0)": "2 axes are called Fz",
    "rj.SnapDetector(200.0, [], 3.0)": "expected names",
    "rj.preset('hiro', 'Fz')": "axes are 'Fz'",
    "rj.preset('hiro', [])": "expected names",
    "rj.preset('hiro', [1, 2])": "expected names",
    "rj.preset([])": "no thresholds",
    "rj.Recordings.from_arrays(wrench, axes='abcdef')": "expected names",
    "rj.encode(wrench).words(True)": "axis is True",
    "rj.encode(wrench).words(2.0)": "axis is 2.0",
    "rj.encode(wrench).words('Fz', 'llb', None)": "recording is None",
    "rj.encode(wrench).take([5])": "There are 4 recordings",
    "rj.encode(wrench).take([[0, 1]])": "There are 4 recordings",
    "rj.encode(wrench).take([True])": "mask of all",
    "recordings.take('x')": "expected numbers",
    "recordings.take([8])": "There are 8 recordings",
}
OBJECTS = {
    "rj.labelled_intervals(recordings, 'outcome')": "expected TaskSpec",
    "rj.labelled_intervals(wrench, task)": "expected Recordings",
    "rj.evaluate(recordings, tracks, task, 'histogram', EvaluationProtocol())": "expected FeatureSpec or Mapping",
    "rj.evaluate(recordings, {}, task, spec, EvaluationProtocol())": "no labels or no features",
    "rj.evaluate(recordings, tracks, task, spec, None)": "expected EvaluationProtocol",
    "rj.extract_features({}, rj.labelled_intervals(recordings, task), spec)": "There are no labels",
    "rj.extract_features(tracks, rj.labelled_intervals(recordings, task), 'x')": "expected FeatureSpec",
    "rj.write_thresholds(folder / 'a', limits, None)": "expected Mapping",
    "rj.write_thresholds(folder / 'a', limits, {'a': object()})": "cannot be stored as JSON",
    "rj.write_thresholds(folder / 'a', limits, {'a': float('nan')})": "cannot be stored as JSON",
    "rj.write_thresholds(folder / 'a', limits, {}, list('aabcde'))": "2 axes are called a",
    "rj.write_thresholds(5, limits, {})": "expected Path or str",
    "rj.write_recordings(None, recordings, {})": "expected Path or str",
    "rj.write_recordings(folder / 'a', recordings, None)": "expected Mapping",
    "rj.write_recordings(folder / 'a', wrench, {})": "expected Recordings",
    "rj.write_recordings(folder / 'a', recordings, {}, part=0)": "A part has 0 recordings",
    "rj.read_recordings(None)": "expected Path or str",
    "core.encode(config, limits, wrench[0], np.ones(4, int))": r"expected \[trial, time, axis\]",
    "core.encode(config, limits.limits[:3], wrench, np.ones(4, int))": r"expected \[6, 4\] or \[4, 6, 4\]",
    "core.encode(config, limits.limits[:1], wrench, np.ones(4, int))": r"expected \[6, 4\] or \[4, 6, 4\]",
    "core.step(config, limits.limits[:3], core.init((6,)), wrench[0, :5])": r"expected \[6, 4\]",
}
CASES = NUMBERS | NAMES | OBJECTS


@pytest.fixture(scope="module")
def errors() -> dict[str, list[str]]:
    """Kind and text of the error of each mistake."""
    run = """
found = {}
for code in CASES:
    try:
        found[code] = ["none", repr(eval(code))]
    except Exception as error:
        found[code] = [type(error).__name__, str(error)]
left = sorted(map(str, folder.iterdir())), introspector.received, detector._encoder.received
print(json.dumps(found | {"left": left}))
"""
    code = f"CASES = {list(CASES)!r}\n{SETUP}\n{run}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_values_of_another_type_are_one_sentence(errors: dict[str, list[str]]) -> None:
    wrong = {
        code: errors[code]
        for code, sentence in CASES.items()
        if errors[code][0] != "InputError" or not re.search(sentence, errors[code][1]) or "\n" in errors[code][1]
    }
    assert not wrong
    assert errors["left"] == [[], 0, 0], "a refused argument left a file behind, or samples were consumed"
