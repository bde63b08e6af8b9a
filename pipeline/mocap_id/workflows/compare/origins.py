"""Differences in the origins of two runs: versions, inputs, settings, artefacts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mocap_id.store import Artefact, LongTable, Table
from mocap_id.store.schemas import SCHEMAS
from mocap_id.workflows.compare.difference import Difference, Value, choices, flat
from mocap_id.workflows.run_folder import RunFolder

_SHOWN = 12  # digits of a hash


def origins(a: RunFolder, b: RunFolder) -> Iterator[Difference]:
    """Compare versions, input files, and settings of the stages that both runs completed."""
    both = _stages(a) & _stages(b)
    yield from choices("versions", _versions(a, both), _versions(b, both))
    yield from choices("inputs", _inputs(a), _inputs(b))
    yield from choices("settings", _settings(a, both), _settings(b, both))


def artefacts(a: RunFolder, b: RunFolder) -> Iterator[Difference]:
    """Compare the artefacts' keys; artefacts with the same data, facts and reasons are shown with the same key."""
    first, second = _keys(a), _keys(b)
    for file in {*first} & {*second}:
        if _same(a.artefacts[file], b.artefacts[file]):
            first[file] = second[file] = min(str(first[file]), str(second[file]))
    yield from choices("artefacts", first, second)


def _keys(run: RunFolder) -> dict[str, Value]:
    return {file: about.origin.key[:_SHOWN] for file, about in run.provenance.items()}


def _same(one: Artefact, other: Artefact) -> bool:
    """Return whether two artefacts have the same data, facts and reasons."""
    return (one.facts, one.reasons) == (other.facts, other.reasons) and _equal(_data(one), _data(other))


def _data(artefact: Artefact) -> Any:
    match artefact:
        case Table():
            return artefact.columns
        case LongTable():
            index = {"frame": artefact.frames, "time": artefact.time, "marker": np.array(artefact.labels)}
            return {**artefact.values, **index}
    return artefact.data


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_equal(one[name], other[name]) for name in one)
    one, other = np.asarray(one), np.asarray(other)
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f" == other.dtype.kind)


def _stages(run: RunFolder) -> set[str]:
    return {about.origin.stage for about in run.provenance.values()}


def _versions(run: RunFolder, stages: set[str]) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for file, about in run.provenance.items():
        if about.origin.stage not in stages:
            continue
        found["mocap-id"] = about.origin.product
        found[f"{about.origin.stage} (stage)"] = about.origin.stage_version
        found[f"{file} (schema)"] = about.schema_version
    return found


def _inputs(run: RunFolder) -> dict[str, Value]:
    """Return the hashes of the user's files when the stages read them."""
    return {
        name: content[:_SHOWN]
        for about in run.provenance.values()
        for name, content in about.origin.inputs.items()
        if name not in SCHEMAS
    }


def _settings(run: RunFolder, stages: set[str]) -> dict[str, Value]:
    settings = (about.origin.parameters for about in run.provenance.values() if about.origin.stage in stages)
    return {key: value for parameters in settings for key, value in flat(dict(parameters))}
