"""Fuzzing with many damaged files, read in a process that must not hang, exhaust memory or crash.

``python tests/hostile/fuzz.py --number 10000 --seed 1 --jobs 1 --state .fuzz`` tries so many cases, goes on where an
earlier call with the same state stopped, and prints what it found with a recipe to repeat it:
``python tests/hostile/fuzz.py --repeat SEED:INDEX``.
"""

from __future__ import annotations

import os

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system", "HDF5_PLUGIN_PATH": "::"}

import argparse
import collections
import contextlib
import json
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
HANG = 20.0
"""Seconds that a case may take, less those for which it waited for a processor that others were using."""

SPARE, FACTOR = 384 << 20, 64
"""Bytes that a case may ask for beyond what the process holds: so many, and so many times its file's size."""

WHOLE_RUN = 2 << 30
"""The same for a whole run, and for making a case."""


@dataclass
class Tally:
    """Counts of the results."""

    number: int = 0
    outcomes: collections.Counter[str] = field(default_factory=collections.Counter)
    findings: list[dict[str, Any]] = field(default_factory=list)
    slowest: dict[str, float] = field(default_factory=dict)
    memory: dict[str, float] = field(default_factory=dict)

    def add(self, told: dict[str, Any]) -> None:
        form = told["form"]
        self.number += 1
        self.outcomes[f"{form} {told['outcome']}"] += 1
        self.slowest[form] = max(self.slowest.get(form, 0.0), told["seconds"])
        self.memory[form] = max(self.memory.get(form, 0.0), told["megabytes"])
        if told["outcome"] == "finding":
            self.findings.append(told)

    def table(self) -> str:
        """Return the tally as a table."""
        lines = ["format      cases     read  refused finding  slowest s  memory MB"]
        for form in sorted(self.slowest):
            counts = [self.outcomes[f"{form} {outcome}"] for outcome in ("read", "refused", "finding")]
            lines.append(
                f"{form:<8} {sum(counts):8d} {counts[0]:8d} {counts[1]:8d} {counts[2]:7d} "
                f"{self.slowest[form]:10.2f} {self.memory[form]:10.0f}"
            )
        return "\n".join(lines)


def campaign(
    seed: int, indexes: Iterator[int], *, shared: bool = True, only: str | None = None, hang: float = HANG
) -> Iterator[dict[str, Any]]:
    """Run cases in a separate process; if one hangs or crashes, report it and continue in a new process."""
    left = list(indexes)
    while left:
        options = [
            "--worker",
            "--seed",
            str(seed),
            *(["--only", only] if only else []),
            *([] if shared else ["--alone"]),
        ]
        command = [sys.executable, str(Path(__file__).resolve()), *options]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, bufsize=1
        ) as process:
            assert process.stdin is not None
            lines = _lines(process)
            try:
                if _next(lines, 120.0) is None:
                    raise RuntimeError("the process did not begin: run it by itself with --repeat to see why")
                while left:
                    process.stdin.write(f"{left[0]}\n")
                    process.stdin.flush()
                    told = _in_time(process, lines, hang + min(hang, 5.0))
                    index = left.pop(0)
                    if told is None:
                        process.kill()
                        code = process.wait()
                        why = f"the process ended with {code}" if code != -9 else f"hangs: more than {hang:g} s"
                        yield _lost(seed, index, why)
                        break
                    yield told
            finally:
                process.kill()


def _lost(seed: int, index: int, why: str) -> dict[str, Any]:
    told = {"index": index, "seed": seed, "form": "lost", "name": "?", "seconds": 0.0, "megabytes": 0.0}
    return {**told, "outcome": "finding", "said": why}


def _lines(process: subprocess.Popen[str]) -> queue.Queue[str | None]:
    lines: queue.Queue[str | None] = queue.Queue()

    def pump() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            lines.put(line)
        lines.put(None)

    threading.Thread(target=pump, daemon=True).start()
    return lines


def _in_time(process: subprocess.Popen[str], lines: queue.Queue[str | None], seconds: float) -> dict[str, Any] | None:
    """Return the result of a case; None if there is none after so many seconds of processor time."""
    end, before = time.monotonic() + seconds, _starved(process.pid)
    while process.poll() is None or not lines.empty():
        left = end + _starved(process.pid) - before - time.monotonic()
        if left <= 0:
            return None
        with contextlib.suppress(queue.Empty):
            line = lines.get(timeout=min(left, 1.0))
            return None if line is None else dict(json.loads(line))
    return _next(lines, 1.0)


def _starved(process: int | str) -> float:
    """Return the seconds for which a process waited for a processor, if the system provides them."""
    try:
        return int(Path(f"/proc/{process}/schedstat").read_text().split()[1]) * 1e-9
    except (OSError, ValueError, IndexError):
        return 0.0


def _next(lines: queue.Queue[str | None], seconds: float) -> dict[str, Any] | None:
    """Return the next JSON line; None if none comes in time."""
    try:
        line = lines.get(timeout=seconds)
    except queue.Empty:
        return None
    return None if line is None else dict(json.loads(line))


def worker(seed: int, only: str | None, shared: bool) -> None:
    """Read indices, run their cases, and print the result of each."""
    import oracles  # late: the supervising process does not need it

    told, sys.stdout = sys.stdout, sys.stderr
    with tempfile.TemporaryDirectory() as folder:
        bench = oracles.Bench(Path(folder), shared)
        warm_up(bench, only)
        print(json.dumps({"ready": True}), file=told, flush=True)
        for line in sys.stdin:
            print(json.dumps(attempt(bench, seed, int(line), only)), file=told, flush=True)


def warm_up(bench: Any, only: str | None) -> None:
    """Load everything that is loaded on first use, so that no case is charged for it."""
    for form in (only,) if only else ("c3d", "trc", "csv", "trial", "stored"):
        for index in range(2):
            bench.judge(bench.case(0, index, form))


def attempt(bench: Any, seed: int, index: int, only: str | None = None) -> dict[str, Any]:
    """Run one case within its limits."""
    with _bounded(WHOLE_RUN):
        case = bench.case(seed, index, only)
    before = _peak(reset=True)
    start = time.perf_counter() - _starved("self")
    with _bounded(WHOLE_RUN if case.form == "run" else SPARE + FACTOR * len(case.data)):
        found = bench.judge(case)
    seconds = time.perf_counter() - _starved("self") - start
    outcome, said = found.outcome, found.said
    if seconds > HANG:
        outcome, said = "finding", f"hangs: {seconds:.0f} s"
    told = {"index": index, "seed": seed, "form": case.form, "name": case.name, "seconds": seconds}
    return {**told, "megabytes": (_peak() - before) / 2**20, "outcome": outcome, "said": said}


@contextlib.contextmanager
def _bounded(spare: int) -> Iterator[None]:
    """Limit the additional memory of the process, if the system supports it."""
    try:
        import resource
    except ImportError:
        yield
        return
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (_status("VmSize") + spare, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))


def _peak(reset: bool = False) -> int:
    """Return the peak memory of the process since the last reset, bytes."""
    if reset:
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")
    return _status("VmHWM")


def _status(key: str) -> int:
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith(key + ":")), 0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--number", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", help="one format alone")
    parser.add_argument("--alone", action="store_true", help="without the shared recordings")
    parser.add_argument("--state", type=Path, default=Path(".fuzz"), help="folder from which a later call goes on")
    parser.add_argument(
        "--repeat", metavar="SEED:INDEX", help="try one case once more, for as long as it takes, and keep its file"
    )
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        worker(options.seed, options.only, not options.alone)
        return 0
    if options.repeat:
        return repeat(*map(int, options.repeat.split(":")), only=options.only, shared=not options.alone)
    return long_run(options)


def repeat(seed: int, index: int, only: str | None, shared: bool) -> int:
    import oracles

    folder = Path(tempfile.mkdtemp(prefix="hostile-"))
    bench = oracles.Bench(folder, shared)
    with _bounded(WHOLE_RUN):
        case = bench.case(seed, index, only)
        found = bench.judge(case)
    kept = folder / f"kept-{Path(case.name).name}"
    kept.write_bytes(case.data)
    print(f"{case.form} {case.name}, {len(case.data)} bytes, kept as {kept}\n{found.outcome}: {found.said}")
    return int(found.outcome == "finding")


def long_run(options: argparse.Namespace) -> int:
    """Run all cases of a seed that earlier calls have not run, in several processes."""
    options.state.mkdir(parents=True, exist_ok=True)
    name = f"{options.seed}{'-' + options.only if options.only else ''}{'-alone' if options.alone else ''}"
    log = options.state / f"seed-{name}.jsonl"
    tally, done = Tally(), set()
    if log.exists():
        for line in log.read_text().splitlines():
            with contextlib.suppress(ValueError):
                told = json.loads(line)
                if told["index"] < options.number:
                    done.add(told["index"])
                    tally.add(told)
    left = [index for index in range(options.number) if index not in done]
    results: queue.Queue[dict[str, Any] | None] = queue.Queue()

    def job(part: list[int]) -> None:
        try:
            for told in campaign(options.seed, iter(part), shared=not options.alone, only=options.only):
                results.put(told)
        finally:
            results.put(None)

    jobs = max(options.jobs, 1)
    for k in range(jobs):
        threading.Thread(target=job, args=(left[k::jobs],), daemon=True).start()
    with log.open("a") as stream:
        while jobs:
            told = results.get()
            if told is None:
                jobs -= 1
                continue
            tally.add(told)
            stream.write(json.dumps(told) + "\n")
            stream.flush()
            if told["outcome"] == "finding":
                print(_recipe(told, options), flush=True)
    print(f"{tally.table()}\n{tally.number} cases of seed {options.seed}, {len(tally.findings)} findings")
    return int(bool(tally.findings) or tally.number < options.number)


def _recipe(told: dict[str, Any], options: argparse.Namespace) -> str:
    more = (f" --only {options.only}" if options.only else "") + (" --alone" if options.alone else "")
    again = f"python tests/hostile/fuzz.py --repeat {told['seed']}:{told['index']}{more}"
    return f"{told['form']} {told['name']}: {told['said']}\n    {again}"


if __name__ == "__main__":
    sys.path.insert(0, str(HERE))
    sys.exit(main())
