"""Time and memory of commands, measured by a process that needs little memory: ``scale_measure.py COMMAND…``.

Prints JSON: wall and processor seconds of the command and of its children, and the largest resident memory of any of
these processes, MB. A process inherits the peak of its parent, so a large program cannot measure its own children.
Several commands, separated by ``--and``, start at the same time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

AND = "--and"
KILOBYTE = 1024  # bytes: the unit of the largest resident memory, on Linux


def split(words: list[str]) -> list[list[str]]:
    """Return the commands between the words ``--and``."""
    commands: list[list[str]] = [[]]
    for word in words:
        if word == AND:
            commands.append([])
        else:
            commands[-1].append(word)
    return commands


def main() -> None:
    start = time.perf_counter()
    running = {}
    for number, command in enumerate(split(sys.argv[1:])):
        with open(f"scale-{os.getpid()}-{number}.err", "wb") as errors:  # noqa: PTH123  pathlib is large
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)
        running[process.pid] = (number, process, errors.name)
    found = {}
    while running:
        pid, status, usage = os.wait4(-1, 0)
        number, process, errors = running.pop(pid)
        process.returncode = os.waitstatus_to_exitcode(status)
        with open(errors, encoding="utf-8", errors="replace") as stream:  # noqa: PTH123
            said = stream.read()[-2000:]
        os.unlink(errors)  # noqa: PTH108
        found[number] = {
            "wall": time.perf_counter() - start,
            "cpu": usage.ru_utime + usage.ru_stime,
            "peak": usage.ru_maxrss * KILOBYTE / 1e6,
            "code": process.returncode,
            "said": "" if process.returncode == 0 else said,
        }
    print(json.dumps([found[number] for number in sorted(found)]))


if __name__ == "__main__":
    main()
