"""Configuration of a trial, read from a YAML file: keys of the trial, and settings of every stage."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, WithJsonSchema, create_model

from mocap_id.config.parsing import json_schema, parse, raise_mistakes
from mocap_id.config.source import Source, read
from mocap_id.errors import ConfigError
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Settings
from mocap_id.stages.trial_keys import Calibration, Files, TrialKeys

_LONGEST = 100
"""Largest number of characters of a file name in a run folder."""


@dataclass(frozen=True)
class Trial:
    """A checked trial, ready to run.

    Parameters
    ----------
    file : Path
        The YAML file, absolute.
    keys : TrialKeys
        Keys that several stages read, with absolute paths.
    settings : mapping of str to Settings
        Settings of each stage, by its name.
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


def _inlined(schema: Any, parts: Mapping[str, Any]) -> Any:
    """Return a JSON Schema with its own parts in place of references to them."""
    if isinstance(schema, list):
        return [_inlined(each, parts) for each in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        return _inlined(parts[schema["$ref"].rpartition("/")[2]], parts)
    return {key: _inlined(value, parts) for key, value in schema.items() if key != "$defs"}


class _RecordingSchema:
    """JSON Schema of ``recording``, which may also be one file; a run does not need it."""

    def __get_pydantic_json_schema__(self, core_schema: object, handler: object) -> dict[str, Any]:
        files = Files.model_json_schema()
        short = "C3D file, or TRC file or export of QTM, Motive or Nexus without forces"
        return {"anyOf": [{"type": "string", "description": short}, _inlined(files, files["$defs"])]}


_Recording = Annotated[Files | None, _RecordingSchema()]
_Calibration = Annotated[Calibration, WithJsonSchema({"type": "string", "description": "YAML file of a trial"})]


class _TopLevel(TrialKeys):
    recording: _Recording = Field(description=TrialKeys.model_fields["recording"].description)
    calibration: _Calibration | None = Field(None, description=TrialKeys.model_fields["calibration"].description)
    out: Path | None = Field(None, description="folder of the results; default: runs/<trial> beside this file")


def trial_model(stages: Sequence[Stage] = STAGES) -> type[BaseModel]:
    """Return the model of a whole YAML file: the trial's keys and an optional section for each stage."""
    return _trial_model(tuple(stages))


@cache  # making the model takes 20 ms
def _trial_model(stages: tuple[Stage, ...]) -> type[BaseModel]:
    sections: dict[str, Any] = {
        stage.name.replace("-", "_"): (
            stage.settings,
            Field(default_factory=stage.settings, alias=stage.name, description=stage.help),
        )
        for stage in stages
    }
    return create_model("Trial", __base__=_TopLevel, __doc__="A trial of mocap-id.", **sections)


def load(file: Path, stages: Sequence[Stage] = STAGES) -> Trial:
    """Read and check a trial's YAML file; the files that it names are not opened.

    Raises
    ------
    ConfigError
        One line for every mistake: file, line, key, what was found, what was expected.
    """
    return compose(read(file.absolute()), stages)


def compose(
    source: Source,
    stages: Sequence[Stage] = STAGES,
    *,
    out: Path | None = None,
    model: type[BaseModel] | None = None,
) -> Trial:
    """Return the trial with the keys of a file or of a part of a file.

    Parameters
    ----------
    source : Source
        Keys and values as in a trial's file, with their lines.
    stages : sequence of Stage
    out : Path, optional
        The run folder if there is no key ``out``; default: ``runs/<trial>`` beside the file.
    model : type of BaseModel, optional
        Model of the keys: :func:`trial_model` or a subclass of it.

    Raises
    ------
    ConfigError
        As for :func:`load`.
    """
    if isinstance(source.data, dict) and {"study", "trials"} <= source.data.keys():
        raise ConfigError(f"{source.file} is a study, not a trial: `mocap-id study {source.file}` runs all its trials")
    model = trial_model(stages) if model is None else model
    folder = source.file.parent
    parsed = parse(
        source, model, "keys such as `trial:` and `recording:`", lambda data: _completed(data, stages, source)
    )
    keys = TrialKeys.model_construct(
        **{name: absolute(getattr(parsed, name), folder) for name in TrialKeys.model_fields}
    )
    out = absolute(getattr(parsed, "out", None), folder) or out or folder / "runs" / keys.trial
    _check_name(out, source)
    settings = {stage.name: getattr(parsed, stage.name.replace("-", "_")) for stage in stages}
    raise_mistakes(_wrong_space(keys, settings, source))
    return Trial(source.file, keys, settings, out)


def _check_name(out: Path, source: Source) -> None:
    """Raise ConfigError where this system does not allow the folder's name."""
    shown = f"{source.where(('out',))}: the folder of the results, {str(out)[-40:]!r},"
    beside = (source.file.parent / part for part in out.parts[1:])  # the folders of out may not exist yet
    for path in (out / ".mocap-id" / ("x" * _LONGEST), *beside):
        try:
            path.stat()
        except ValueError as error:
            raise ConfigError(f"{shown} is not a valid path ({error}): choose another `out`") from error
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                raise ConfigError(f"{shown} is longer than this system allows: choose another `out`") from error


def _wrong_space(keys: TrialKeys, settings: Mapping[str, Settings], source: Source) -> Iterator[str]:
    """Yield a line for every setting that does not exist in the trial's space."""
    own, other = ("3d", "plane") if keys.space == "3d" else ("plane", "3d")
    for stage, given in settings.items():
        for name, values in (given.plane_only if own == "3d" else given.space_only).items():
            value = getattr(given, name)
            if name not in given.model_fields_set or (values and value not in values):
                continue
            shown = f"{name}: {value}" if values else name
            yield (
                f"{source.where((stage, name))}: `{stage}: {{{shown}}}` exists only with `space: {other}`; this trial "
                f"has `space: {own}`. Remove the setting, or change `space`"
            )


def _completed(data: dict[str, Any], stages: Sequence[Stage], source: Source) -> dict[str, Any]:
    """Write out short forms: a recording in one file, a calibration, a section whose lines are all commented out."""
    data = dict(data)
    if isinstance(data.get("recording"), str):
        data["recording"] = {"markers": data["recording"]}
    alone = data.get("recording") is None and {"imus", "calibration"} <= data.keys()
    if alone:
        data["recording"] = None
    if isinstance(data.get("calibration"), str):
        data["calibration"] = _calibration(source, data["calibration"], stages, alone=alone)
    curl = data.get("curl")
    if isinstance(curl, dict) and isinstance(curl.get("device"), str):
        data["curl"] = curl | {"device": _device(source, curl["device"], curl.get("condition"))}
    return data | {stage.name: {} for stage in stages if stage.name in data and data[stage.name] is None}


def _device(source: Source, given: str, condition: object) -> dict[str, Any]:
    """Return the keys of a device's file, with the state of its chambers in the trial's condition as `sealed`."""
    from mocap_id.config.device import load_device  # noqa: PLC0415  few trials have a device

    file = (source.file.parent / _expanded(Path(given))).absolute()
    if not file.exists():
        raise ConfigError(
            f"{source.where(('curl', 'device'))}: device: there is no file {file}; expected a device's YAML"
        )
    config = load_device(file)
    name = str(condition) if condition is not None and config.keys.conditions else None
    keys = config.keys.model_copy(update={"sealed": config.condition(name)})
    return keys.model_dump(mode="json")


def _calibration(source: Source, given: str, stages: Sequence[Stage], *, alone: bool) -> dict[str, Any]:
    """Return the files of the trial whose chain is used; ``alone``: for a trial of inertial sensors without markers."""
    where = source.where(("calibration",))
    file = (source.file.parent / _expanded(Path(given))).absolute()
    if not file.exists():
        raise ConfigError(f"{where}: calibration: there is no file {file}; expected the YAML file of a trial")
    other = read(file)
    if isinstance(other.data, dict) and other.data.get("calibration") is not None:
        raise ConfigError(f"{where}: calibration: {file} itself has a `calibration:`; name that trial here")
    trial = compose(other, stages)
    files = {"trial": str(file), "chain": str(trial.out / "chain.h5")}
    if alone:
        if not trial.keys.imus:
            raise ConfigError(
                f"{where}: calibration: {file} has no `imus`; a trial without markers needs one with markers and the "
                "same sensors, worn in the same way"
            )
        imus = {segment: str(path) for segment, path in trial.keys.imus.items()}
        return files | {"states": str(trial.out / "states.parquet"), "imus": imus}
    if trial.keys.space != "3d":
        raise ConfigError(f"{where}: calibration: {file} is a trial in the plane; expected `space: 3d`")
    return files


def schema(stages: Sequence[Stage] = STAGES) -> dict[str, Any]:
    """Return the JSON Schema of a trial's YAML file, for editors."""
    found = json_schema(trial_model(stages))
    needed = [["recording"], ["imus", "calibration"]]
    required = [key for key in found["required"] if key != "recording"]
    return found | {"required": required, "anyOf": [{"required": keys} for keys in needed]}


def absolute(value: Any, folder: Path) -> Any:
    """Return a value in which every path is absolute; relative paths start at the YAML file's folder."""
    if isinstance(value, Path):
        return folder / _expanded(value)
    if isinstance(value, tuple):
        return tuple(absolute(item, folder) for item in value)
    if isinstance(value, Mapping):
        return {key: absolute(item, folder) for key, item in value.items()}
    if isinstance(value, BaseModel):
        return value.model_copy(
            update={name: absolute(getattr(value, name), folder) for name in type(value).model_fields}
        )
    return value


def _expanded(path: Path) -> Path:
    """Replace ``~`` by the home folder, unless the user does not exist."""
    try:
        return path.expanduser()
    except RuntimeError:
        return path
