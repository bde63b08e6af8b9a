"""Keys in the configuration of a trial that several stages read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BeforeValidator, Field, ValidationInfo, WithJsonSchema, field_validator, model_validator

from mocap_id.stages.base import Settings

Vector: TypeAlias = tuple[float, float, float]
_FARTHEST = 0.6  # largest distance of a body from the origin of its segment, m


# a whole number becomes a text, because `condition: 5` is a name
ConditionName: TypeAlias = Annotated[str, BeforeValidator(lambda value: str(value) if type(value) is int else value)]
"""Name of a condition of a study, such as C, AC or 5."""


class Body(Settings):
    """A rigid body that is fixed on the forearm or the hand, in the axes of this segment."""

    mass: float = Field(gt=0, lt=100, description="mass, kg")
    centre: Vector = Field(description="centre of mass in the axes of its segment, m; y points to the elbow")
    inertia: Vector = Field(
        (0.0, 0.0, 0.0), description="moments of inertia about the centre of mass along the segment's axes, kg·m²"
    )
    segment: Literal["forearm", "hand"] = Field("hand", description="segment on which the body is fixed")

    @model_validator(mode="after")
    def _in_metres(self) -> Body:
        if max(map(abs, self.centre)) > _FARTHEST:
            raise ValueError(
                f"centre: expected at most {_FARTHEST:g} m in each direction, not {max(self.centre, key=abs):g}; give "
                "metres"
            )
        if min(self.inertia) < 0 or max(self.inertia) > self.mass * _FARTHEST**2:
            most = self.mass * _FARTHEST**2
            raise ValueError(
                f"inertia: expected 0 to {most:.3g} kg·m² for {self.mass:g} kg on an arm, not {max(self.inertia):g}"
            )
        return self


class CurlKeys(Settings):
    """Keys of a trial of curls."""

    condition: ConditionName | None = Field(
        None, max_length=40, description="name of the condition, for studies, such as C, AC or 5"
    )
    metronome_hz: float | None = Field(
        None, gt=0.05, lt=5, description="tempo of the metronome, curls per second; without it, no tempo is checked"
    )
    loads: dict[str, Body] = Field({}, description="dumbbell, brace and other added bodies, by name")
    forearm: Body | None = Field(None, description="inertia of the forearm; default: by the body mass (de Leva)")
    hand: Body | None = Field(None, description="inertia of the hand; default: by the body mass (de Leva)")
    device: Annotated[dict[str, Any], WithJsonSchema({"type": "string"})] | None = Field(
        None,
        description="YAML file of a pneumatic device at the elbow; `condition` is its state, if the file contains a "
        "condition of this name",
    )
    attempt_deg: float = Field(15.0, gt=0, lt=120, description="smallest flexion of an attempt, degrees")
    complete: float = Field(
        0.6, gt=0, le=1, description="smallest flexion of a complete curl as a share of the flexion in the large curls"
    )
    tempo: float = Field(
        0.5, gt=0, description="largest difference of a curl's duration from the metronome's period, in periods"
    )
    pause: float = Field(
        2.0, gt=0, description="longest pause between curls, in periods of the metronome or median durations of a curl"
    )
    plane_deg: float = Field(
        20.0, gt=0, description="largest rotation of the elbow's axis from its direction in the first curl, degrees"
    )
    compensation_deg: float = Field(
        10.0, gt=0, description="smallest change of an angle of shoulder or thorax in a compensation, degrees"
    )
    sustained_s: float = Field(
        0.25, ge=0, description="shortest duration of a compensation and of motion out of the plane, s"
    )


class Subject(Settings):
    """Person who moves; all keys are optional."""

    height: float | None = Field(None, gt=0.3, lt=2.8, description="stature, m")
    mass: float | None = Field(None, gt=2, lt=400, description="body mass, kg")
    sex: Literal["female", "male"] | None = Field(None, description="sex, for allometric tables that differ by sex")


class Guess(Settings):
    """What `mocap-id run` guessed about a recording without a YAML file; the report repeats it."""

    keys: tuple[str, ...] = Field((), description="guessed keys of the trial")
    movement: str = Field(
        description="movement that was recognised; with walking or jumping the trial is refused: delete `guessed` to "
        "analyse it with the other keys of this file"
    )
    evidence: str = Field(description="what in the motion shows it")


class BalanceBoard(Settings):
    """A balance board with four cells instead of a force plate."""

    balance_board: Path = Field(
        description="CSV with time_s, tl_kg, tr_kg, bl_kg, br_kg; the times may be irregular and of another clock"
    )
    top: Literal["forwards", "backwards", "left", "right"] | None = Field(
        None, description="direction of the board's top as seen by the person; default: estimated from the movement"
    )
    centre_m: tuple[float, float, float] | None = Field(
        None, description="centre of the board's surface in the recording's axes, m; default: from the feet"
    )
    loads: Path | None = Field(
        None, description="calibration: CSV with load_kg, tl_kg, tr_kg, bl_kg, br_kg, one row for each known load"
    )
    clock_offset_s: float = Field(
        0.0, description="time on the recording's clock minus `time_s`, to about 0.1 s; the program refines it"
    )


class Files(Settings):
    """Files of a recording of markers or of a skeleton."""

    markers: Path | None = Field(
        None, description="file with the markers: TRC (or C3D), or an export of QTM, Motive or Nexus"
    )
    skeleton: Path | None = Field(
        None,
        description="in space, instead of markers: joint positions from a depth camera (CSV with time_s, JOINT_x, "
        "JOINT_y, JOINT_z[, JOINT_state] in m) or from markerless software (TRC)",
    )
    forces: Path | BalanceBoard | None = Field(None, description="MOT file with the ground forces, or a balance board")

    @model_validator(mode="after")
    def _one_source(self) -> Files:
        if (self.markers is None) == (self.skeleton is None):
            raise ValueError("expected either `markers` or `skeleton`")
        if self.skeleton is not None and self.forces is not None:
            raise ValueError("`forces` can be used with `markers`, not with a `skeleton`")
        return self

    @property
    def motion(self) -> Path:
        """File with the markers or the skeleton."""
        file = self.markers or self.skeleton
        assert file is not None
        return file


class Compare(Settings):
    """Joint angles from another system, for comparison."""

    angles: Path = Field(description="MOT, STO or CSV file with angles, on the recording's clock")
    columns: dict[str, str] = Field(
        min_length=1, description="joint: column of the file, with a leading minus if its sign is opposite"
    )


PlateNumber: TypeAlias = Annotated[int, Field(ge=1)]


class PlateUse(Settings):
    """Numbers of the force plates under feet and chair, from 1; by default chosen by the program."""

    feet: tuple[PlateNumber, ...] = Field((), description="plates under the feet; their wrenches are added")
    seat: tuple[PlateNumber, ...] = Field((), description="plates under the chair; their wrench also acts on the body")

    @field_validator("seat")
    @classmethod
    def _one_use_a_plate(cls, value: tuple[int, ...], info: ValidationInfo) -> tuple[int, ...]:
        both = sorted(set(value) & set(info.data.get("feet", ())))
        if both:
            raise ValueError(f"plate {both[0]} is also named under `feet`")
        return value


class ExternalForce(Settings):
    """A force sensor that is not a force plate, for example in a hand rail or a cable."""

    file: Path = Field(description="CSV with time_s, Fx_N, Fy_N, Fz_N[, Mx_Nm, My_Nm, Mz_Nm] in the recording's axes")
    name: str = Field(
        pattern=r"^\w[\w -]*$", max_length=40, description="name of the sensor in messages, such as hand or rail"
    )
    segment: str | int = Field(description="segment on which the force acts, by name or number (0 = base)")
    at: str | tuple[float, float, float] = Field(
        description="point of application: a marker, or a fixed point [x, y, z] in the recording's axes, m"
    )
    force: Literal["on-body", "on-sensor"] = Field(
        "on-body", description="sign convention: force of the sensor on the body, or of the body on the sensor"
    )
    clock_offset_s: float = Field(0.0, description="time on the recording's clock minus `time_s`, s")
    measures: Literal["contact", "beyond"] = Field(
        "contact",
        description="contact: force of the surroundings on the segment; beyond: the sensor is in the joint before "
        "`segment` and carries this segment and all segments after it; its axes must not rotate",
    )


class InertialSensor(Settings):
    """Log of an inertial sensor."""

    file: Path = Field(description="CSV with time_s, gyro_x … (rad/s), acc_x … (m/s²), or an export of Xsens or Delsys")
    rate_hz: float | None = Field(
        None, gt=0, description="rows per second, Hz, for an export without times, such as Xsens without `Update Rate`"
    )


Protocol: TypeAlias = Literal["free", "sit-to-stand", "robot-joint", "reach", "curl"]
IN_PLANE: tuple[Protocol, ...] = ("sit-to-stand", "robot-joint")
IN_SPACE: tuple[Protocol, ...] = ("reach", "curl")

Landmark: TypeAlias = Literal[
    "IJ", "PX", "C7", "T8", "AC", "AA", "AI", "TS", "PC", "GH", "EL", "EM", "RS", "US", "MC3", "MCP2", "MCP3", "MCP5",
]  # fmt: skip
"""Anatomical landmarks of thorax and arm, named as by the ISB (Wu et al. 2005)."""


class Calibration(Settings):
    """Files of the calibration trial: another trial of the same person, whose chain is used.

    ``states`` and ``imus`` are given only if the trial that uses the calibration has no markers.
    """

    trial: Path = Field(description="YAML file of the calibration trial")
    chain: Path = Field(description="chain.h5 of the calibration trial")
    states: Path | None = Field(None, description="states.parquet of the calibration trial")
    imus: dict[str, Path | InertialSensor] = Field(
        {}, description="files of the inertial sensors in the calibration trial, by segment"
    )


class StaticTrial(Settings):
    """A still standing trial of the same person with the same markers; its joint angles are the zero."""

    trial: Path = Field(description="YAML file of the static trial")
    recording: Path = Field(description="its recording of markers")
    window: tuple[float, float] | None = Field(None, description="its `window`, s")
    units: str | None = Field(None, description="its `planarise: {units}`")
    vertical: str | None = Field(None, description="its `planarise: {vertical}`")


class TrialKeys(Settings):
    """Keys of a trial that several stages read, with absolute paths."""

    trial: str = Field(
        pattern=r"^\w[\w.+-]*$",
        max_length=100,
        description="name of the trial: letters and digits, with . _ + - between them",
    )
    recording: Files | None = Field(
        description="C3D file, or a TRC file with markers and a MOT file with forces; left out if the trial has only "
        "inertial sensors"
    )
    space: Literal["plane", "3d"] = Field(
        "plane",
        validate_default=True,
        description="plane: hinges in one vertical plane; 3d: ball joints, two-axis joints and hinges in any direction",
    )
    protocol: Protocol = Field(
        "free",
        description="kind of movement: free; in the plane also sit-to-stand (with squats) or robot-joint; in space "
        "also reach or curl",
    )
    guessed: Guess | None = Field(
        None, description="written by `mocap-id run` for a recording without a YAML file: what was guessed, and why"
    )
    subject: Subject = Field(Subject(), description="person who moves; all keys are optional")
    encoder: Path | None = Field(
        None, description="robot-joint only: CSV with time_s, position_rad, velocity_rad_s[, torque_Nm]"
    )
    window: tuple[float, float] | None = Field(
        None, description="first and last time to use, s on the recording's clock; default: chosen by the program"
    )
    plates: PlateUse = Field(
        PlateUse(), description="plates under the feet and the chair; default: chosen by the program"
    )

    side: Literal["right", "left"] | None = Field(
        None,
        description="in space: side of the arm; a left arm is mirrored, so that its signs are those of a right arm. "
        "Default: from the names of the markers, or else right",
    )
    landmarks: dict[Landmark, str] = Field(
        {}, description="in space: marker labels of the anatomical landmarks that do not have their usual labels"
    )
    pointers: dict[Landmark, Path] = Field(
        {}, description="in space: C3D files of recordings in which a pointer touches a landmark"
    )
    pointer: dict[str, float] = Field(
        {},
        description="in space: distance of each marker of the pointer from its tip, m; default: estimated from the "
        "pointer's motion",
    )
    static: tuple[float, float] | StaticTrial | None = Field(
        None,
        description="first and last time of a still pose, s. In space, it shows all landmarks (default: from the "
        "markers). In the plane, its joint angles are zero (default: the standing phases); it can also be {trial: "
        "static.yaml}, a still standing trial of the same person and markers",
    )
    calibration: Calibration | None = Field(
        None,
        description="YAML file of a trial of the same person whose chain is used: in space, a trial with the same "
        "markers; in the plane, for inertial sensors without markers, a trial with markers and the same sensors",
    )
    curl: CurlKeys = Field(CurlKeys(), description="curls: loads, device, metronome and the rules of the analysis")
    imus: dict[str, Path | InertialSensor] = Field(
        {},
        validate_default=True,
        description="files of inertial sensors by segment: CSV with time_s, gyro_x … (rad/s), acc_x … (m/s²), or an "
        "export of Xsens or Delsys; every sensor may have its own clock. For an export without times, give "
        "{file: …, rate_hz: …}",
    )
    compare: Compare | None = Field(None, description="joint angles from another system, for comparison")
    external: tuple[ExternalForce, ...] = Field((), description="other force sensors that act on the body")

    @field_validator("space")
    @classmethod
    def _skeleton_in_space(cls, value: str, info: ValidationInfo) -> str:
        files = info.data.get("recording")
        if value == "plane" and files is not None and files.skeleton is not None:
            raise ValueError("a skeleton needs `space: 3d`")
        return value

    @field_validator("imus")
    @classmethod
    def _imus_with_markers(
        cls, value: dict[str, Path | InertialSensor], info: ValidationInfo
    ) -> dict[str, Path | InertialSensor]:
        files = info.data.get("recording")
        if value and files is not None and files.skeleton is not None:
            raise ValueError("inertial sensors can be used with markers, not with a skeleton")
        if "recording" in info.data and files is None:
            if not value or info.data.get("calibration") is None:
                raise ValueError("a trial without `recording` needs `imus` and `calibration`")
            if info.data.get("space") == "3d":
                raise ValueError("in space, inertial sensors need markers: name a `recording`")
        return value

    @field_validator("external")
    @classmethod
    def _sensors_beside_markers(
        cls, value: tuple[ExternalForce, ...], info: ValidationInfo
    ) -> tuple[ExternalForce, ...]:
        names = [sensor.name for sensor in value]
        twice = sorted({name for name in names if names.count(name) > 1 or name == "seat"})
        if twice:
            raise ValueError(f"`{twice[0]}` is used twice or reserved for the chair: give every sensor its own name")
        if value and "recording" in info.data and info.data["recording"] is None:
            raise ValueError("force sensors need markers: name a `recording`")
        if value and info.data.get("space") == "3d":
            raise ValueError(
                "force sensors need `space: plane`. In space, only plates under a fixed base determine inertial "
                "parameters: with a force at the hand, the wrench through the elbow is still unknown"
            )
        return value

    @field_validator("encoder")
    @classmethod
    def _encoder_has_a_joint(cls, value: Path | None, info: ValidationInfo) -> Path | None:
        if value is not None and info.data.get("protocol") != "robot-joint":
            raise ValueError("an encoder needs `protocol: robot-joint`")
        return value

    @field_validator("curl")
    @classmethod
    def _curl_keys_for_curls(cls, value: CurlKeys, info: ValidationInfo) -> CurlKeys:
        if value != CurlKeys() and info.data.get("protocol") != "curl":
            raise ValueError("this key needs `protocol: curl`")
        return value

    @field_validator("protocol")
    @classmethod
    def _protocol_in_its_space(cls, value: Protocol, info: ValidationInfo) -> Protocol:
        space = info.data.get("space", "plane")
        if value in (IN_SPACE if space == "plane" else IN_PLANE):
            other = "3d" if space == "plane" else "plane"
            raise ValueError(f"`protocol: {value}` needs `space: {other}`")
        return value

    @field_validator("static")
    @classmethod
    def _static_trial_in_plane(
        cls, value: tuple[float, float] | StaticTrial | None, info: ValidationInfo
    ) -> tuple[float, float] | StaticTrial | None:
        if isinstance(value, StaticTrial):
            if info.data.get("space") == "3d":
                raise ValueError("in space, expected the first and last time of a still pose, s")
            if "recording" in info.data and info.data["recording"] is None:
                raise ValueError("a static trial needs markers in this trial too: name a `recording`, or give times")
        return value

    @field_validator("side", "landmarks", "pointers", "pointer", "calibration")
    @classmethod
    def _only_in_space(cls, value: Any, info: ValidationInfo) -> Any:
        alone = info.field_name == "calibration" and info.data.get("recording") is None
        if value and info.data.get("space", "plane") == "plane" and not alone:
            raise ValueError("this key needs `space: 3d`")
        return value

    @field_validator("pointer")
    @classmethod
    def _pointer_has_recordings(cls, value: dict[str, float], info: ValidationInfo) -> dict[str, float]:
        if value and "pointers" in info.data and not info.data["pointers"]:
            raise ValueError("this key has no effect without `pointers`, the recordings in which it touches landmarks")
        return value

    @field_validator("static", "window")
    @classmethod
    def _window_runs_forwards(cls, value: Any) -> Any:
        if isinstance(value, tuple) and not value[0] < value[1]:
            raise ValueError("the first time must come before the last")
        return value


def get_recording(trial: TrialKeys) -> Files:
    """Return the recording of a trial that has markers or a skeleton."""
    assert trial.recording is not None
    return trial.recording


def list_sensors(imus: Mapping[str, Path | InertialSensor]) -> dict[str, InertialSensor]:
    """Return the inertial sensors under ``imus:`` by segment, also if only their files are given."""
    return {
        name: each if isinstance(each, InertialSensor) else InertialSensor(file=each) for name, each in imus.items()
    }


def get_landmark_labels(trial: TrialKeys) -> dict[str, str]:
    """Return the marker labels that the configuration gives under ``landmarks:``, by landmark."""
    return {str(name): label for name, label in trial.landmarks.items()}
