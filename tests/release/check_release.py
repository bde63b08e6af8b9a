"""The packages in bare environments, with every supported Python of this machine.

``python tests/release/check_release.py --out dist`` builds the source distribution, and the wheel from it. For each
Python, it installs the wheel into a new environment outside the source tree, and calls it as a user does. It prints
what was done and how long it took, and its exit code is 1 if something failed. The packages come from the usual index;
their download is not timed.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LEAST = (3, 11)

SCRIPT = """\
import mocap_id


def thigh(folder: str) -> float:
    run: mocap_id.Run = mocap_id.open(folder)
    length: float = run.summary["lengths_m"]["thigh"]["value"]
    return length if run.verdict.level == "ok" and len(run.states) > 0 else 0.0


print(f"thigh {1000 * thigh('mocap-id-demo/runs/mocap-id-demo'):.0f} mm")
"""
WRONG = "number: int = mocap_id.open('x').name\n"
"""A mistake that a type checker sees only if the types of the package are known."""


@dataclass(frozen=True)
class Took:
    """Time of a call, s."""

    wall: float
    processor: float

    def __add__(self, other: Took) -> Took:
        return Took(self.wall + other.wall, self.processor + other.processor)

    def __str__(self) -> str:
        return f"{self.wall:5.1f} s, {self.processor:5.1f} s of processor time"


class Bare:
    """A new environment with nothing but the wheel."""

    def __init__(self, python: Path, folder: Path) -> None:
        self.folder = folder
        self.bin = folder / "environment" / ("Scripts" if os.name == "nt" else "bin")
        self.work = folder / "work"
        self.work.mkdir()
        subprocess.run([python, "-m", "venv", folder / "environment"], check=True)

    def call(self, *command: str | Path, fails: bool = False) -> tuple[str, Took]:
        """Run a program of the environment in a folder without the source tree; return its output."""
        kept = {key: value for key, value in os.environ.items() if not re.match("PYTHON|MOCAP_ID_|NUMBA_", key)}
        about = {"BROWSER": f"{self.bin / 'python'} {self.folder / 'browser.py'} %s", "COLUMNS": "200"}
        before, start = _processor_time(), time.perf_counter()
        done = subprocess.run(
            [self.bin / command[0], *command[1:]],
            cwd=self.work,
            env=kept | about,
            capture_output=True,
            text=True,
            check=False,
        )
        took = Took(time.perf_counter() - start, _processor_time() - before)
        if (done.returncode != 0) != fails:
            raise SystemExit(f"{' '.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
        return done.stdout, took


def _processor_time() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def build(out: Path) -> tuple[Path, Path]:
    """Build the source distribution, and from it the wheel, which must be that of the source tree."""
    for old in [*out.glob("mocap_id-*.whl"), *out.glob("mocap_id-*.tar.gz")]:
        old.unlink()
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-d", out.resolve()], cwd=ROOT, check=True)
    (source,), (direct,) = out.glob("mocap_id-*.tar.gz"), out.glob("mocap_id-*.whl")
    before = direct.read_bytes()
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(out)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, str(source)], check=True)
    if direct.read_bytes() != before:
        raise SystemExit(f"{direct.name}: built from {source.name} it is another than from the source tree")
    return source, direct


def pythons() -> Iterator[Path]:
    """Yield one Python of each supported version that this machine has: on the path, or installed by pyenv."""
    names = ["python3", "python", *(f"python3.{minor}" for minor in range(LEAST[1], 30))]
    found = [Path(path) for path in map(shutil.which, names) if path]
    found += sorted(Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob("versions/*/bin/python"))
    asked = "import json, sys, venv, ensurepip; print(json.dumps([sys.version_info[:2], sys._base_executable]))"
    seen = set()
    for python in found:
        said = subprocess.run([python, "-c", asked], capture_output=True, text=True, check=False)
        if said.returncode == 0:
            version, base = json.loads(said.stdout)
            if tuple(version) >= LEAST and tuple(version) not in seen:
                seen.add(tuple(version))
                yield Path(base)


def check(python: Path, wheel: Path, folder: Path) -> None:
    """Install the wheel and use it as a user does."""
    bare = Bare(python, folder)
    asked, _ = bare.call("python", "-c", "import sys; print(sys.version.split()[0])")
    print(f"\nPython {asked.strip()}")
    opened = folder / "opened.txt"
    (folder / "browser.py").write_text(f"import sys; open({str(opened)!r}, 'w').write(sys.argv[1])\n")
    bare.call("pip", "download", "--quiet", "--dest", folder / "packages", wheel)
    local = ["--no-index", "--find-links", folder / "packages"]
    _, installed = bare.call("pip", "install", "--quiet", "--disable-pip-version-check", *local, wheel)
    said, first = bare.call("mocap-id", "demo")
    if "verdict: ok" not in said or not opened.read_text().endswith("mocap-id-demo/report.html"):
        raise SystemExit(f"the demo did not open a report with the verdict ok:\n{said}")
    print(f"  pip install    {installed}\n  first demo     {first}\n  both           {installed + first}")
    print(f"  second demo    {bare.call('mocap-id', 'demo', 'again', '--no-open')[1]}")
    print(f"  --version      {bare.call('mocap-id', '--version')[0].strip()}")
    print(f"  doctor         {bare.call('mocap-id', 'doctor')[0].splitlines()[-1]}")
    (bare.work / "script.py").write_text(SCRIPT)
    (bare.work / "wrong.py").write_text(SCRIPT + WRONG)
    print(f"  user's script  {bare.call('python', 'script.py')[0].strip()}")
    bare.call("pip", "install", "--quiet", "--disable-pip-version-check", "mypy")
    print(f"  mypy --strict  {bare.call('mypy', '--strict', 'script.py')[0].strip()}")
    bare.call("mypy", "--strict", "wrong.py", fails=True)


def main(arguments: Sequence[str]) -> None:
    """Build, and check with every Python."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the packages")
    parser.add_argument("--python", type=Path, action="append", help="only this Python (repeatable)")
    options = parser.parse_args(arguments)
    options.out.mkdir(exist_ok=True)
    source, wheel = build(options.out)
    for package in (source, wheel):
        print(f"{package}: {package.stat().st_size / 1e6:.1f} MB")
    for python in options.python or pythons():
        with tempfile.TemporaryDirectory(prefix="mocap-id-release-") as place:
            check(python, wheel.resolve(), Path(place))


if __name__ == "__main__":
    main(sys.argv[1:])
