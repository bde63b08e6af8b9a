"""Generated pages, written by ``python -m mocap_id_cli.pages ROOT``; a test compares them with the files.

These are docs/commands.md, docs/settings.md, the columns in docs/formats.md, and the settings in configs/*.yaml.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from typer.testing import CliRunner

from mocap_id.store import Column, TableSchema, TreeSchema
from mocap_id.store.provenance import SCHEMAS
from mocap_id.workflows.batch import BATCH
from mocap_id.workflows.study.arms import CURL_TABLES, REACH_TABLES
from mocap_id.workflows.study.sit_to_stand import TABLES
from mocap_id_cli.commands import COMMANDS, build, load_command
from mocap_id_cli.stages import format_settings_page, format_settings_yaml

SETTINGS_MARK = "# ---- every setting, with its default ----\n"
COLUMNS_MARK = "## Columns\n"
_STUDIES = {"": TABLES, " of reaches": REACH_TABLES, " of curls": CURL_TABLES}
_OF_PROTOCOLS = {
    "seat_off_72": "`protocol: sit-to-stand`",
    "elbow_torque": "`protocol: curl`",
    "kind": "`protocol: reach` or `curl`",
    "target": "`protocol: reach`",
    "amplitude": "`protocol: curl`",
}


def make_pages(root: Path) -> dict[Path, str]:
    """Return the text of every generated page of a source tree by path; text before a mark in a file is kept."""
    formats = root / "docs" / "formats.md"
    texts = {
        root / "docs" / "commands.md": format_commands_page(),
        root / "docs" / "settings.md": format_settings_page(),
        formats: _read_head(formats, COLUMNS_MARK) + columns(),
    }
    for file in sorted((root / "configs").glob("*.yaml")):
        head = _read_head(file, SETTINGS_MARK)
        texts[file] = head + format_settings_yaml(
            space="3d" if re.search(r"^space: 3d", head, re.MULTILINE) else "plane"
        )
    return texts


def format_commands_page() -> str:
    """Return the help of every command as Markdown; the commands of a group follow the group."""
    names = [""]
    for entry in COMMANDS:
        names += [entry.name, *(f"{entry.name} {inner}" for inner in getattr(load_command(entry), "commands", ()))]
    parts = ["# Commands\n"]
    for command in names:
        title = f"mocap-id {command}".strip()
        parts.append(f"## `{title}`\n\n```text\n{_read_help(command)}\n```\n")
    return "\n".join(parts)


def columns() -> str:
    """Return the schemas of all artefacts and of the tables of studies and batches, as Markdown."""
    lines = [line for schema in SCHEMAS.values() for line in _describe_schema(schema, schema.file)]
    for kind, own in _STUDIES.items():
        lines.append(f"\n## Tables of a study{kind}")
        lines += [line for name, schema in own.items() for line in _describe_schema(schema, f"{name}{kind}")]
    return "\n".join([*lines, "\n## The table of a batch", *_describe_schema(BATCH, BATCH.file)]) + "\n"


def _describe_schema(schema: TableSchema | TreeSchema, title: str) -> Iterator[str]:
    yield f"\n### `{title}`, version {schema.version}\n"
    yield from _make_table(schema.columns if isinstance(schema, TableSchema) else schema.nodes)
    repeated = schema.repeated if isinstance(schema, TableSchema) else ()
    kinds = {"Fx_p{k}": "plate", "x_{k}": "body"}.get(repeated[0].name, "joint") if repeated else ""
    groups = [(f"and for every {kinds} k:", repeated)] if repeated else []
    groups += [(_describe_presence(group), group) for group in schema.optional]
    for about, group in groups:
        yield f"\n{about}\n"
        yield from _make_table(group)


def _make_table(columns: Iterable[Column]) -> Iterator[str]:
    yield "| name | type | unit | meaning |"
    yield "|---|---|---|---|"
    for column in columns:
        name = column.name.replace("{k}", "k").replace("{name}", "NAME")
        yield f"| `{name}` | {column.dtype} | {column.unit or '–'} | {column.meaning} |"


def _describe_presence(group: tuple[Column, ...]) -> str:
    """Return the condition under which a group of columns is present."""
    if any("{name}" in column.name for column in group):
        return "and, in space, for every segment or angle NAME:"
    if group[0].meaning.startswith("in space") or "/" in group[0].name or group[0].name == "isb_condition":
        return "and, in space:"
    if group[0].name in _OF_PROTOCOLS:
        return f"and, with {_OF_PROTOCOLS[group[0].name]}:"
    if "{k}" in group[0].name:
        return "and, for every force sensor k of `external:`:"
    return "and, if the forces of a chair or of sensors were measured:"


def _read_head(file: Path, mark: str) -> str:
    return file.read_text("utf-8").partition(mark)[0] + mark


def _read_help(command: str) -> str:
    """Return the help of a command as it is printed in a terminal with 100 columns."""
    width = {"COLUMNS": "100", "TERMINAL_WIDTH": "100", "NO_COLOR": "1"}
    result = CliRunner().invoke(build(), [*command.split(), "--help"], prog_name="mocap-id", env=width)
    return "\n".join(line.rstrip() for line in result.stdout.strip().splitlines())


def main() -> None:
    """Write all generated pages of a source tree."""
    for path, text in make_pages(Path(sys.argv[1])).items():
        path.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
