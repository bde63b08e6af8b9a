"""What a process takes, measured by one so small that its own memory does not count: ``scale_measure.py COMMAND…``.

Prints JSON: wall and processor seconds of the command and of all that it started and waited for, and the largest
resident memory of any one of these processes, MB. (A process inherits the peak of the one that starts it, so a large
program cannot ask this of its own children.) Several commands, parted by ``--and``, are started together and told of
one by one; each one's wall seconds then run from the common start.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

AND = "--and"
KILOBYTE = 1024  # bytes: the unit of the largest resident memory, on Linux


def parted(words: list[str]) -> list[list[str]]:
    """The commands."""
    commands: list[list[str]] = [[]]
    for word in words:
        if word == AND:
            commands.append([])
        else:
            commands[-1].append(word)
    return commands


def main() -> None:
    """Run the commands and tell."""
    start = time.perf_counter()
    running = {}
    for number, command in enumerate(parted(sys.argv[1:])):
        with open(f"scale-{os.getpid()}-{number}.err", "wb") as errors:  # noqa: PTH123  pathlib is large
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)
        running[process.pid] = (number, process, errors.name)
    told = {}
    while running:
        pid, status, usage = os.wait4(-1, 0)
        number, process, errors = running.pop(pid)
        process.returncode = os.waitstatus_to_exitcode(status)
        with open(errors, encoding="utf-8", errors="replace") as stream:  # noqa: PTH123
            said = stream.read()[-2000:]
        os.unlink(errors)  # noqa: PTH108
        told[number] = {
            "wall": time.perf_counter() - start,
            "cpu": usage.ru_utime + usage.ru_stime,
            "peak": usage.ru_maxrss * KILOBYTE / 1e6,
            "code": process.returncode,
            "said": "" if process.returncode == 0 else said,
        }
    print(json.dumps([told[number] for number in sorted(told)]))


if __name__ == "__main__":
    main()
