"""The chain of the calibration: a trial of the same person and markers whose chain is used."""

from __future__ import annotations

from mocap_id.errors import RecordingError
from mocap_id.stages.trial_keys import Calibration
from mocap_id.store import Tree, hdf5
from mocap_id.store.schemas import CHAIN


def read_calibration(calibration: Calibration) -> Tree:
    """Return chain.h5 of the calibration.

    Raises
    ------
    RecordingError
        The file is missing or damaged, or the chain is in space where one in the plane is needed, or the reverse.
    """
    path = calibration.chain
    again = f"run `mocap-id run {calibration.trial}` again"
    try:
        tree, _ = hdf5.decode(path.read_bytes(), CHAIN)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}): {again}") from error
    except ValueError as error:
        raise RecordingError(f"{path} {error}: {again}") from error
    plane = calibration.states is not None
    if tree.has("joints/kind") == plane:
        found, expected = ("space", "the plane") if plane else ("the plane", "space")
        raise RecordingError(f"{path} is a chain in {found}, expected one in {expected}; check `calibration:`")
    return tree
