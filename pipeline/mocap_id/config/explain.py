"""What is wrong with a configuration, in words: file, line, key, what was found and expected, the nearest name."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Sequence
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from mocap_id.config.source import Location, Source

_MAX_LINES = 12
_ALTERNATIVE = re.compile(r"str|int|tuple\[.*\]")  # where a value may be of several kinds, pydantic names the one tried
_NUMBERS = {
    "float_type": "expected a number",
    "float_parsing": "expected a number",
    "int_type": "expected a whole number",
    "int_parsing": "expected a whole number",
    "int_from_float": "expected a whole number",
}


def explain(error: ValidationError, model: type[BaseModel], source: Source) -> str:
    """One line for every mistake."""
    lines = [_line(detail, model, source) for detail in error.errors(include_url=False)]
    more = [f"… and {len(lines) - _MAX_LINES} more"] if len(lines) > _MAX_LINES else []
    return "\n".join([*lines[:_MAX_LINES], *more])


def nearest(name: str, known: Sequence[str]) -> str:
    """``did you mean …?``, or all that is known where nothing is near."""
    lowered = {candidate.lower().replace("_", "-"): candidate for candidate in known}
    close = difflib.get_close_matches(name.lower().replace("_", "-"), lowered, n=1, cutoff=0.6)
    return f"did you mean `{lowered[close[0]]}`?" if close else f"expected one of {', '.join(known)}"


def _line(detail: ErrorDetails, model: type[BaseModel], source: Source) -> str:
    location: Location = tuple(detail["loc"])
    if detail["type"] != "extra_forbidden":
        location = tuple(step for step in location if not _ALTERNATIVE.fullmatch(str(step)))
    key = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in location).lstrip(".")
    where = source.where(location)
    if detail["type"] == "extra_forbidden":
        return f"{where}: unknown key `{key}`: {_suggest(str(location[-1]), location[:-1], model)}"
    field = _field(model, location)
    about = f" ({field.description})" if field and field.description else ""
    if detail["type"] == "missing" and isinstance(location[-1], int):
        return f"{where}: `{key}` is missing: the list is too short{about}"
    if detail["type"] == "missing":
        return f"{where}: `{key}` is missing{about}"
    return f"{where}: `{key}` is {_shown(detail['input'])}, {_expected(detail, location)}{about}"


def _suggest(name: str, above: Location, model: type[BaseModel]) -> str:
    """The nearest key here, or the section in which a key of exactly this name belongs."""
    here = _model(model, above)
    known = names(here)
    if name.isdigit():
        return "a number takes a decimal point, not a comma, as in 1.75"
    if not above:
        sections = [section for section in known if name in names(_model(model, (section,)))]
        if sections:
            return f"it belongs under `{sections[0]}:`"
    return nearest(name, known)


def names(model: type[BaseModel] | None) -> list[str]:
    """A model's keys as they stand in the YAML."""
    return [field.alias or name for name, field in model.model_fields.items()] if model else []


def _expected(detail: ErrorDetails, location: Location) -> str:
    """Pydantic's sentence from the reader's side."""
    message = detail["msg"].removeprefix("Value error, ")
    if message != detail["msg"]:
        return f"but {message}"
    if detail["type"] == "string_type" and not isinstance(detail["input"], list | dict):
        return f'expected text: write it in quotes, "{detail["input"]}"'
    if detail["type"] == "string_pattern_mismatch":
        return "which is not allowed"
    if detail["type"] == "literal_error":
        choices = re.findall(r"'([^']*)'", detail["ctx"]["expected"])
        near = nearest(str(detail["input"]), choices)
        return f"expected {detail['ctx']['expected']}" + (f": {near}" if near.startswith("did you") else "")
    if detail["type"] in _NUMBERS:
        return _NUMBERS[detail["type"]] + (" without a unit" if isinstance(detail["input"], str) else "")
    if detail["type"] in ("tuple_type", "list_type"):
        return "expected a list"
    if detail["type"] == "too_long":
        return f"expected {detail['ctx']['max_length']} values"
    message = re.sub(r"^Input should be (a valid )?", "expected ", message)
    message = message.replace("an object", "keys and values").replace("expected dictionary", "expected keys and values")
    return message[0].lower() + message[1:]


def _shown(value: Any) -> str:
    text = "empty" if value is None else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _field(model: type[BaseModel], location: Location) -> FieldInfo | None:
    """The field at a location; of an item of a list, or of a mapping by free names, theirs or the item's own."""
    field: FieldInfo | None = None
    here: type[BaseModel] | None = model
    free = False  # the next step is a name that the user chose
    for step in location:
        if isinstance(step, int) or free:
            free = False
            continue
        if here is None:
            break
        field = next((field for name, field in here.model_fields.items() if step in (field.alias, name)), None)
        here = next(_models(field.annotation), None) if field else None
        free = here is not None and field is not None and get_origin(field.annotation) is dict
    return field


def _model(model: type[BaseModel], location: Location) -> type[BaseModel] | None:
    field = _field(model, location) if location else None
    return next(_models(field.annotation), None) if field else None if location else model


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Models within an annotation such as ``Model | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models(argument)
