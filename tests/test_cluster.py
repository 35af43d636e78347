"""Sweeps on other executors than this process: threads, a Dask cluster, and what breaks there."""

import json
import os
import pickle
import resource
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from unittest.mock import Mock

import pytest
from small_studies import SMALL
from waiting import wait_for

from kneexo.analysis import sinestream
from kneexo.analysis.frequency.frequency_response import SinestreamSettings
from kneexo.command_line.main import main
from kneexo.command_line.output import to_json
from kneexo.errors import OutputError, WorkerError
from kneexo.parameters import UNCERTAIN_KNEE, UNCERTAINTY, Scenario, UncertaintySet
from kneexo.parameters.uncertainty import draw
from kneexo.studies.assessment import assess
from kneexo.studies.bandwidth.figures import plot_bode
from kneexo.studies.reproduce import reproduce_study
from kneexo.studies.robustness import RobustnessSettings, assess_plant, robustness_study
from kneexo.studies.wearer import WearerSettings, wearer_study
from kneexo.sweeps import parallel, parallel_map
from kneexo.sweeps.checkpoint import Checkpoint
from kneexo.sweeps.parallel import dask_cluster

REDUCED = UncertaintySet(
    values={path: one for path, one in UNCERTAINTY.values.items() if path != "plant.full_order"}
)

# ---------------------------------------------------------------------- every sweep, anywhere


class Elsewhere(ThreadPoolExecutor):
    """Two threads that get and give copies, as processes do; counts what is submitted."""

    def __init__(self):
        super().__init__(2)
        self.submitted = 0

    def submit(self, function, *arguments):
        self.submitted += 1
        return super().submit(_copied, pickle.dumps((function, arguments)))


def _copied(text):
    function, arguments = pickle.loads(text)
    return pickle.loads(pickle.dumps(function(*arguments)))


FEW_SINES = SinestreamSettings(
    frequencies_hz=(8.0, 9.0, 10.0), trials=2, measured_cycles=1, transient_cycles=0
)
SWEEPS = {name: (partial(study, of), settings) for name, (study, of, settings) in SMALL.items()}
SWEEPS |= {
    "reproduce": (reproduce_study, FEW_SINES),
    "sinestream": (partial(sinestream, Scenario()), FEW_SINES),
    "study wearer": (
        wearer_study,
        WearerSettings(
            cadences_hz=(1.0,),
            rise_times_s=(0.5,),
            cycles=2,
            help_cadences_hz=(1.0,),
            help_rise_times_s=(0.5,),
            shares=(0.2,),
            postures_deg=(45.0,),
        ),
    ),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n == "sinestream" else pytest.mark.slow) for n in SWEEPS],
)
def test_every_sweep_runs_on_the_callers_executor_alone(name, monkeypatch):
    sweep, settings = SWEEPS[name]

    def numbers(result):
        return result.response.tolist() if name == "sinestream" else to_json(result.results())

    here = numbers(sweep(settings=settings))
    monkeypatch.delattr(parallel, "ProcessPoolExecutor")  # no pool of its own
    with Elsewhere() as executor:
        assert numbers(sweep(settings=settings, executor=executor)) == here
        assert executor.submitted > 1


# ------------------------------------------------------------------------------ a Dask cluster


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler with two worker processes, and the workers."""
    pytest.importorskip("distributed", reason="needs the extra cluster")
    file = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    quiet = {"cwd": tmp_path, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    worker = [*dask, "worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    worker += ["--scheduler-file", str(file), "--host", "127.0.0.1"]
    processes = [subprocess.Popen([*scheduler, "--scheduler-file", str(file)], **quiet)]
    try:
        processes += [subprocess.Popen(worker, **quiet) for _ in range(2)]
        yield _address(file), processes[1:]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _address(file):
    wait_for(lambda: file.exists() and file.read_text().rstrip().endswith("}"))
    return json.loads(file.read_text())["address"]


@pytest.mark.slow(gate=0)
def test_a_dask_worker_killed_in_the_middle_changes_nothing(cluster, tmp_path):
    address, workers = cluster
    checkpoint = Checkpoint(tmp_path / "checkpoint.jsonl")
    settings = RobustnessSettings(
        samples=150, corners_max=60, bandwidth=False, sensitivity_duration_s=0.0
    )
    sweep = partial(robustness_study, UNCERTAIN_KNEE, REDUCED, settings)
    killed_at = []

    def kill():
        wait_for(lambda: len(checkpoint) >= 60)
        killed_at.append(len(checkpoint))
        workers[0].send_signal(signal.SIGKILL)

    from distributed import Client

    with Client(address, timeout="1 hour", set_as_default=False) as client:
        client.wait_for_workers(2)
    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    with dask_cluster(address) as executor:
        there = sweep(executor=executor, checkpoint=checkpoint)
    killer.join()
    assert workers[0].wait() == -signal.SIGKILL
    assert workers[1].poll() is None
    assert killed_at[0] < len(checkpoint)
    assert to_json(there.results()) == to_json(sweep().results())


SMALL_MAP = ["study", "bandwidth", "--set", "amplitudes_deg=[1.0, 2.0]"]
SMALL_MAP += ["--set", "frequencies_hz=[4.0, 8.0, 16.0]"]


@pytest.mark.slow(gate=0)
def test_the_command_line_runs_on_a_dask_cluster(cluster, tmp_path):
    where = {"dask": ["--dask", cluster[0]], "here": ["--workers", "1"]}
    for name, option in where.items():
        command = [sys.executable, "-m", "kneexo", *SMALL_MAP, *option]
        done = subprocess.run(
            [*command, "--out", str(tmp_path / name)], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
    texts = [(tmp_path / name / "bandwidth.json").read_bytes() for name in where]
    assert texts[0] == texts[1]


@pytest.mark.slow
def test_a_dask_scheduler_that_dies_is_one_line_and_resumes(cluster, tmp_path):
    address, workers = cluster
    path = tmp_path / "checkpoint.jsonl"
    judge = partial(assess_plant, UNCERTAIN_KNEE, REDUCED, partial(assess, margins=False))
    points = draw(REDUCED, 400, seed=1)
    checkpoint = Checkpoint(path)

    def kill():
        wait_for(lambda: len(checkpoint) >= 20)
        for worker in workers:
            worker.kill()
        os.kill(scheduler, signal.SIGKILL)

    from distributed import Client

    with Client(address, timeout="1 hour", set_as_default=False) as client:
        client.wait_for_workers(2)
        scheduler = client.run_on_scheduler(os.getpid)
    threading.Thread(target=kill, daemon=True).start()
    with pytest.raises(WorkerError, match="was lost") as caught, dask_cluster(address) as executor:
        parallel_map(judge, points, executor=executor, checkpoint=checkpoint)
    assert "\n" not in str(caught.value)
    stored = Checkpoint(path)
    assert 20 <= len(stored) < len(points)
    resumed = parallel_map(judge, points, checkpoint=stored)
    assert json.dumps(resumed) == json.dumps(parallel_map(judge, points))


@pytest.mark.parametrize(
    ("answer", "has"), [("0.0.0", "kneexo 0.0.0"), (ImportError("none"), r"no kneexo \(none\)")]
)
def test_a_worker_of_another_version_is_named(monkeypatch, answer, has):
    client = Mock(status="running", **{"run.return_value": {"tcp://w:1": answer}})
    monkeypatch.setattr("distributed.Client", Mock(return_value=client))
    with (
        pytest.raises(WorkerError, match=f"worker tcp://w:1 has {has}: must have kneexo"),
        dask_cluster("tcp://s:1"),
    ):
        pass


@pytest.mark.slow
def test_a_cluster_without_workers_is_one_line(cluster, monkeypatch):
    for worker in cluster[1]:
        worker.kill()
        worker.wait()
    monkeypatch.setattr(parallel, "CONNECT_S", 3.0)  # to see that the workers are gone as well
    with pytest.raises(WorkerError, match="has no workers"), dask_cluster(cluster[0]):
        pass


@pytest.mark.parametrize(
    ("address", "line"),
    [
        ("tcp://127.0.0.1:1", "there is no Dask scheduler at tcp://127.0.0.1:1 (tried for 0.5 s)"),
        ("localhost", "Dask scheduler 'localhost': must be tcp://HOST:PORT"),
        ("tcp://localhost", "Dask scheduler 'tcp://localhost': must be tcp://HOST:PORT"),
    ],
)
def test_no_scheduler_is_one_line_and_leaves_nothing(capsys, tmp_path, monkeypatch, address, line):
    pytest.importorskip("distributed", reason="needs the extra cluster")
    monkeypatch.setattr(parallel, "CONNECT_S", 0.5)
    out = tmp_path / "out"
    assert main([*SMALL_MAP, "--dask", address, "--out", str(out)]) == 2
    assert capsys.readouterr().err == f"kneexo: {line}\n"
    assert not out.exists()


def test_what_an_interrupted_sweep_left_outlives_a_scheduler_that_is_not_there(
    capsys, tmp_path, monkeypatch
):
    pytest.importorskip("distributed", reason="needs the extra cluster")
    monkeypatch.setattr(parallel, "CONNECT_S", 0.1)
    path = tmp_path / "bandwidth.checkpoint.jsonl"
    checkpoint = Checkpoint(path)
    checkpoint.keep("a", 1)
    checkpoint.close()
    before = path.read_bytes()
    assert main([*SMALL_MAP, "--dask", "tcp://127.0.0.1:1", "--out", str(tmp_path)]) == 2
    assert path.read_bytes() == before


def test_without_distributed_the_line_says_what_to_install(capsys, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    out = tmp_path / "out"
    assert main([*SMALL_MAP, "--dask", "tcp://127.0.0.1:1", "--out", str(out)]) == 2
    message = "a Dask cluster needs the package distributed: pip install distributed"
    assert capsys.readouterr().err == f"kneexo: {message}\n"
    assert not out.exists()


def test_workers_and_dask_exclude_one_another(capsys, tmp_path):
    with pytest.raises(SystemExit) as caught:
        main(["reproduce", "--out", str(tmp_path), "--workers", "2", "--dask", "tcp://a:1"])
    assert caught.value.code == 2
    assert "not allowed with" in capsys.readouterr().err


# ------------------------------------------------------------------------------- a full disk


@contextmanager
def files_of_at_most(size):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))  # Python ignores SIGXFSZ
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:checkpoint")
def test_a_full_disk_is_one_line_and_what_is_finished_stays(capsys, tmp_path, monkeypatch):
    # One figure is more than the room that is left, and is drawn faster than all.
    monkeypatch.setattr(
        "kneexo.studies.bandwidth.figures.figures", lambda study: {"bode": plot_bode(study)}
    )
    command = [*SMALL_MAP, "--workers", "1", "--json", "--out"]
    assert main([*command, str(tmp_path / "whole")]) == 0
    whole = capsys.readouterr().out
    out = tmp_path / "out"
    path = out / "bandwidth.checkpoint.jsonl"
    # Room for a few pieces; then for all, but not for the figures.
    for size, message in ((800, "checkpoint "), (20_000, "--out ")):
        with files_of_at_most(size):
            assert main([*command, str(out)]) == 2
        last = capsys.readouterr().err.splitlines()[-1]
        assert last.startswith(f"kneexo: {message}")
        assert "File too large" in last
        assert [file.name for file in out.iterdir()] == [path.name]
        assert path.stat().st_size <= size
    fill = Checkpoint(tmp_path / "sweep.jsonl")
    with files_of_at_most(2400), pytest.raises(OutputError, match="pieces that it holds are kept"):
        parallel_map(str, [n + 0.5 for n in range(100)], checkpoint=fill)
    stored = Checkpoint(tmp_path / "sweep.jsonl")
    assert 10 < len(stored) == len(fill) < 100
    assert main([*command, str(out)]) == 0
    assert capsys.readouterr().out == whole
