"""Artefacts of the calibration trial, whose chain is used. A trial without markers always has a calibration trial."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from mocap_id import store
from mocap_id.errors import RecordingError
from mocap_id.stages.trial_keys import Calibration, TrialKeys
from mocap_id.store.provenance import CHAIN, STATES

if TYPE_CHECKING:
    from mocap_id.store import Table, Tree

_T = TypeVar("_T")

FORMAT = "inertial sensors"
"""Fact ``format`` of planar.parquet if the recording has no markers."""


def has_no_markers(facts: Mapping[str, Any]) -> bool:
    """Return True if the facts of planar.parquet describe a trial of inertial sensors without markers."""
    return facts.get("format") == FORMAT


def get_calibration(trial: TrialKeys) -> Calibration:
    """Return the calibration of a trial without markers, which always has one."""
    assert trial.calibration is not None
    return trial.calibration


def read_chain(calibration: Calibration) -> Tree:
    """Read chain.h5 of the calibration trial.

    Raises RecordingError if the file is missing or damaged, or if its chain is in space although a chain in the plane
    is expected, or the reverse.
    """
    path = calibration.chain
    from mocap_id.store import hdf5  # noqa: PLC0415  the settings of the stages do not need it

    tree = _read(calibration, path, lambda content: hdf5.decode_tree(content, CHAIN)[0])
    plane = calibration.states is not None
    if tree.has("joints/kind") == plane:
        found, expected = ("space", "the plane") if plane else ("the plane", "space")
        raise RecordingError(f"{path} contains a chain in {found}, expected one in {expected}; check `calibration:`")
    return tree


def read_states(calibration: Calibration) -> Table:
    """Read states.parquet of the calibration trial, for a trial without markers."""
    assert calibration.states is not None
    from mocap_id.store import parquet  # noqa: PLC0415  as above

    table = _read(calibration, calibration.states, lambda content: parquet.decode_table(content, STATES)[0])
    assert isinstance(table, store.Table)
    return table


def _read(calibration: Calibration, path: Path, decode: Callable[[bytes], _T]) -> _T:
    """Return the content of a file, decoded by ``decode``; a RecordingError says how to compute the file again."""
    again = f"run `mocap-id run {calibration.trial}` again"
    try:
        return decode(path.read_bytes())
    except OSError as error:
        raise RecordingError(f"{path} cannot be read ({error.strerror}); {again}") from error
    except ValueError as error:
        raise RecordingError(f"{path} {error}; {again}") from error
