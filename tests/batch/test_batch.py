"""A batch goes through whatever happens to one of its trials, wherever they are run, and always to the same results."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from batch_cases import Deadly, trials

from mocap_id.config import load
from mocap_id.errors import ConfigError, NumericalError
from mocap_id.workflows import parallel
from mocap_id.workflows.batch import Batch, find_trials, run_batch
from mocap_id.workflows.parallel import NOT_RUN, Backend, DaskBackend, LocalBackend, TrialRun, run_trials

distributed = pytest.importorskip("distributed", reason="Dask is not installed: mocap-id[cluster]")
NAMES = ("a", "b", "c")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    quiet = {"dashboard_address": ":0", "silence_logs": 50, "processes": True}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **quiet) as running:
        yield running


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Batch]:
    """Three trials and one whose recording is missing, one after the other in this process."""
    folder = tmp_path_factory.mktemp("here")
    trials(folder, NAMES)
    (folder / "gone.yaml").write_text("trial: gone\nrecording: nowhere.trc\n")
    return folder, run_batch([str(folder)], folder / "batch.parquet")


def contents(folder: Path) -> dict[str, str]:
    """The key of every trial's report: it changes with whatever the trial's results tell."""
    return {done.trial: str(done.key) for done in run_trials(find_trials([str(folder)])[0], LocalBackend())}


def test_a_single_trial_runs_here_and_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, logger="mocap_id")  # a command that ran before may have set another level
    (tmp_path / "gone.yaml").write_text("trial: gone\nrecording: nowhere.trc\n")
    done = run_batch([str(tmp_path)], tmp_path / "batch.parquet", backend=DaskBackend("tcp://127.0.0.1:1"))
    assert [one["exit_code"] for one in done.rows] == [3]
    assert "there is only one trial: it runs on this machine, without Dask" in caplog.text


def test_one_failure_stops_no_other(here: tuple[Path, Batch]) -> None:
    folder, done = here
    table = pd.read_parquet(folder / "batch.parquet")
    assert dict(zip(table["trial"], table["verdict"], strict=True)) == dict.fromkeys(NAMES, "caution") | {
        "gone": "failed"
    }
    assert list(table["exit_code"]) == [one["exit_code"] for one in done.rows] == [0, 0, 0, 3]
    assert list(table["segments"].dropna()) == [2, 2, 2]
    assert "nowhere.trc" in done.messages[3]
    assert "nowhere.trc" not in table["message"][3]
    assert done.failed == [3]
    assert table["folder"][0] == str(Path("runs") / "a")


def test_again_all_is_reused(here: tuple[Path, Batch]) -> None:
    folder, _ = here
    again = run_batch([str(folder)], folder / "again.parquet")
    assert not any(one["computed"] for one in again.rows)


@pytest.mark.parametrize("where", ["processes", pytest.param("cluster", marks=pytest.mark.slow)])
def test_the_same_wherever_it_is_run(here: tuple[Path, Batch], cluster: Any, tmp_path: Path, where: str) -> None:
    trials(tmp_path, NAMES)
    backend: Backend = LocalBackend(2) if where == "processes" else DaskBackend(cluster.scheduler_address)
    told: list[TrialRun] = []
    done = run_batch([str(tmp_path)], tmp_path / "batch.parquet", backend=backend, tell=told.append)
    assert [one["exit_code"] for one in done.rows] == [0, 0, 0]
    assert sorted(one.trial for one in told) == list(NAMES)
    before = contents(here[0])
    assert contents(tmp_path) == {name: before[name] for name in NAMES}


def test_a_worker_killed_in_the_middle(cluster: Any, tmp_path: Path) -> None:
    trials(tmp_path, NAMES)
    killed: list[int] = []

    def kill(done: TrialRun) -> None:
        if not killed:
            worker = next(iter(cluster.workers.values()))
            killed.append(worker.pid)
            os.kill(worker.process.pid, signal.SIGKILL)

    done = run_batch(
        [str(tmp_path)], tmp_path / "batch.parquet", backend=DaskBackend(cluster.scheduler_address), tell=kill
    )
    assert killed
    assert [one["exit_code"] for one in done.rows] == [0, 0, 0]


@pytest.mark.parametrize("where", ["processes", pytest.param("cluster", marks=pytest.mark.slow)])
def test_a_trial_that_takes_its_process_along(cluster: Any, tmp_path: Path, where: str) -> None:
    well = [load(file) for file in trials(tmp_path, NAMES[:1])]
    backend: Backend = LocalBackend(2) if where == "processes" else DaskBackend(cluster.scheduler_address)
    asked: Any = [Deadly("deadly"), *well]
    done = run_trials(asked, backend)
    assert [(one.trial, one.exit_code) for one in done] == [("deadly", 5), ("a", 0)]
    assert "killed" in (done[0].message or "")


@pytest.mark.parametrize("jobs", [1, 2])
def test_stopping_at_the_first_failure(tmp_path: Path, jobs: int) -> None:
    files = trials(tmp_path, NAMES)
    files[0].write_text(files[0].read_text().replace("link", "nowhere"))
    done = run_trials([load(file) for file in files], LocalBackend(jobs), on_error="stop")
    codes = [one.exit_code for one in done]
    assert codes[0] == 3
    assert codes[-1] == NOT_RUN
    assert codes.count(NOT_RUN) >= (2 if jobs == 1 else 1)


def test_an_interrupted_batch_goes_on(tmp_path: Path) -> None:
    trials(tmp_path, NAMES)

    def interrupt(done: TrialRun) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_batch([str(tmp_path)], tmp_path / "batch.parquet", tell=interrupt)
    assert not (tmp_path / "batch.parquet").exists()
    done = run_batch([str(tmp_path)], tmp_path / "batch.parquet")
    assert [one["computed"] for one in done.rows] == [False, True, True]


@pytest.mark.parametrize(
    ("backend", "told"),
    [
        (DaskBackend(cluster={"kind": "mainframe"}), "expected one of local, ssh, slurm"),
        (DaskBackend(cluster={"kind": "local", "wrkers": 2}), "wrkers"),
        (DaskBackend("nonsense"), "no Dask scheduler answers"),
    ],
)
def test_an_engine_that_cannot_be_had(tmp_path: Path, backend: Backend, told: str) -> None:
    trials(tmp_path, NAMES[:2])
    with pytest.raises(ConfigError, match=told):
        run_batch([str(tmp_path)], tmp_path / "batch.parquet", backend=backend)
    assert not (tmp_path / "runs").exists()


def test_an_interruption_stays_one_on_dask(cluster: Any) -> None:
    """Whatever ends a batch on Dask is reported as what it is."""
    with pytest.raises(KeyboardInterrupt), DaskBackend(cluster.scheduler_address).workers(1):
        raise KeyboardInterrupt


def test_a_lost_scheduler_says_how_to_go_on(cluster: Any) -> None:
    lost = distributed.comm.CommClosedError("closed")
    with (
        pytest.raises(NumericalError, match="broke: finished trials are kept"),
        DaskBackend(cluster.scheduler_address).workers(1),
    ):
        raise lost


def test_a_scheduler_without_workers_says_so_once(monkeypatch: pytest.MonkeyPatch, caplog: Any) -> None:
    caplog.set_level(logging.WARNING, logger="mocap_id")  # a command that ran before may have set another level
    monkeypatch.setattr(parallel, "_COUNTING_INTERVAL", 0.0)
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0", silence_logs=50) as alone,
        DaskBackend(alone.scheduler_address).workers(1) as (_, width),
    ):
        for _ in range(3):
            width()
        told = [one.getMessage() for one in caplog.records if one.name.startswith("mocap_id.")]
        assert len(told) == 1
        assert f"`dask worker {alone.scheduler_address}" in told[0]


def test_a_queueing_system_that_is_not_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask would try again for ever, with a trace for every worker."""
    queue = SimpleNamespace(SLURMCluster=SimpleNamespace(job_cls=SimpleNamespace(submit_command="sbatch")))
    monkeypatch.setitem(sys.modules, "dask_jobqueue", queue)
    monkeypatch.setenv("PATH", str(tmp_path))
    trials(tmp_path, NAMES[:2])
    with pytest.raises(ConfigError, match="with the program `sbatch`, which is not on this machine's path"):
        run_batch([str(tmp_path)], tmp_path / "batch.parquet", backend=DaskBackend(cluster={"kind": "slurm"}))


def test_a_queue_that_takes_no_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: Any) -> None:
    """If the name of a queue is wrong, the error gives the reason and the command ends at once."""
    spec = pytest.importorskip("distributed.deploy.spec")

    class Job(spec.ProcessInterface):  # type: ignore[misc, name-defined]
        submit_command = sys.executable

        async def start(self) -> None:
            raise RuntimeError("stderr:\ninvalid partition: short")

        async def close(self) -> None:
            """As dask_jobqueue's own: a job that was not submitted is left alone."""

    class Slurm(spec.SpecCluster):  # type: ignore[misc, name-defined]
        job_cls = Job

        def __init__(self) -> None:
            scheduler = {"cls": distributed.Scheduler, "options": {"dashboard_address": ":0"}}
            super().__init__(scheduler=scheduler, worker={"cls": Job, "options": {}}, silence_logs=50)

        def scale(self, n: int) -> None:
            super().scale(n)
            time.sleep(0.1)  # Dask's own thread submits the job meanwhile

    monkeypatch.setitem(sys.modules, "dask_jobqueue", SimpleNamespace(SLURMCluster=Slurm))
    trials(tmp_path, NAMES[:2])
    with pytest.raises(ConfigError, match="rejects the job of a worker: stderr: invalid partition: short"):
        run_batch([str(tmp_path)], tmp_path / "batch.parquet", backend=DaskBackend(cluster={"kind": "slurm"}))
    assert not (tmp_path / "runs").exists()
    assert not [one.name for one in caplog.records if one.name in ("asyncio", "tornado.application")]


@pytest.mark.parametrize(("own", "kept"), [(logging.WARNING, logging.WARNING), (logging.INFO, logging.INFO)])
def test_the_progress_of_dask_is_told_only_with_ours(cluster: Any, own: int, kept: int) -> None:
    theirs = logging.getLogger("distributed")
    ours = logging.getLogger("mocap_id")
    before = ours.level, theirs.level
    ours.setLevel(own)
    theirs.setLevel(logging.INFO)
    try:
        with DaskBackend(cluster.scheduler_address).workers(1):
            assert theirs.level == kept
        assert theirs.level == logging.INFO
    finally:
        ours.setLevel(before[0])
        theirs.setLevel(before[1])


def test_the_command(cli: Callable[..., Any], here: tuple[Path, Batch], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, _ = here
    monkeypatch.chdir(folder)
    said = cli("batch", ".")
    assert said.code == 1
    assert "4 trials: 3 caution, 1 failed" in said.out
    assert "nowhere.trc: no such file" in said.out
    assert json.loads(cli("batch", "?.yaml", "--json").out)[0]["verdict"] == "caution"
    assert cli("batch", ".", "--jobs", "2", "--scheduler", "tcp://x:1").code == 2
    assert cli("batch", ".", "--out", "table.csv").code == 2
