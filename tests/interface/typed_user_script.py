"""A user's script with every public name, which mypy checks strictly in ``test_types_of_users``."""

from __future__ import annotations

from pathlib import Path

import mocap_id


def largest_angle(file: Path) -> float:
    """Return the largest angle of the first joint, rad."""
    run: mocap_id.Run = mocap_id.run(file, protocol="free", window=(1.0, 5.0))
    verdict: mocap_id.Verdict = run.verdict
    if run.refused or verdict.level == "caution":
        raise mocap_id.RecordingError(", ".join(describe(reason) for reason in verdict.reasons))
    units: dict[str, str] = run.states.attrs["units"]
    assert units["theta_1"] == "rad"
    run.figure(run.figures[0]).to_matplotlib().savefig("first.pdf")
    print(run.export("ktk", out="exported"))
    return float(run.states["theta_1"].max())


def describe(reason: mocap_id.Reason) -> str:
    """Return code and message."""
    return f"{reason.code}: {reason.message}"


def page_of(figure: mocap_id.Figure) -> str:
    """Return a figure's page."""
    return figure.name + figure.caption + figure.to_html()


def own_recording() -> mocap_id.Recording:
    """Return a recording with a plate, from arrays."""
    recording = mocap_id.read("trial.c3d")
    first: mocap_id.Plate = recording.plates[0]
    plate = mocap_id.Plate.from_arrays(first.force, first.rate, moment=first.moment, corners=first.corners)
    own = mocap_id.Recording.from_arrays(recording.labels, recording.positions, recording.rate, [plate], units="m")
    mocap_id.Recording.from_xarray(own.to_xarray())
    return mocap_id.Recording.from_frame(own.to_frame(), vertical="Z")


def every_name(folder: str) -> None:
    """Use the other names."""
    study: mocap_id.Study = mocap_id.study("study.yaml", jobs=2)
    try:
        print(own_recording().rate, largest_angle(mocap_id.simulate("robot", "new", seed=1)))
    except (mocap_id.ConfigError, mocap_id.NumericalError, mocap_id.StoreError, mocap_id.Refused) as error:
        wrong: mocap_id.MocapIdError = error
        print(wrong)
    print(study.tables["trials"].shape, page_of(study.figure("lengths")), mocap_id.open(folder).steps)
    number: int = mocap_id.open(folder).name  # type: ignore[assignment]  # the types are known: this is an error
    print(number, mocap_id.__version__)
