"""YAML 1.2 files as plain data, with the line of every key and value."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

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


def read(file: Path) -> Source:
    """Read a YAML file.

    Raises ConfigError if the file is missing, not YAML, or has aliases, tags or duplicate keys.
    """
    text = _read_text(file)
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


def _read_text(file: Path) -> str:
    try:
        return plain_files.read(file, largest=_MAX_BYTES).decode("utf-8")
    except FileNotFoundError as error:
        hint = plain_files.suggest(file)
        raise ConfigError(f"{file}: no such file; expected a YAML file such as trial.yaml{hint}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: not a text file in UTF-8; expected a YAML file such as trial.yaml") from error
    except OSError as error:
        if error.errno == errno.EFBIG:
            message = (
                f"{file}: expected a YAML file such as trial.yaml, of at most {_MAX_BYTES} bytes; for a recording, "
                "`mocap-id run RECORDING --save trial.yaml` writes one"
            )
        else:
            message = f"{file}: cannot be read ({error.strerror}); expected a YAML file such as trial.yaml"
        raise ConfigError(message) from error


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
        if not isinstance(node, ScalarNode) and str(node.tag) not in (_YAML + "map", _YAML + "seq"):
            raise self._error(node, f"the tag `{node.tag}` is not supported: write the values without it")
        match node:
            case MappingNode():
                return self._mapping(node, location)
            case SequenceNode():
                return [self.build(item, (*location, index)) for index, item in enumerate(node.value)]
            case ScalarNode():
                return self._scalar(node)
        raise self._error(node, "expected a value, a list or keys")

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

    def _scalar(self, node: ScalarNode) -> Any:
        if str(node.tag) == _YAML + "timestamp":  # a trial may be named after its date
            return node.value
        if str(node.tag) not in _JSON_TAGS:
            raise self._error(node, f"the tag `{node.tag}` is not supported: write the value without it")
        try:
            return self.yaml.constructor.construct_object(node)
        except (YAMLError, *_BROKEN) as error:
            kind = str(node.tag).removeprefix(_YAML)
            raise self._error(node, f"`{str(node.value)[:40]}` is not a valid {kind} ({first_line(error)})") from error

    def _error(self, node: Node, message: str) -> ConfigError:
        return ConfigError(f"{self.file}, line {node.start_mark.line + 1}: {message}")
