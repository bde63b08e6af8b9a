"""A user's script, which mypy checks strictly in ``test_types_of_users``."""

from __future__ import annotations

from pathlib import Path

import mocap_id


def largest_angle(file: Path) -> float:
    """Return the largest angle of the first joint, rad."""
    run: mocap_id.Run = mocap_id.run(file, protocol="free", window=(1.0, 5.0))
    if run.refused or run.verdict.level == "caution":
        raise mocap_id.RecordingError(", ".join(reason.code for reason in run.verdict.reasons))
    units: dict[str, str] = run.states.attrs["units"]
    assert units["theta_1"] == "rad"
    return float(run.states["theta_1"].max())


def every_name(folder: str) -> None:
    """Use the other names."""
    recording = mocap_id.read("trial.c3d")
    own = mocap_id.Recording.from_arrays(recording.labels, recording.positions, recording.rate, recording.plates)
    print(own.to_frame().shape, largest_angle(mocap_id.simulate("robot", "new", seed=1)))
    print(mocap_id.study("study.yaml", jobs=2).tables["trials"].shape, mocap_id.open(folder).steps)
    number: int = mocap_id.open(folder).name  # type: ignore[assignment]  # the types are known: this is an error
    print(number, mocap_id.__version__)
