"""YAML 1.2 with the line of every key, and its conversion to a pydantic model with one line for every mistake."""

from __future__ import annotations

import difflib
import errno
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails
from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode

from mocap_id import plain_files
from mocap_id.errors import ConfigError, first_line

Location: TypeAlias = tuple[str | int, ...]
"""Keys and list indices from the root to a value."""

_MAX_BYTES = 1 << 20
_MAX_DEPTH = 32
_MAX_VALUES = 40_000  # reading them takes some seconds; a study of a thousand trials has about a third of this
_ADVICE = {
    "'\\t'": "indent with spaces, not with tabs",
    "unknown escape character": "write a path with / or without quotes",
    "undefined alias": "put text that begins with * in quotes",
    "alphabetic or numeric": "put text that begins with * or & in quotes",
}
_YAML = "tag:yaml.org,2002:"
_BROKEN = (ArithmeticError, AssertionError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""Exceptions of the YAML library for some invalid files, besides its own errors."""
_JSON_TAGS = tuple(_YAML + name for name in ("str", "int", "float", "bool", "null"))


@dataclass(frozen=True)
class Source:
    """Contents of a YAML file: JSON-like data, and the line (from 1) of each location; no lines if there is no file."""

    file: Path
    data: Any
    lines: Mapping[Location, int]

    def where(self, location: Location) -> str:
        """Return ``FILE, line N`` of a location or of the nearest enclosing one; ``FILE`` if there are no lines."""
        if not self.lines:
            return str(self.file)
        while location not in self.lines:
            location = location[:-1]
        return f"{self.file}, line {self.lines[location]}"


def read_source(file: Path) -> Source:
    """Read a YAML file.

    Raises ConfigError if the file is missing, not YAML, or has aliases, tags or duplicate keys.
    """
    try:
        text = plain_files.read_bytes(file, largest=_MAX_BYTES).decode("utf-8")
    except FileNotFoundError as error:
        hint = plain_files.suggest(file)
        raise ConfigError(f"{file}: no such file; expected a YAML file such as trial.yaml{hint}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: not a text file in UTF-8; expected a YAML file such as trial.yaml") from error
    except OSError as error:
        message = f"{file}: cannot be read ({error.strerror}); expected a YAML file such as trial.yaml"
        if error.errno == errno.EFBIG:
            message = (
                f"{file}: expected a YAML file such as trial.yaml, of at most {_MAX_BYTES} bytes; for a recording, "
                "`mocap-id run RECORDING --save trial.yaml` writes one"
            )
        raise ConfigError(message) from error
    yaml = YAML(typ="safe", pure=True)
    yaml.Composer = _Composer
    try:
        root = yaml.compose(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{file}, line {mark.line + 1}" if mark else str(file)
        problem = error.problem or error.context or ""
        advice = next((f": {text}" for words, text in _ADVICE.items() if words in problem), "")
        raise ConfigError(f"{where}: not valid YAML: {problem}{advice}") from error
    except (YAMLError, *_BROKEN) as error:
        raise ConfigError(f"{file}: not valid YAML: {first_line(error)}") from error
    if root is None:
        raise ConfigError(f"{file}: the file is empty, expected `trial:`, `recording:` and so on")
    reader = _Reader(file, yaml)
    return Source(file, reader.build(root, ()), {(): 1, **reader.lines})


class _Composer(Composer):
    """Composer of YAML nodes with limits on depth and number of values."""

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._depth = self._values = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node as the library does; YAMLError if a limit is exceeded."""
        self._depth += 1
        self._values += 1
        if self._depth > _MAX_DEPTH:
            raise YAMLError(f"values are nested more than {_MAX_DEPTH} levels deep, expected fewer")
        if self._values > _MAX_VALUES:
            raise YAMLError(f"there are more than {_MAX_VALUES} values, expected fewer")
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


class _Reader:
    """Converter of a tree of nodes to plain data, which collects the lines of all keys and values."""

    def __init__(self, file: Path, yaml: YAML) -> None:
        self.file, self.yaml = file, yaml
        self.lines: dict[Location, int] = {}
        self._seen: set[int] = set()

    def build(self, node: Node, location: Location) -> Any:
        self.lines.setdefault(location, node.start_mark.line + 1)
        if id(node) in self._seen:
            raise self._error(node, "aliases (`*name`) are not supported: write the value out")
        self._seen.add(id(node))
        if not isinstance(node, ScalarNode):
            if str(node.tag) not in (_YAML + "map", _YAML + "seq"):
                raise self._error(node, f"the tag `{node.tag}` is not supported: write the values without it")
            if isinstance(node, MappingNode):
                return self._mapping(node, location)
            return [self.build(item, (*location, index)) for index, item in enumerate(node.value)]
        if str(node.tag) == _YAML + "timestamp":  # a trial may be named after its date
            return node.value
        if str(node.tag) not in _JSON_TAGS:
            raise self._error(node, f"the tag `{node.tag}` is not supported: write the value without it")
        try:
            return self.yaml.constructor.construct_object(node)
        except (YAMLError, *_BROKEN) as error:
            kind, text = str(node.tag).removeprefix(_YAML), str(node.value)[:40]
            raise self._error(node, f"`{text}` is not a valid {kind} ({first_line(error)})") from error

    def _mapping(self, node: MappingNode, location: Location) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, ScalarNode):
                raise self._error(key_node, "a key must be a name")
            key = str(key_node.value)
            line = key_node.start_mark.line + 1
            if key in data:
                first = self.lines[(*location, key)]
                raise ConfigError(f"{self.file}, line {line}: `{key}` is given twice, first on line {first}: keep one")
            self.lines[(*location, key)] = line
            data[key] = self.build(value_node, (*location, key))
        return data

    def _error(self, node: Node, message: str) -> ConfigError:
        return ConfigError(f"{self.file}, line {node.start_mark.line + 1}: {message}")


_Model = TypeVar("_Model", bound=BaseModel)

_MAX_LINES = 12
_MAX_CONTRADICTIONS = 30
_FILE = re.compile(r"lax-or-strict\[.*\]")  # name that pydantic gives to the path of a file in a union
# names that pydantic adds to a location for each type of a union
_ALTERNATIVE = re.compile(rf"str|int|tuple\[.*\]|{_FILE.pattern}")
_NUMBERS = {
    "float_type": "expected a number",
    "float_parsing": "expected a number",
    "int_type": "expected a whole number",
    "int_parsing": "expected a whole number",
    "int_from_float": "expected a whole number",
}


def parse(
    source: Source,
    model: type[_Model],
    expected: str,
    complete: Callable[[dict[str, Any]], dict[str, Any]] = lambda data: data,
) -> _Model:
    """Return the model of a YAML file's data.

    ``expected`` names typical keys, for the message about a file without keys. ``complete`` replaces short forms in the
    data by full forms before the check. Raises ConfigError with one line for every mistake.
    """
    if not isinstance(source.data, dict):
        raise ConfigError(f"{source.where(())}: expected {expected}")
    try:  # as JSON: types are strict, yet lists become tuples and texts become paths
        return model.model_validate_json(json.dumps(complete(source.data)), strict=True)
    except ValidationError as error:
        mistakes = error.errors(include_url=False)
        either = [each for each in mistakes if any(_FILE.fullmatch(str(step)) for step in each["loc"])]
        for each in either:  # a file or keys: tell only the mistakes in the form that was given
            above = each["loc"][:-1]
            keys = isinstance(each["input"], dict)
            mistakes = [one for one in mistakes if one is not each if keys or one["loc"][: len(above)] != above]
            mistakes += [] if keys else [each]
        lines = [_describe_mistake(detail, model, source) for detail in mistakes]
        raise ConfigError(_join_lines(lines, _MAX_LINES)) from error


def raise_mistakes(lines: Iterable[str]) -> None:
    """Raise a ConfigError with these lines; do nothing if there are none."""
    mistakes = list(lines)
    if mistakes:
        raise ConfigError(_join_lines(mistakes, _MAX_CONTRADICTIONS))


def _join_lines(lines: Sequence[str], most: int) -> str:
    more = [f"… and {len(lines) - most} more"] if len(lines) > most else []
    return "\n".join([*lines[:most], *more])


def build_json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """Return the JSON Schema of a model, for editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema(by_alias=True)}


def suggest_name(name: str, known: Sequence[str]) -> str:
    """Return ``did you mean …?`` with the most similar known name, or a list of all known names if none is similar."""
    lowered = {candidate.lower().replace("_", "-"): candidate for candidate in known}
    close = difflib.get_close_matches(name.lower().replace("_", "-"), lowered, n=1, cutoff=0.6)
    return f"did you mean `{lowered[close[0]]}`?" if close else f"expected one of {', '.join(known)}"


def _describe_mistake(detail: ErrorDetails, model: type[BaseModel], source: Source) -> str:
    """Return the message about one mistake that pydantic found."""
    location: Location = ()
    for k, step in enumerate(detail["loc"], start=1):
        here = _find_model(model, location)
        unknown = detail["type"] == "extra_forbidden" and k == len(detail["loc"])
        if unknown or not (_ALTERNATIVE.fullmatch(str(step)) or (location and here and step == here.__name__)):
            location = (*location, step)
    key = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in location).lstrip(".")
    where = source.where(location)
    if detail["type"] == "extra_forbidden":
        return f"{where}: unknown key `{key}`: {_suggest_key(str(location[-1]), location[:-1], model)}"
    field = _find_field(model, location)
    about = f" ({field.description})" if field and field.description else ""
    if detail["type"] == "missing" and isinstance(location[-1], int):
        return f"{where}: `{key}` is missing: the list is too short{about}"
    if detail["type"] == "missing":
        return f"{where}: `{key}` is missing{about}"
    shown = "empty" if detail["input"] is None else repr(detail["input"])
    shown = shown if len(shown) <= 60 else f"{shown[:57]}…"
    return f"{where}: `{key}` is {shown}, {_describe_expected(detail, location)}{about}"


def _suggest_key(name: str, above: Location, model: type[BaseModel]) -> str:
    """Suggest the most similar key of this section, or another section that has exactly this key."""
    here = _find_model(model, above)
    known = key_names(here)
    if name.isdigit():
        return "a number takes a decimal point, not a comma, as in 1.75"
    if not above:
        sections = [section for section in known if name in key_names(_find_model(model, (section,)))]
        if sections:
            return f"it belongs under `{sections[0]}:`"
    return suggest_name(name, known)


def key_names(model: type[BaseModel] | None) -> list[str]:
    """Return a model's keys as written in YAML."""
    return [field.alias or name for name, field in model.model_fields.items()] if model else []


def _describe_expected(detail: ErrorDetails, location: Location) -> str:
    """Return a text that says which value was expected, from pydantic's message."""
    message = detail["msg"].removeprefix("Value error, ")
    if message != detail["msg"]:
        return f"but {message}"
    if detail["type"] == "string_type" and not isinstance(detail["input"], list | dict):
        return f'expected text: write it in quotes, "{detail["input"]}"'
    if detail["type"] == "string_pattern_mismatch":
        return "which is not allowed"
    if detail["type"] == "literal_error":
        choices = re.findall(r"'([^']*)'", detail["ctx"]["expected"])
        near = suggest_name(str(detail["input"]), choices)
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


def _find_field(model: type[BaseModel], location: Location) -> FieldInfo | None:
    """Return the field at a location, or None; list indices and keys chosen by the user are skipped."""
    field: FieldInfo | None = None
    here: type[BaseModel] | None = model
    free = False  # whether the next step is a key chosen by the user
    for step in location:
        if isinstance(step, int) or free:
            free = False
            continue
        if here is None:
            break
        field = next((field for name, field in here.model_fields.items() if step in (field.alias, name)), None)
        here = next(_models_in(field.annotation), None) if field else None
        free = here is not None and field is not None and get_origin(field.annotation) is dict
    return field


def _find_model(model: type[BaseModel], location: Location) -> type[BaseModel] | None:
    """Return the model of the section at a location; None if it is not a section."""
    field = _find_field(model, location) if location else None
    return next(_models_in(field.annotation), None) if field else None if location else model


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in an annotation such as ``Model | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)
