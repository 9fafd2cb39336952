"""Workers of one machine, of a Ray cluster and of a job array make the bytes that one process makes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from rcbht_jax.cli.main import main, parse
from rcbht_jax.errors import InputError
from sim_mjx.cli import simulate_workers
from sim_mjx.cli.simulate import Simulate
from sim_mjx.synthesis import launch, shards
from tests.support.fake_simulation import tree

ROOT = Path(__file__).resolve().parents[3]
SHORT = ["--preset", "C", "--trials", "12", "--seed", "3", "--shard", "2", "--max-seconds", "0.1"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes that one process makes with the native engine."""
    target = tmp_path_factory.mktemp("whole") / "trials.zarr"
    assert main(["simulate", str(target), *SHORT]) == 0
    return tree(target)


@pytest.fixture(autouse=True)
def _children_find_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")


def result(capsys: pytest.CaptureFixture[str], *words: str) -> dict:
    capsys.readouterr()
    assert main(["simulate", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_three_processes_make_the_bytes_of_one(
    whole: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "t.zarr"
    made = result(capsys, str(target), *SHORT, "--processes", "3")
    assert (made["stored"], made["resumed"], made["notices"]) == (12, 0, [])
    assert tree(target) == whole
    assert os.listdir(tmp_path) == ["t.zarr"]
    assert result(capsys, str(target), "--status")["complete"]
    assert result(capsys, str(target), *SHORT, "--worker") == {"store": str(target), "simulated": 0, "complete": True}


def test_what_ended_workers_early_is_told_and_this_process_does_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], whole: dict[str, bytes]
) -> None:
    """One worker fails with a sentence, one is killed."""
    scripts = iter(["import sys; sys.exit('rcbht: The disk is full.')", "import os; os.kill(os.getpid(), 9)"])
    monkeypatch.setattr(launch, "_command", lambda words: [sys.executable, "-c", next(scripts)])
    made = result(capsys, str(tmp_path / "t.zarr"), *SHORT, "--processes", "2")
    assert made["notices"] == [
        "Worker 1 of 2 ended early: The disk is full.",
        "Worker 2 of 2 ended early: it was ended by SIGKILL.",
    ]
    assert tree(tmp_path / "t.zarr") == whole


def test_interrupted_it_takes_its_workers_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []
    real = subprocess.Popen

    def remembered(*words: object, **more: object) -> subprocess.Popen[bytes]:
        started.append(real(*words, **more))  # type: ignore[call-overload]
        return started[-1]

    monkeypatch.setattr(launch, "_command", lambda words: [sys.executable, "-c", "import time; time.sleep(60)"])
    monkeypatch.setattr(subprocess, "Popen", remembered)

    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        launch.local([], [{}, {}], stop, print)
    assert len(started) == 2
    assert all(child.poll() is not None for child in started)


def test_a_worker_has_the_words_of_the_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fit.json").write_text("{}")
    words = ["t.zarr", *SHORT, "--overwrite", "--processes", "4", "--physical", "fit.json", "--nominal-share", "0.2"]
    command = parse("simulate", [*words, "--engine", "mjx", "--window", "5"])
    assert isinstance(command, Simulate)
    made = simulate_workers.words_of(command)
    assert made[:3] == ["simulate", str(tmp_path / "t.zarr"), "--worker"]
    again = parse("simulate", made[1:])
    assert isinstance(again, Simulate)
    same = (
        "preset",
        "trials",
        "seed",
        "shard",
        "max_seconds",
        "engine",
        "window",
        "nominal_share",
        "assembly",
        "robot",
    )
    assert [getattr(again, name) for name in same] == [getattr(command, name) for name in same]
    assert (again.worker, again.overwrite, again.processes) == (True, False, None)
    assert again.physical == tmp_path / "fit.json"


@pytest.mark.parametrize(("cores", "trials", "engine", "count"), [
    (32, 5000, "native", 8), (32, 600, "native", 2), (32, 255, "native", None),
    (32, 5000, "warp", None), (7, 5000, "native", None), (32, 5000, "native --devices 2", 8),
])  # fmt: skip
def test_many_cores_have_several_processes(
    cores: int, trials: int, engine: str, count: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each with enough to do; a GPU and few cores have one. The native engine has no use for --devices."""
    begun: list[int] = []
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    monkeypatch.setattr(launch, "local", lambda _, environments, *__: begun.append(len(environments)))
    command = parse("simulate", [str(tmp_path / "t.zarr"), "--trials", str(trials), "--engine", *engine.split()])
    assert isinstance(command, Simulate)
    start = simulate_workers.helpers(command, lambda _: None)
    if start is not None:
        start(lambda: None)
    assert begun == ([] if count is None else [count])


def test_each_device_has_a_worker_that_sees_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch, "visible_devices", lambda: ["0", "3", "GPU-7"])
    environments = simulate_workers._environments
    assert environments("all") == [{launch.DEVICES: name} for name in ("0", "3", "GPU-7")]
    assert environments("2") == [{launch.DEVICES: "0"}, {launch.DEVICES: "3"}]
    with pytest.raises(InputError, match="--devices is 4; expected at most 3"):
        environments("4")
    for wrong in ("0", "some", "-1"):
        with pytest.raises(InputError, match="expected"):
            environments(wrong)


def test_devices_are_those_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    assert launch.visible_devices() == []
    monkeypatch.setattr(launch, "_COUNT", "print(2)")
    monkeypatch.delenv(launch.DEVICES, raising=False)
    assert launch.visible_devices() == ["0", "1"]
    monkeypatch.setenv(launch.DEVICES, "5, GPU-7")
    assert launch.visible_devices() == ["5", "GPU-7"]
    monkeypatch.setattr(launch, "_COUNT", "raise SystemExit('no driver')")
    with pytest.raises(InputError, match="no driver"):
        launch.visible_devices()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--processes", "0"], "--processes is 0"),
        (["--processes", str(10**30)], "expected 1 to 4096"),
        (["--devices", "all", "--processes", "2"], "leave --processes and --launch out"),
        (["--devices", "none"], 'expected "all"'),
        (["--launch-options", "timeout_min=5"], "belong to --launch slurm"),
        (["--launch", "slurm", "--launch-options", "fast"], "expected KEY=VALUE"),
        (["--worker", "--processes", "2"], "--worker is one process"),
        (["--worker", "--overwrite"], "--worker is one process"),
        (["--status"], "nor a part of it"),
    ],
)
def test_mistakes_are_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", str(tmp_path / "t.zarr"), *words]) == 2
    assert sentence in capsys.readouterr().err.splitlines()[-1]
    assert os.listdir(tmp_path) == []


def test_an_array_of_jobs_makes_the_same_bytes(
    whole: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the executor that submitit uses where there is no Slurm."""
    pytest.importorskip("submitit", reason='submitit is not installed: pip install "rcbht-jax[slurm]"')
    target = tmp_path / "t.zarr"
    made = result(
        capsys, str(target), *SHORT, "--launch", "slurm", "--processes", "4", "--launch-options", "timeout_min=5"
    )
    assert made["notices"] == ["There is no Slurm here; the jobs run on this machine."]
    assert tree(target) == whole
    assert os.listdir(tmp_path) == ["t.zarr"]
    for wrong in ("a=b", "timeout_min=soon"):
        assert main(["simulate", str(tmp_path / "u.zarr"), *SHORT, "--launch", "slurm", "--launch-options", wrong]) == 2
        assert "options of the Slurm jobs are wrong (--launch-options)" in capsys.readouterr().err
        assert os.listdir(tmp_path) == ["t.zarr"]


def test_a_slurm_that_takes_no_jobs_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of an executor that fails as submitit's does: it leaves the pickled work behind."""

    class Executor:
        cluster = "slurm"

        def __init__(self, folder: Path) -> None:
            self._folder = folder
            folder.mkdir(exist_ok=True)

        def update_parameters(self, **_: object) -> None:
            pass

        def map_array(self, *_: object) -> None:
            (self._folder / "work.pkl").touch()
            raise RuntimeError("sbatch: error: invalid partition specified: nope")

    monkeypatch.setitem(sys.modules, "submitit", SimpleNamespace(AutoExecutor=Executor))
    target = tmp_path / "t.zarr"
    words = ["simulate", str(target), *SHORT, "--launch", "slurm", "--launch-options", "slurm_partition=nope"]
    assert main(words) == 2
    expected = "rcbht: Slurm takes no jobs: sbatch: error: invalid partition specified: nope."
    assert capsys.readouterr().err.splitlines() == [expected]
    assert os.listdir(tmp_path) == ["t.zarr.work"]  # where the same command goes on
    logs = tmp_path / "t.zarr.jobs"
    logs.mkdir()
    (logs / "earlier.log").touch()
    assert main(words) == 2
    assert (logs / "earlier.log").exists()


@pytest.mark.parametrize("launch", ["ray", "slurm"])
def test_a_missing_package_is_said_before_anything_is_begun(
    launch: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setitem(sys.modules, "submitit", None)
    assert main(["simulate", str(tmp_path / "t.zarr"), *SHORT, "--launch", launch]) == 2
    assert f'is not installed: pip install "rcbht-jax[{launch}]"' in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_options_of_jobs_are_numbers_where_they_are_decimal() -> None:
    words = ("timeout_min=60", "mem_gb=4.5", "slurm_time=1:30", "slurm_partition=gpu.2", "slurm_qos=nan")
    expected = {"timeout_min": 60, "mem_gb": 4.5, "slurm_time": "1:30", "slurm_partition": "gpu.2", "slurm_qos": "nan"}
    assert simulate_workers._options(words) == expected


@pytest.fixture
def two_nodes() -> Iterator[subprocess.Popen[str]]:
    """A Ray cluster of two nodes on this machine, where commands find it."""
    pytest.importorskip("ray", reason='Ray is not installed: pip install "rcbht-jax[ray]"')
    script = [sys.executable, str(ROOT / "tests/support/ray_nodes.py")]
    with subprocess.Popen(script, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as cluster:
        assert cluster.stdin is not None
        yield cluster
        cluster.stdin.close()
        cluster.wait()


def test_two_ray_nodes_make_the_same_bytes(
    two_nodes: subprocess.Popen[str], whole: dict[str, bytes], tmp_path: Path
) -> None:
    assert two_nodes.stdout is not None
    env = {**os.environ, "RAY_ADDRESS": two_nodes.stdout.readline().strip()}
    target = tmp_path / "t.zarr"
    words = ["simulate", str(target), *SHORT, "--launch", "ray", "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "rcbht_jax", *words], env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    made = json.loads(done.stdout.splitlines()[-1])
    assert (made["stored"], made["resumed"], made["notices"]) == (12, 0, [])
    assert tree(target) == whole
    assert not shards.folder_of(target).exists()
