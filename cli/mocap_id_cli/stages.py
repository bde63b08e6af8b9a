"""Commands that describe the files of a trial: ``stages`` and ``schema``; and the pages of all settings."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, get_args, get_origin

import typer
from pydantic.fields import FieldInfo
from pydantic_core import to_jsonable_python
from typer import Option

from mocap_id.config import build_schema, load
from mocap_id.config.parsing import build_json_schema
from mocap_id.config.study import build_study_schema
from mocap_id.runner.dependencies import make_rules
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Settings
from mocap_id.stages.device import DeviceFile
from mocap_id.stages.trial_keys import Calibration, Files, TrialKeys
from mocap_id_assist.files import PrescriptionFile

Space: TypeAlias = Literal["plane", "3d"]
_PLURALS = {
    "number": "numbers",
    "whole number": "whole numbers",
    "text": "texts",
    "list of texts": "lists of texts",
    "mapping": "mappings",
}


def stages(
    make: Annotated[
        list[Path] | None,
        Option("--make", metavar="TRIAL.yaml", help="Print Makefile rules for this trial (repeatable)."),
    ] = None,
    settings: Annotated[
        bool, Option("--settings", help="Print all settings as YAML comments, to copy into a trial's file.")
    ] = False,
) -> None:
    """List the stages in order, with their inputs and outputs."""
    if make:
        typer.echo("MOCAP_ID ?= mocap-id")
        typer.echo(make_rules([load(file) for file in make], "$(MOCAP_ID)"), nl=False)
    elif settings:
        typer.echo(format_settings_yaml(), nl=False)
    else:
        for stage in STAGES:
            typer.echo(f"{stage.name}: {stage.help}")
            typer.echo(f"    reads   {', '.join(stage.inputs) or 'the recording'}")
            typer.echo(f"    writes  {', '.join(stage.outputs)}")


def schema(
    study: Annotated[bool, Option("--study", help="Print the schema of a study's file.")] = False,
    prescription: Annotated[bool, Option("--prescription", help="Print the schema of a prescription's file.")] = False,
    device: Annotated[bool, Option("--device", help="Print the schema of a pneumatic device's file.")] = False,
) -> None:
    """Print the JSON Schema of a trial's YAML file, for editors."""
    if device:
        document = build_json_schema(DeviceFile)
    elif prescription:
        document = build_json_schema(PrescriptionFile)
    else:
        document = build_study_schema() if study else build_schema()
    typer.echo(json.dumps(document, indent=2, ensure_ascii=False))


def format_settings_yaml(stages: Sequence[Stage] = STAGES, space: Space = "plane") -> str:
    """Return the settings of each stage with their defaults, in the plane or in space, as YAML in comments.

    A line that starts with ``#`` and a blank is a remark. If the ``#`` is removed from all other lines, they are valid
    YAML.
    """
    return "\n".join(line for stage in stages if stage.settings.model_fields for line in _format_section(stage, space))


def list_settings(settings: type[Settings], space: Space) -> tuple[str, ...]:
    """Return the names of a stage's settings that apply in the plane or in space."""
    other = settings.plane_only if space == "3d" else settings.space_only
    return tuple(name for name in settings.model_fields if name not in other or other[name])


def format_settings_page(stages: Sequence[Stage] = STAGES) -> str:
    """Return the page of all settings as Markdown."""
    lines = [
        "# Settings",
        "",
        "Keys of a trial's YAML file. Paths are relative to the file; omitted keys have their defaults.",
        "",
        *_format_rows(TrialKeys.model_fields),
        "| `out` | path | `runs/<trial>` | folder of the results |",
        "",
    ]
    for stage in stages:
        if stage.settings.model_fields:
            lines += [f"## `{stage.name}:`", "", stage.help, "", *_format_rows(stage.settings.model_fields), ""]
    return "\n".join(lines)


def _format_section(stage: Stage, space: Space) -> Iterator[str]:
    yield f"# {stage.help}"
    yield f"#{stage.name}:"
    for name in list_settings(stage.settings, space):
        field = stage.settings.model_fields[name]
        yield f"#  {name}: {_format_default(field)}  # {field.description}"
    yield ""


def _format_rows(fields: dict[str, FieldInfo]) -> Iterator[str]:
    yield "| key | type | default | meaning |"
    yield "|---|---|---|---|"
    yield from _format_keys(fields, "")


def _format_keys(fields: dict[str, FieldInfo], above: str) -> Iterator[str]:
    """Yield the rows of keys and, below each key, those of the keys inside it; ``above`` is the path to them."""
    for name, field in fields.items():
        if not isinstance(field.get_default(call_default_factory=True), Settings):
            yield _format_row(above + name, field)
        for dots, model in _find_nested(field.annotation):
            yield from _format_keys(model.model_fields, above + name + dots)


def _format_row(name: str, field: FieldInfo) -> str:
    default = "required" if field.is_required() else f"`{_format_default(field)}`"
    return f"| `{name}` | {_describe_type(field.annotation)} | {default} | {field.description} |"


def _find_nested(annotation: Any) -> Iterator[tuple[str, type[Settings]]]:
    """Yield every mapping with fixed keys that a type can contain, and the text between its key and theirs.

    This text is ``.`` for a mapping itself, ``[].`` for items of a list and ``.<name>.`` for values of a mapping.
    """
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation is Calibration:  # its files are found from the path of the calibration trial
        return
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        yield ".", annotation
    elif origin is dict:
        yield from ((f".<name>{dots}", model) for dots, model in _find_nested(arguments[1]))
    elif origin is tuple:
        yield from ((f"[]{dots}", model) for dots, model in _find_nested(arguments[0]))
    elif origin is not Literal:
        for argument in arguments:
            yield from _find_nested(argument)


def _format_default(field: FieldInfo) -> str:
    return json.dumps(to_jsonable_python(field.get_default(call_default_factory=True)), ensure_ascii=False)


def _describe_type(annotation: Any) -> str:
    """Return the description of a type, such as "list of 2 numbers"."""
    names = {float: "number", int: "whole number", str: "text", bool: "true or false"}
    if annotation in names:
        return names[annotation]
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        return {Files: "path or mapping", Calibration: "path"}.get(annotation, "mapping")
    arguments = [argument for argument in get_args(annotation) if argument is not type(None)]
    if get_origin(annotation) is Annotated:
        return _describe_type(arguments[0])
    if get_origin(annotation) is dict:
        return f"{_describe_type(arguments[0])}: {_describe_type(arguments[1])}"
    if all(isinstance(argument, str) for argument in arguments) and arguments:
        return ", ".join(f"`{argument}`" for argument in arguments)
    if get_origin(annotation) is tuple:
        items = [argument for argument in arguments if argument is not Ellipsis]
        count = "" if Ellipsis in arguments else f"{len(items)} "
        return f"list of {count}{_PLURALS.get(_describe_type(items[0]), _describe_type(items[0]))}"
    if arguments:
        return " or ".join(_describe_type(argument) for argument in arguments)
    return getattr(annotation, "__name__", str(annotation)).lower()
