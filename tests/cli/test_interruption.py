"""Ctrl-C, SIGTERM or a full disk during a run leave only complete files, and the next run continues."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from mocap_id.store import Folder
from swinging_link import pendulum

# The second stage of the real pipeline waits until it is interrupted.
SLOW = """
import sys, time
from mocap_id.stages import STAGES
from mocap_id_cli.__main__ import main

def wait(context):
    print("waiting", flush=True)
    for _ in range(600):  # one long sleep would not end for a signal that comes just before it
        time.sleep(0.1)

object.__setattr__(STAGES[1], "function", wait)
sys.argv = ["mocap-id", "run", sys.argv[1]]
main()
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interruption_is_orderly(cli, trial, number: signal.Signals, code: int) -> None:
    path = trial.trc(pendulum())
    before = trial.inputs()
    with subprocess.Popen(
        [sys.executable, "-c", SLOW, str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "waiting\n"
        process.send_signal(number)
        _, err = process.communicate(timeout=20)
    assert process.returncode == code
    assert "Traceback" not in err
    assert "interrupted" in err
    assert trial.made() == ["planar.parquet", "wrench.parquet"]
    Folder(trial.out).read("planar.parquet")
    assert trial.inputs() == before

    said = cli("run", path)
    assert said.code == 0, said.err
    steps = [line.split()[:2] for line in said.err.splitlines()]
    assert steps[0] == ["planarise", "reused"]
    assert steps[1][1] != "reused"


# A file size limit simulates a full disk: the system refuses to write in the middle of a file.
FULL = """
import resource, sys
from mocap_id_cli.__main__ import main
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
sys.argv = ["mocap-id", "run", sys.argv[1]]
main()
"""


@pytest.mark.skipif(os.name == "nt", reason="limits of POSIX")
def test_a_disk_that_takes_no_more(cli, trial) -> None:
    path = trial.trc(pendulum())
    before = trial.inputs()
    result = subprocess.run(
        [sys.executable, "-B", "-c", FULL, str(path)], capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 6, result.stderr
    assert "cannot be written" in result.stderr
    assert "Traceback" not in result.stderr
    assert not trial.out.exists()
    assert trial.inputs() == before
    assert cli("run", path).code == 0
