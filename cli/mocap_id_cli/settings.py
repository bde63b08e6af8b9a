"""Settings of all stages, as YAML in comments and as a documentation page."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, TypeAlias, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import to_jsonable_python

from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Settings
from mocap_id.stages.trial_keys import TrialKeys

Space: TypeAlias = Literal["plane", "3d"]
_PLURALS = {"number": "numbers", "whole number": "whole numbers", "text": "texts", "list of texts": "lists of texts"}


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
    for name, field in fields.items():
        nested = _find_nested(field)
        if nested is None:
            yield _format_row(name, field)
            continue
        dots = "[]." if get_origin(field.annotation) is tuple else "."
        for key, part in nested.items():
            yield _format_row(f"{name}{dots}{key}", part)


def _format_row(name: str, field: FieldInfo) -> str:
    default = "required" if field.is_required() else f"`{_format_default(field)}`"
    return f"| `{name}` | {_describe_type(field.annotation)} | {default} | {field.description} |"


def _find_nested(field: FieldInfo) -> dict[str, FieldInfo] | None:
    """Return the fields of a key that is a mapping; None for any other key."""
    annotation = field.annotation
    if get_origin(annotation) is tuple or type(None) in get_args(annotation):
        annotation = get_args(annotation)[0]
    return getattr(annotation, "model_fields", None)


def _format_default(field: FieldInfo) -> str:
    return json.dumps(to_jsonable_python(field.get_default(call_default_factory=True)), ensure_ascii=False)


def _describe_type(annotation: Any) -> str:
    """Return the description of a type, such as "list of 2 numbers"."""
    names = {float: "number", int: "whole number", str: "text", bool: "true or false"}
    if annotation in names:
        return names[annotation]
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
