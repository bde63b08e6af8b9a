"""Configuration of a trial, read from a YAML file: keys of the trial, and settings of every stage."""

from __future__ import annotations

import errno
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Discriminator, Field, Tag, WithJsonSchema, create_model

from mocap_id import plain_files
from mocap_id.config.parsing import Location, Source, build_json_schema, parse, raise_mistakes, read_source
from mocap_id.errors import ConfigError
from mocap_id.stages import STAGES, Stage
from mocap_id.stages.base import Settings
from mocap_id.stages.trial_keys import Calibration, Files, StaticTrial, TrialKeys

_LONGEST = 100  # largest number of characters of a file name in a run folder


@dataclass(frozen=True)
class Trial:
    """A checked trial, ready to run."""

    file: Path  # the YAML file, absolute
    keys: TrialKeys  # keys that several stages read, with absolute paths
    settings: Mapping[str, Settings]  # settings of each stage, by its name
    out: Path  # the run folder, absolute

    @property
    def name(self) -> str:
        """The trial's name."""
        return self.keys.trial


def _inline_references(schema: Any, parts: Mapping[str, Any]) -> Any:
    """Return a JSON Schema in which every reference is replaced by the part to which it refers."""
    if isinstance(schema, list):
        return [_inline_references(each, parts) for each in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        return _inline_references(parts[schema["$ref"].rpartition("/")[2]], parts)
    return {key: _inline_references(value, parts) for key, value in schema.items() if key != "$defs"}


class _RecordingSchema:
    """JSON Schema of ``recording``, which may also be the name of one file."""

    def __get_pydantic_json_schema__(self, core_schema: object, handler: object) -> dict[str, Any]:
        files = Files.model_json_schema()
        short = "C3D file, or TRC file or export of QTM, Motive or Nexus without forces"
        return {"anyOf": [{"type": "string", "description": short}, _inline_references(files, files["$defs"])]}


_Recording = Annotated[Files | None, _RecordingSchema()]
_Calibration = Annotated[Calibration, WithJsonSchema({"type": "string", "description": "YAML file of a trial"})]
_STATIC = {"type": "string", "description": "YAML file of a still standing trial"}
_Static = Annotated[
    Annotated[tuple[float, float], Tag("tuple[float,float]")]
    | Annotated[
        StaticTrial,
        Tag("StaticTrial"),
        WithJsonSchema({"type": "object", "properties": {"trial": _STATIC}, "required": ["trial"]}),
    ],
    Discriminator(lambda value: "StaticTrial" if isinstance(value, dict) else "tuple[float,float]"),
]  # a message lists the mistakes of the form that was given


class _TopLevel(TrialKeys):
    recording: _Recording = Field(description=TrialKeys.model_fields["recording"].description)
    static: _Static | None = Field(None, description=TrialKeys.model_fields["static"].description)
    calibration: _Calibration | None = Field(None, description=TrialKeys.model_fields["calibration"].description)
    out: Path | None = Field(None, description="folder of the results; default: runs/<trial> beside this file")


@cache  # making the model takes 20 ms
def build_trial_model(stages: tuple[Stage, ...] = STAGES) -> type[BaseModel]:
    """Return the model of a whole YAML file: the trial's keys, and an optional section for each stage."""
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

    Raises ConfigError with one line for every mistake: file, line, key, what was found, what was expected.
    """
    return compose(read_source(file.absolute()), stages)


def compose(
    source: Source,
    stages: Sequence[Stage] = STAGES,
    *,
    out: Path | None = None,
    model: type[BaseModel] | None = None,
) -> Trial:
    """Return the trial described by a YAML file or by a part of a YAML file.

    ``out`` is the run folder if there is no key ``out``; default: ``runs/<trial>`` beside the file. ``model`` is the
    result of :func:`build_trial_model` (the default) or a subclass of it. Raises ConfigError as for :func:`load`.
    """
    if isinstance(source.data, dict) and {"study", "trials"} <= source.data.keys():
        raise ConfigError(f"{source.file} is a study, not a trial: `mocap-id study {source.file}` runs all its trials")
    model = build_trial_model(tuple(stages)) if model is None else model
    folder = source.file.parent
    parsed = parse(
        source, model, "keys such as `trial:` and `recording:`", lambda data: _expand_short_forms(data, stages, source)
    )
    keys = TrialKeys.model_construct(
        **{name: make_absolute(getattr(parsed, name), folder) for name in TrialKeys.model_fields}
    )
    out = make_absolute(getattr(parsed, "out", None), folder) or out or folder / "runs" / keys.trial
    # This system must allow the name of the run folder and of a file in it.
    shown = f"{source.where(('out',))}: the folder of the results, {str(out)[-40:]!r},"
    beside = (folder / part for part in out.parts[1:])  # the folders of out may not exist yet
    for path in (out / ".mocap-id" / ("x" * _LONGEST), *beside):
        try:
            path.stat()
        except ValueError as error:
            raise ConfigError(f"{shown} is not a valid path ({error}): choose another `out`") from error
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                raise ConfigError(f"{shown} is longer than this system allows: choose another `out`") from error
    settings = {stage.name: getattr(parsed, stage.name.replace("-", "_")) for stage in stages}
    # settings that exist only with the other value of `space`
    own, other = ("3d", "plane") if keys.space == "3d" else ("plane", "3d")
    mistakes = []
    for name, given in settings.items():
        for key, values in (given.plane_only if own == "3d" else given.space_only).items():
            value = getattr(given, key)
            if key in given.model_fields_set and (not values or value in values):
                mistakes.append(
                    f"{source.where((name, key))}: `{name}: {{{f'{key}: {value}' if values else key}}}` exists only "
                    f"with `space: {other}`; this trial has `space: {own}`. Remove the setting, or change `space`"
                )
    raise_mistakes(mistakes)
    return Trial(source.file, keys, settings, out)


def _expand_short_forms(data: dict[str, Any], stages: Sequence[Stage], source: Source) -> dict[str, Any]:
    """Return the data with all short forms replaced by full forms.

    Short forms are the name of one file for a recording, a calibration or a device, and sections without any line.
    """
    data = dict(data)
    if isinstance(data.get("recording"), str):
        data["recording"] = {"markers": data["recording"]}
    alone = data.get("recording") is None and {"imus", "calibration"} <= data.keys()
    if alone:
        data["recording"] = None
    if isinstance(data.get("calibration"), str):
        data["calibration"] = _find_calibration(source, data["calibration"], stages, alone=alone)
    if isinstance(data.get("static"), dict | str):
        data["static"] = _find_static_trial(source, data["static"], stages)
    curl = data.get("curl")
    if isinstance(curl, dict) and isinstance(curl.get("device"), str):
        from mocap_id.config.device import load_device  # noqa: PLC0415  few trials have a device

        config = load_device(_find_file(source, ("curl", "device"), curl["device"], "a device"))
        condition = curl.get("condition")
        name = str(condition) if condition is not None and config.keys.conditions else None
        device = config.keys.model_copy(update={"sealed": config.condition(name)})  # chambers in this condition
        data["curl"] = curl | {"device": device.model_dump(mode="json")}
    return data | {stage.name: {} for stage in stages if stage.name in data and data[stage.name] is None}


def _find_calibration(source: Source, given: str, stages: Sequence[Stage], *, alone: bool) -> dict[str, Any]:
    """Return the files of the calibration, which is the trial whose chain is used.

    ``alone`` says whether the trial itself consists of inertial sensors without markers.
    """
    where = source.where(("calibration",))
    file = _find_file(source, ("calibration",), given, "a trial")
    other = read_source(file)
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
        imus = {
            segment: str(each) if isinstance(each, Path) else each.model_dump(mode="json")
            for segment, each in trial.keys.imus.items()
        }
        return files | {"states": str(trial.out / "states.parquet"), "imus": imus}
    if trial.keys.space != "3d":
        raise ConfigError(f"{where}: calibration: {file} is a trial in the plane; expected `space: 3d`")
    return files


def _find_static_trial(source: Source, given: dict[str, Any] | str, stages: Sequence[Stage]) -> dict[str, Any]:
    """Return the recording of the static trial, and how to read it. That trial itself is never run."""
    where = source.where(("static",))
    if not isinstance(given, dict) or set(given) != {"trial"} or not isinstance(given["trial"], str):
        raise ConfigError(
            f"{where}: static: expected the first and last time of a still pose, [0.0, 2.0], or "
            "{trial: static.yaml}, the YAML file of a still standing trial"
        )
    file = _find_file(source, ("static", "trial"), given["trial"], "a trial")
    if file == source.file:
        raise ConfigError(f"{where}: static: {file} is this trial; give the times of its still pose, [0.0, 2.0]")
    other = read_source(file)
    if isinstance(other.data, dict) and isinstance(other.data.get("static"), dict):
        raise ConfigError(f"{where}: static: {file} itself has a static trial; name that trial here")
    trial = compose(other, stages)
    if trial.keys.recording is None or trial.keys.recording.markers is None:
        raise ConfigError(f"{where}: static: {file} has no markers; expected a trial with the markers of this one")
    planarise: Any = trial.settings["planarise"]
    return {
        "trial": str(file),
        "recording": str(trial.keys.recording.markers.absolute()),
        "window": None if trial.keys.window is None else list(trial.keys.window),
        "units": planarise.units,
        "vertical": planarise.vertical,
    }


def _find_file(source: Source, location: Location, given: str, kind: str) -> Path:
    """Return the absolute path of a YAML file that another YAML file names; ConfigError if it does not exist."""
    file: Path = make_absolute(Path(given), source.file.parent).absolute()
    if not file.exists():
        raise ConfigError(
            f"{source.where(location)}: {location[-1]}: there is no file {file}; expected the YAML file of {kind}"
            f"{plain_files.suggest(file)}"
        )
    return file


def build_schema(stages: Sequence[Stage] = STAGES) -> dict[str, Any]:
    """Return the JSON Schema of a trial's YAML file, for editors."""
    document = build_json_schema(build_trial_model(tuple(stages)))
    alternatives = [["recording"], ["imus", "calibration"]]
    required = [key for key in document["required"] if key != "recording"]
    return document | {"required": required, "anyOf": [{"required": keys} for keys in alternatives]}


def make_absolute(value: Any, folder: Path) -> Any:
    """Return a value in which every path is absolute; relative paths start at the YAML file's folder."""
    if isinstance(value, Path):
        try:
            return folder / value.expanduser()
        except RuntimeError:  # ~ of an unknown user
            return folder / value
    if isinstance(value, tuple):
        return tuple(make_absolute(item, folder) for item in value)
    if isinstance(value, Mapping):
        return {key: make_absolute(item, folder) for key, item in value.items()}
    if isinstance(value, BaseModel):
        return value.model_copy(
            update={name: make_absolute(getattr(value, name), folder) for name in type(value).model_fields}
        )
    return value
