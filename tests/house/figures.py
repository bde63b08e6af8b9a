"""Figures of the house: files, lines, functions, records and names of the program, and what a planar run imports.

``make house`` prints them, so that everybody sees the trend. They are figures, not limits.
"""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TRIAL = ROOT / "sample_trials" / "sit-to-stand" / "trial.yaml"


def list_figures(folders: Sequence[Path]) -> Iterator[tuple[str, str]]:
    """Yield name and value of each figure over the modules in some folders."""
    texts = {file: file.read_text("utf-8") for folder in folders for file in sorted(folder.rglob("*.py"))}
    trees = {file: ast.parse(text) for file, text in texts.items()}
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    used = Counter(node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load))
    used += Counter(node.attr for node in nodes if isinstance(node, ast.Attribute))
    lines = sum(len(text.splitlines()) for text in texts.values())
    functions = [node.name for tree in trees.values() for node in tree.body if isinstance(node, ast.FunctionDef)]
    classes = [node for node in nodes if isinstance(node, ast.ClassDef)]
    records = sum(any("dataclass" in ast.unparse(one) for one in node.decorator_list) for node in classes)
    public = defaultdict(set)
    for file, tree in trees.items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                public[node.name].add(file)
    yield "files", f"{len(texts)}"
    yield "lines", f"{lines}"
    yield "functions", f"{sum(isinstance(node, ast.FunctionDef) for node in nodes)}"
    once = sum(used[name] <= 1 for name in functions) / max(len(functions), 1)
    yield "module functions that are named once outside their definition", f"{once:.2f}"
    yield "dataclasses", f"{records}, {1e3 * records / lines:.1f} in 1000 lines"
    twice = sorted(name for name, files in public.items() if len(files) > 1)
    yield "public names defined twice", f"{len(twice)}: {', '.join(twice)}"


def count_imports() -> tuple[int, int]:
    """Return how many modules, and how many of the program's own, a run of the planar sample trial imports."""
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copytree(TRIAL.parent, Path(folder) / "trial", ignore=shutil.ignore_patterns("runs")) / TRIAL.name
        command = [sys.executable, "-X", "importtime", "-m", "mocap_id_cli", "run", str(copy)]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    names = [line.rpartition("|")[2].strip() for line in said.splitlines() if line.startswith("import time:")]
    return len(names), sum(name.startswith("mocap_id") for name in names)


def main() -> None:
    """Print the figures of the core with its commands, and of all packages."""
    core = [ROOT / "pipeline" / "mocap_id", ROOT / "cli"]
    for title, folders in (("mocap_id and the commands", core), ("all packages", [ROOT / "pipeline", ROOT / "cli"])):
        print(title)
        for name, value in list_figures(folders):
            print(f"  {name}: {value}")
    every, own = count_imports()
    print(f"a planar run imports {every} modules, {own} of them its own")


if __name__ == "__main__":
    main()
