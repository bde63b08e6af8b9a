"""Keys in the configuration of a trial of curls: condition, loads, device, and rules of the analysis."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

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
