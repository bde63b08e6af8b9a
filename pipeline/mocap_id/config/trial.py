"""The trial model, composed from the tuple of stages, and how a YAML file becomes one."""

from __future__ import annotations

import errno
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError, WithJsonSchema, create_model

from mocap_id.config.explain import explain
from mocap_id.config.source import Source, read
from mocap_id.errors import ConfigError
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Files, Settings, TrialKeys

_LONGEST = 100
"""Characters of a name that a run gives to a file in its folder, at most."""


@dataclass(frozen=True)
class Trial:
    """One trial, ready to run.

    Parameters
    ----------
    file : Path
        The YAML file, absolute.
    keys : TrialKeys
        What several stages read; paths absolute.
    settings : mapping of str to Settings
        Each stage's own, by the stage's name.
    out : Path
        The run folder, absolute.
    """

    file: Path
    keys: TrialKeys
    settings: Mapping[str, Settings]
    out: Path

    @property
    def name(self) -> str:
        """The trial's name."""
        return self.keys.trial


_RECORDING_SCHEMA = {
    "anyOf": [
        {"type": "string", "description": "C3D file, or a TRC file without forces"},
        Files.model_json_schema(),
    ]
}
_Recording = Annotated[Files, WithJsonSchema(_RECORDING_SCHEMA)]


class _TopLevel(TrialKeys):
    recording: _Recording = Field(description=TrialKeys.model_fields["recording"].description)
    out: Path | None = Field(None, description="folder of the results; default: runs/<trial> beside this file")


def trial_model(stages: Sequence[Stage] = STAGES) -> type[BaseModel]:
    """The model of a whole YAML file: the trial's keys and one optional section a stage."""
    sections: dict[str, Any] = {
        stage.name.replace("-", "_"): (
            stage.settings,
            Field(default_factory=stage.settings, alias=stage.name, description=stage.help),
        )
        for stage in stages
    }
    return create_model("Trial", __base__=_TopLevel, __doc__="A trial of mocap-id.", **sections)


def load(file: Path, stages: Sequence[Stage] = STAGES) -> Trial:
    """Read and check a trial's YAML file; nothing that it names is opened.

    Raises
    ------
    ConfigError
        One line for every mistake: file, line, key, what was found, what was expected.
    """
    source = read(file.absolute())
    if not isinstance(source.data, dict):
        raise ConfigError(f"{source.where(())}: expected keys such as `trial:` and `recording:`")
    return compose(source, stages)


def compose(
    source: Source,
    stages: Sequence[Stage] = STAGES,
    *,
    out: Path | None = None,
    model: type[BaseModel] | None = None,
) -> Trial:
    """A trial of its keys and values, wherever they were written.

    Parameters
    ----------
    source : Source
        Keys and values as in a trial's file, with the lines on which they stand.
    stages : sequence of Stage
    out : Path, optional
        The run folder where the keys name none; by default ``runs/<trial>`` beside the file.
    model : type of BaseModel, optional
        What the keys are checked against: :func:`trial_model` or one made from it, which may ask for more.

    Raises
    ------
    ConfigError
        As for :func:`load`.
    """
    if isinstance(source.data, dict) and {"study", "trials"} <= source.data.keys():
        raise ConfigError(f"{source.file} is a study, not a trial: `mocap-id study {source.file}` runs all its trials")
    model = trial_model(stages) if model is None else model
    try:  # as JSON: strict about types, yet lists are tuples and text is a path
        parsed = model.model_validate_json(json.dumps(_written_out(source.data, stages)), strict=True)
    except ValidationError as error:
        raise ConfigError(explain(error, model, source)) from error
    folder = source.file.parent
    keys = TrialKeys.model_construct(
        **{name: absolute(getattr(parsed, name), folder) for name in TrialKeys.model_fields}
    )
    out = absolute(getattr(parsed, "out", None), folder) or out or folder / "runs" / keys.trial
    _check_name(out, source)
    settings = {stage.name: getattr(parsed, stage.name.replace("-", "_")) for stage in stages}
    return Trial(source.file, keys, settings, out)


def _check_name(out: Path, source: Source) -> None:
    """ConfigError where no file could be called so on this system."""
    shown = f"{source.where(('out',))}: the folder of the results, {str(out)[-40:]!r},"
    beside = (source.file.parent / part for part in out.parts[1:])  # out's own folders may not be there yet
    for path in (out / ".mocap-id" / ("x" * _LONGEST), *beside):
        try:
            path.stat()
        except ValueError as error:
            raise ConfigError(f"{shown} can be none ({error}): choose another `out`") from error
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                raise ConfigError(f"{shown} is longer than this system allows: choose another `out`") from error


def _written_out(data: dict[str, Any], stages: Sequence[Stage]) -> dict[str, Any]:
    """The short forms in full: a recording in one file, and a section whose every line is commented out."""
    data = dict(data)
    if isinstance(data.get("recording"), str):
        data["recording"] = {"markers": data["recording"]}
    return data | {stage.name: {} for stage in stages if stage.name in data and data[stage.name] is None}


def schema(stages: Sequence[Stage] = STAGES) -> dict[str, Any]:
    """JSON Schema of a trial's YAML file, for editors."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **trial_model(stages).model_json_schema(by_alias=True),
    }


def absolute(value: Any, folder: Path) -> Any:
    """Paths, wherever they stand in a value, relative to the YAML file's folder."""
    if isinstance(value, Path):
        return folder / _at_home(value)
    if isinstance(value, tuple):
        return tuple(absolute(item, folder) for item in value)
    if isinstance(value, BaseModel):
        return value.model_copy(
            update={name: absolute(getattr(value, name), folder) for name in type(value).model_fields}
        )
    return value


def _at_home(path: Path) -> Path:
    """With ``~`` written out, where there is such a person."""
    try:
        return path.expanduser()
    except RuntimeError:
        return path
