"""Prove that a change of the code changes no result: run a corpus with two versions, and compare all numbers and texts.

``make proof BASE=COMMIT`` runs the corpus with the tree of a commit and with the present tree, on the same machine and
with one thread of linear algebra, and prints every difference. ``python tests/proof/proof.py --help`` explains the
options. A snapshot of a commit is kept in ``.proof/`` and used again.

A snapshot contains, for every case, exit code and printed text of every command, and for every file that was written:
the SHA-256 of every column, dataset and fact of an artefact, every entry of a JSON document, every other file as bytes.
Times of day, durations, versions, checksums and names of temporary folders are left out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from corpus import Case, list_cases

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / ".proof"
VOLATILE = {
    "product",
    "seconds",
    "key",
    "inputs",
    "time_s",
    "stage_version",
    "sha256",
    "digest",
    "created",
    "published",
}
"""Entries that name a version, a duration or a checksum of something else."""


def main() -> int:
    """Compare the present tree with a commit, or print the cases; exit code 1 if anything differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", default="HEAD", help="commit to compare with (default: HEAD, the last commit)")
    parser.add_argument("--part", choices=("small", "whole"), default="whole", help="cases to run")
    parser.add_argument("--only", default="", help="only cases whose name contains one of these texts: TEXT,TEXT")
    parser.add_argument("--jobs", type=int, default=2, help="cases at a time")
    parser.add_argument("--list", action="store_true", help="only list the cases")
    options = parser.parse_args()
    names = read_commands(ROOT)
    texts = options.only.split(",")
    cases = [
        case
        for case in list_cases(names)
        if any(text in case.name for text in texts) and (case.small or options.part == "whole")
    ]
    if options.list:
        print("\n".join(case.name for case in cases))
        return 0
    commit = git("rev-parse", "--verify", f"{options.base}^{{commit}}")
    before = snapshot_commit(commit, cases, options.jobs)
    after = snapshot(ROOT, cases, options.jobs)
    differences = list(compare(before, after))
    print("\n".join(differences))
    print(f"{len(cases)} cases, {len(differences)} differences from {commit[:12]}")
    return 1 if differences else 0


def git(*words: str) -> str:
    """Return what a git command prints."""
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def read_commands(tree: Path) -> tuple[str, ...]:
    """Return the names of the program's commands."""
    code = "from mocap_id_cli.commands import COMMANDS; print(*(each.name for each in COMMANDS))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=make_environment(tree), capture_output=True, text=True, check=True
    )
    return tuple(done.stdout.split())


def make_environment(tree: Path) -> dict[str, str]:
    """Return the environment of a command that runs the code of a tree."""
    path = os.pathsep.join([str(tree / "pipeline"), str(tree / "cli")])
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return os.environ | threads | {"PYTHONPATH": path, "COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"}


def snapshot_commit(commit: str, cases: list[Case], jobs: int) -> dict[str, Any]:
    """Return the snapshot of a commit; cases that an earlier call computed are read from ``.proof/``."""
    program = hash_text("".join(file.read_text("utf-8") for file in sorted(Path(__file__).parent.glob("*.py"))))
    kept = KEPT / f"{commit[:12]}-{program[:12]}.json"  # another version of this program compares other things
    known: dict[str, Any] = json.loads(kept.read_text("utf-8")) if kept.is_file() else {}
    missing = [case for case in cases if case.name not in known]
    if missing:
        tree = KEPT / commit[:12]
        if not tree.exists():
            git("worktree", "prune")  # an interrupted call may have left an entry without its folder
            git("worktree", "add", "--detach", str(tree), commit)
        known |= snapshot(tree, missing, jobs)
        kept.write_text(json.dumps(known, indent=1, sort_keys=True), "utf-8")
        git("worktree", "remove", "--force", str(tree))
    return {case.name: known[case.name] for case in cases}


def snapshot(tree: Path, cases: list[Case], jobs: int) -> dict[str, Any]:
    """Return the results of all cases with the code of a tree."""

    def run(case: Case) -> dict[str, Any]:
        return run_case(case, tree)

    with ThreadPoolExecutor(jobs) as pool:
        return {case.name: result for case, result in zip(cases, pool.map(run, cases), strict=True)}


def run_case(case: Case, tree: Path) -> dict[str, Any]:
    """Return exit codes, printed texts and the content of all files of a case."""
    recordings = os.environ.get("MOCAP_ID_RECORDINGS", str(ROOT.parent / "shared" / "recordings"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "work"
        shutil.copytree(ROOT / "sample_trials", folder / "samples", ignore=shutil.ignore_patterns("runs"))
        shutil.copytree(ROOT / "configs", folder / "configs")
        known = {"samples": "samples", "configs": "configs", "recordings": recordings}
        given = set(folder.rglob("*"))
        result: dict[str, Any] = {}
        for number, command in enumerate(case.commands):
            words = command.format(**known).split()
            done = subprocess.run(
                [sys.executable, "-m", "mocap_id_cli", *words],
                cwd=folder,
                env=make_environment(tree),
                capture_output=True,
                text=True,
                stdin=subprocess.DEVNULL,
                check=False,
            )
            result[f"command {number}"] = [done.returncode, tidy(done.stdout, name), tidy(done.stderr, name)]
        for file in sorted(set(folder.rglob("*")) - given):
            if file.is_file() and file.name not in ("run.log", "failure.log") and ".mocap-id" not in file.parts:
                result[file.relative_to(folder).as_posix()] = dict(read_file(file, name))
        return result


def tidy(text: str, folder: str) -> str:
    """Return a printed text without the temporary folder and without durations."""
    text = text.replace(folder, "FOLDER")
    return re.sub(r" *\d+(\.\d+)? ?(ms|s|min)\b", " TIME", text)


def read_file(file: Path, folder: str) -> Iterator[tuple[str, Any]]:
    """Yield names and content of the parts of a file."""
    if file.suffix == ".parquet":
        import pyarrow.parquet as pq

        table = pq.read_table(file)
        for column, field in zip(table.columns, table.schema, strict=True):
            yield field.name, hash_text(f"{field.type} {field.metadata} {column.to_pylist()!r}")
        yield from read_metadata({k.decode(): v.decode() for k, v in (table.schema.metadata or {}).items()})
    elif file.suffix == ".h5":
        import h5py

        with h5py.File(file) as stored:
            found: list[tuple[str, Any]] = []
            stored.visititems(lambda name, item: found.append((name, item)))
            for name, item in found:
                if isinstance(item, h5py.Dataset):
                    yield (
                        name,
                        hash_text(f"{item.dtype} {item.shape} {item[()].tolist()!r} {sorted(item.attrs.items())}"),
                    )
            yield from read_metadata({k: v if isinstance(v, str) else str(v) for k, v in stored.attrs.items()})
    elif file.suffix == ".json":
        document = drop_volatile(json.loads(tidy(file.read_text("utf-8"), folder)))
        yield "document", document
        yield "order of keys", hash_text(json.dumps(document))
    elif file.suffix in (".html", ".csv", ".svg", ".yaml", ".md", ".mot", ".trc", ".osim", ".xml", ".tex"):
        text = tidy(file.read_text("utf-8"), folder)
        text = re.sub(r"Run time of each stage.*?</table>", "", text, flags=re.DOTALL)
        yield "text", hash_text(re.sub(r"mocap-id \d[\w.]*|\b[0-9a-f]{40,64}\b|\d{4}-\d\d-\d\d[T ][\d:.+Z]*", "", text))
    elif file.suffix not in (".pdf", ".zip"):  # these contain the time of day
        yield "bytes", hashlib.sha256(file.read_bytes()).hexdigest()


def read_metadata(metadata: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    """Yield the entries of an artefact's metadata, facts and reasons as values."""
    for key, text in metadata.items():
        name = key.removeprefix("mocap-id.")
        if name in VOLATILE or not key.startswith("mocap-id."):
            continue
        yield name, drop_volatile(json.loads(text)) if text[:1] in "[{" else text


def drop_volatile(value: Any) -> Any:
    """Return a JSON value without versions, durations and checksums."""
    if isinstance(value, dict):
        return {key: drop_volatile(item) for key, item in value.items() if key not in VOLATILE}
    return [drop_volatile(item) for item in value] if isinstance(value, list) else value


def hash_text(text: str) -> str:
    """Return the SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def compare(before: Any, after: Any, at: str = "") -> Iterator[str]:
    """Yield a line for every difference between two snapshots."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted({*before, *after}, key=str):
            if key not in before or key not in after:
                yield f"{at}{key}: only {'after' if key in after else 'before'}"
            else:
                yield from compare(before[key], after[key], f"{at}{key} | ")
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for k, (a, b) in enumerate(zip(before, after, strict=True)):
            yield from compare(a, b, f"{at}{k} | ")
    elif before != after:
        yield f"{at.removesuffix(' | ')}: {str(before)[:200]!r} -> {str(after)[:200]!r}"


if __name__ == "__main__":
    sys.exit(main())
