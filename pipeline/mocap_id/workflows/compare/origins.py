"""Differences between the origins of two runs: versions, inputs, settings, artefacts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mocap_id.store import Artefact, LongTable, Table
from mocap_id.store.schemas import SCHEMAS
from mocap_id.workflows.compare.difference import Difference, Value, compare_entries, flatten
from mocap_id.workflows.run_folder import RunFolder

_DIGITS = 12  # number of digits of a hash that are output


def compare_origins(a: RunFolder, b: RunFolder) -> Iterator[Difference]:
    """Yield the differences in versions, input files, and settings of the stages that both runs completed."""
    both = _list_stages(a) & _list_stages(b)
    yield from compare_entries("versions", _list_versions(a, both), _list_versions(b, both))
    yield from compare_entries("inputs", _list_inputs(a), _list_inputs(b))
    yield from compare_entries("settings", _list_settings(a, both), _list_settings(b, both))


def compare_artefacts(a: RunFolder, b: RunFolder) -> Iterator[Difference]:
    """Yield the differences between the artefacts' keys; two artefacts with the same content get a common key."""
    first, second = _list_keys(a), _list_keys(b)
    for file in {*first} & {*second}:
        if _has_same_content(a.artefacts[file], b.artefacts[file]):
            first[file] = second[file] = min(str(first[file]), str(second[file]))
    yield from compare_entries("artefacts", first, second)


def _list_keys(run: RunFolder) -> dict[str, Value]:
    return {file: about.origin.key[:_DIGITS] for file, about in run.provenance.items()}


def _has_same_content(one: Artefact, other: Artefact) -> bool:
    """Return whether two artefacts have the same data, facts and reasons for the verdict."""
    return (one.facts, one.reasons) == (other.facts, other.reasons) and _is_equal(
        _collect_data(one), _collect_data(other)
    )


def _collect_data(artefact: Artefact) -> Any:
    match artefact:
        case Table():
            return artefact.columns
        case LongTable():
            index = {"frame": artefact.frames, "time": artefact.time, "marker": np.array(artefact.labels)}
            return {**artefact.values, **index}
    return artefact.data


def _is_equal(one: Any, other: Any) -> bool:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_is_equal(one[name], other[name]) for name in one)
    one, other = np.asarray(one), np.asarray(other)
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f" == other.dtype.kind)


def _list_stages(run: RunFolder) -> set[str]:
    return {about.origin.stage for about in run.provenance.values()}


def _list_versions(run: RunFolder, stages: set[str]) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for file, about in run.provenance.items():
        if about.origin.stage not in stages:
            continue
        found["mocap-id"] = about.origin.product
        found[f"{about.origin.stage} (stage)"] = about.origin.stage_version
        found[f"{file} (schema)"] = about.schema_version
    return found


def _list_inputs(run: RunFolder) -> dict[str, Value]:
    """Return by name the hashes that the user's files had when the stages read them."""
    return {
        name: content[:_DIGITS]
        for about in run.provenance.values()
        for name, content in about.origin.inputs.items()
        if name not in SCHEMAS
    }


def _list_settings(run: RunFolder, stages: set[str]) -> dict[str, Value]:
    settings = (about.origin.parameters for about in run.provenance.values() if about.origin.stage in stages)
    return {key: value for parameters in settings for key, value in flatten(dict(parameters))}
