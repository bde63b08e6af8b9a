"""Schemas of all artefacts.

The schemas are a public interface: columns may be added freely, but renamed only with a new schema version.
"""

from __future__ import annotations

from mocap_id.store.columns import Column, TableSchema, TreeSchema
from mocap_id.store.spatial_columns import ANGLE, CHAIN_IN_SPACE, POSES_IN_SPACE

_TIME = Column("time", "float64", "s", "the recording's own clock")
_WRENCH = ("Fx", "N"), ("Fy", "N"), ("tauz", "N*m"), ("cop_x", "m")


def _wrench(suffix: str, meaning: str, prefix: str = "") -> tuple[Column, ...]:
    return tuple(Column(f"{prefix}{name}{suffix}", "float64", unit, f"{meaning}: {name}") for name, unit in _WRENCH)


PLANAR = TableSchema(
    "planar.parquet",
    1,
    (
        Column("frame", "int64", "", "frame number in the recording"),
        _TIME,
        Column("marker", "category", "", "label"),
        Column("x", "float64", "m", "along the motion, plane frame"),
        Column("y", "float64", "m", "upwards, plane frame"),
        Column("z", "float64", "m", "out of the plane, plane frame"),
        Column("visible", "bool", "", "measured in this frame"),
    ),
    long=True,
)

WRENCH = TableSchema(
    "wrench.parquet",
    1,
    (
        _TIME,
        Column("Fx", "float64", "N", "force of the ground on the body along x, sum of the feet's plates"),
        Column("Fy", "float64", "N", "force of the ground on the body upwards"),
        Column("tauz", "float64", "N*m", "moment of the ground on the body about the origin of the plane frame"),
        Column("cop_x", "float64", "m", "centre of pressure, NaN where Fy is under the threshold"),
        Column("plate_ok", "bool", "", "all channels of the feet's plates are finite and unsaturated"),
    ),
    (
        Column("Fx_p{k}", "float64", "N", "plate k alone, Fx"),
        Column("Fy_p{k}", "float64", "N", "plate k alone, Fy"),
        Column("tauz_p{k}", "float64", "N*m", "plate k alone, tauz about the plane-frame origin"),
    ),
    (
        (
            Column("Fx_seat", "float64", "N", "force of the chair on the body along x, empty reading removed"),
            Column("Fy_seat", "float64", "N", "force of the chair on the body upwards, empty reading removed"),
            Column("tauz_seat", "float64", "N*m", "moment of the chair on the body about the plane-frame origin"),
        ),
        (
            Column("Fx_external_{k}", "float64", "N", "force of sensor k of `external:` on the body along x"),
            Column("Fy_external_{k}", "float64", "N", "force of sensor k on the body upwards"),
            Column("tauz_external_{k}", "float64", "N*m", "moment of sensor k about the plane-frame origin"),
        ),
        (
            Column("Fz", "float64", "N", "in space: force of the ground along z, sum of the plates used"),
            Column("taux", "float64", "N*m", "in space: moment of the ground about the origin, along x"),
            Column("tauy", "float64", "N*m", "in space: moment of the ground about the origin, along y"),
        ),
    ),
)

SEGMENTS = TableSchema(
    "segments.parquet",
    1,
    (
        Column("marker", "category", "", "label"),
        Column("segment", "Int64", "", "0 = base, 1…n towards the tip, null = none"),
        Column("residual", "float64", "m", "rms distance from its position in the rigid segment"),
        Column("reason", "str", "", "reason for this segment, or for none"),
    ),
)

CHAIN = TreeSchema(
    "chain.h5",
    1,
    (
        Column("joints/name", "str", "", "(n,) joint names"),
        Column("joints/parent", "int64", "", "(n,) index of the parent segment"),
        Column("joints/centre", "float64", "m", "(n, 2) centre in the parent segment's frame; in space (n, 3)"),
        Column("joints/covariance", "float64", "m^2", "(n, 2, 2) covariance of the centre; in space (n, 3, 3)"),
        Column("joints/arc", "float64", "rad", "(n,) angle travelled, 2.5 to 97.5 % quantile"),
        Column("segments/name", "str", "", "(n + 1,) segment names, base first"),
        Column("segments/length", "float64", "m", "(n - 1,) distance between joints of segments 1…n-1"),
        Column("segments/length_sd", "float64", "m", "(n - 1,) standard deviation of these lengths"),
        Column("markers/name", "str", "", "(M,) labels of the assigned markers"),
        Column("markers/segment", "int64", "", "(M,) segment of each marker"),
        Column("markers/local", "float64", "m", "(M, 2) coordinates in the segment frame; in space (M, 3)"),
        Column("markers/residual", "float64", "m", "(M,) rms re-projection error of the joint fit"),
    ),
    (CHAIN_IN_SPACE,),
)

STATES = TableSchema(
    "states.parquet",
    1,
    (_TIME,),
    (
        Column("theta_{k}", "float64", "rad", "joint angle relative to the parent segment"),
        Column("dtheta_{k}", "float64", "rad/s", "velocity"),
        Column("ddtheta_{k}", "float64", "rad/s^2", "acceleration"),
        Column("dddtheta_{k}", "float64", "rad/s^3", "jerk"),
        Column("sd_theta_{k}", "float64", "rad", "its standard deviation without a constant, by camera and skin"),
        Column("sd_dtheta_{k}", "float64", "rad/s", "its standard deviation, by camera and skin"),
        Column("sd_ddtheta_{k}", "float64", "rad/s^2", "its standard deviation, by camera and skin"),
        Column("observed_{k}", "bool", "", "the angle was estimated from markers in this frame; false = bridged"),
    ),
)

POSES = TableSchema(
    "poses.parquet",
    1,
    (_TIME,),
    (
        Column("x_{k}", "float64", "m", "centroid of the markers of body k (fact `bodies`), along the motion"),
        Column("y_{k}", "float64", "m", "centroid of the markers of body k, upwards"),
        Column("angle_{k}", "float64", "rad", "angle of the body's frame in the plane frame"),
        Column("markers_{k}", "int64", "", "number of markers used for the pose in this frame"),
    ),
    (POSES_IN_SPACE,),
)

ANGLES = TableSchema(
    "angles.parquet",
    1,
    (_TIME,),
    (),
    (
        ANGLE,
        (
            Column(
                "isb_condition", "float64", "1", "1/|sin elevation|: large where plane and axial rotation mean little"
            ),
        ),
    ),
)

MARKERS = TableSchema(
    "markers.parquet",
    1,
    (
        Column("frame", "int64", "", "frame number in the recording"),
        _TIME,
        Column("marker", "category", "", "label"),
        Column("x", "float64", "m", "predicted from the states, plane frame"),
        Column("y", "float64", "m", "predicted from the states, plane frame"),
        Column("residual", "float64", "m", "distance to the measurement, NaN where unseen"),
        Column("used", "bool", "", "used for the states: on a moving segment, no burst or bad stretch, in the gate"),
    ),
    optional=((Column("z", "float64", "m", "in space: predicted from the states"),),),
    long=True,
)

ENCODER = TableSchema(
    "encoder.parquet",
    1,
    (
        _TIME,
        Column("theta", "float64", "rad", "joint angle from the encoder, with the sense and zero of the plane"),
        Column("dtheta", "float64", "rad/s", "velocity"),
        Column("ddtheta", "float64", "rad/s^2", "acceleration"),
        Column("sd_theta", "float64", "rad", "its standard deviation without a constant, by encoder noise"),
        Column("sd_dtheta", "float64", "rad/s", "its standard deviation, by encoder noise"),
        Column("sd_ddtheta", "float64", "rad/s^2", "its standard deviation, by encoder noise"),
    ),
)

SKIN = TreeSchema(
    "skin.h5",
    1,
    (
        Column("joints/centre", "float64", "m", "(n, 2) as in chain.h5"),
        Column("joints/mean_angle", "float64", "rad", "(n,) mean joint angle, at which a slide is zero"),
        Column("markers/name", "str", "", "(K,) labels of the moving segments' markers"),
        Column("markers/segment", "int64", "", "(K,) segment of each marker"),
        Column("markers/local", "float64", "m", "(K, 2) coordinates in the segment frame"),
        Column("markers/seen", "float64", "1", "(K,) share of the frames in which the marker was used for the states"),
        Column("markers/variance", "float64", "m^2", "(K,) variance of the slide, per coordinate"),
        Column("markers/unshaped_variance", "float64", "m^2", "(K,) variance of the part that follows no joint"),
        Column("markers/spread", "float64", "rad", "(K,) rms variation of the angles of the joints below and above"),
        Column(
            "response/slides",
            "float64",
            "1",
            "(K, 2, 2, 2(n + K)) change of the centres, then of the coordinates, caused by a slide along x or y of the "
            "segment in proportion to the joint below or above",
        ),
        Column("response/noise", "float64", "m", "(P, P) square root of their covariance by other causes"),
    ),
)

RISE = (
    Column("seat_off_72", "float64", "s", "the feet's force passes the thesis's share of the standing weight"),
    Column("seat_off_model", "float64", "s", "measured and modelled force meet"),
    Column("reached", "float64", "1", "greatest height, as a share of the rise from seat to standing"),
    Column("held", "float64", "s", "duration of pauses between seat and standing"),
    Column("attempts", "int64", "", "failed attempts before this rise"),
    Column("support", "float64", "1", "vertical force not from ground or chair, share of the standing weight"),
    Column("left_seated", "float64", "1", "left foot's share of the load on the feet, seated before the rise"),
    Column("left_rising", "float64", "1", "left foot's share of the load on the feet, from start to stand"),
    Column("left_standing", "float64", "1", "left foot's share of the load on the feet, standing after the rise"),
)
"""Additional columns of events.parquet for a sit-to-stand."""

EVENT = (
    Column("kind", "str", "", "reach or curl"),
    Column("top", "float64", "s", "middle of the time at the farthest or highest point"),
)
"""Additional columns of events.parquet for the protocols of an arm."""
REACH = (
    Column("target", "str", "", "part of the body or height that the hand went to; none if it went to none"),
    Column("miss_m", "float64", "m", "distance by which the target was missed; 0 if it was touched"),
)
CURL = (Column("amplitude", "float64", "rad", "rise of the elbow's flexion from start to top"),)

EVENTS = TableSchema(
    "events.parquet",
    1,
    (
        Column("start", "float64", "s", "the rise begins"),
        Column("seat_off", "float64", "s", "contact with the chair ends"),
        Column("stand", "float64", "s", "upright"),
        Column("seat_on", "float64", "s", "contact with the chair begins"),
        Column("end", "float64", "s", "seated, or end of the repetition"),
        Column("complete", "bool", "", "every event of the protocol was found"),
        Column("why", "str", "", "what is missing or unusual; empty if nothing"),
    ),
    (),
    (RISE, EVENT, REACH, CURL),
)

PHASES = TableSchema(
    "phases.parquet",
    1,
    (
        Column("span", "category", "", "repetition (start to end) or rise (start to stand)"),
        Column("percent", "float64", "%", "share of the span's duration, 0 to 100"),
        Column("quantity", "category", "", "as in states.parquet and dynamics.parquet; theta_k_other: another system"),
        Column("unit", "category", "", "unit of mean and sd"),
        Column("mean", "float64", "", "mean over the repetitions"),
        Column("sd", "float64", "", "standard deviation over the repetitions"),
        Column("count", "float64", "1", "number of repetitions with a value there"),
    ),
)

DYNAMICS_TABLE = TableSchema(
    "dynamics.parquet",
    1,
    (
        _TIME,
        *_wrench("", "ground, measured, with the clock offset corrected and the constant error of Fx removed"),
        *_wrench("_model", "ground, identified model minus the measured wrenches of chair and sensors"),
        *_wrench("_model", "standard deviation of the model", "sd_"),
        *_wrench("_reference", "ground, allometric model minus the measured wrenches of chair and sensors"),
        *_wrench("_held_out", "ground, model fitted without this repetition, minus the same wrenches"),
        Column("in_fit", "bool", "", "the sample was used for the identification"),
    ),
    (
        Column("tau_{k}", "float64", "N*m", "torque of segment k-1 on segment k, identified model"),
        Column("sd_tau_{k}", "float64", "N*m", "standard deviation"),
    ),
    (
        (
            Column("Fx_external", "float64", "N", "force of chair and sensors on the body along x, measured"),
            Column("Fy_external", "float64", "N", "force of chair and sensors on the body upwards, measured"),
            Column("tauz_external", "float64", "N*m", "their moment about the plane-frame origin, measured"),
        ),
        tuple(
            Column(f"{prefix}{name}{suffix}", "float64", unit, f"in space: {meaning}, {name}")
            for prefix, suffix, meaning in (
                ("", "", "ground, measured"),
                ("", "_model", "ground, identified model"),
                ("sd_", "_model", "standard deviation of the model"),
            )
            for name, unit in (("Fz", "N"), ("taux", "N*m"), ("tauy", "N*m"))
        ),
        tuple(
            Column(f"{prefix}elbow_torque{suffix}", "float64", "N*m", f"in curls, about the elbow's axis: {meaning}")
            for suffix, whole in (("", "all torques"), ("_device", "of the device"), ("_person", "of the person"))
            for prefix, meaning in (("", whole), ("sd_", f"standard deviation, {whole}"))
        ),
    ),
)

DYNAMICS_TREE = TreeSchema(
    "dynamics.h5",
    1,
    (
        Column("base/name", "str", "", "(b,) base parameters as symbols"),
        Column("base/value", "float64", "", "(b,) SI"),
        Column("base/sd", "float64", "", "(b,) standard deviation"),
        Column("base/covariance", "float64", "", "(b, b) covariance of base/value, SI"),
        Column("base/unit", "str", "", "(b,) kg, kg*m or kg*m^2"),
        Column("base/verdict", "str", "", "(b,) known, weak or not identifiable"),
        Column(
            "base/excitation", "float64", "", "(b,) norm of the column's independent part, residual sds per SI unit"
        ),
        Column("base/own_share", "float64", "", "(b,) base/excitation by the norm of the whole column, 0 ... 1"),
        Column("base/relative_sd", "float64", "", "(b,) standard deviation divided by the parameter's magnitude"),
        Column("base/prior_share", "float64", "1", "(b,) share of the precision from the prior, 0 ... 1"),
        Column("base/regrouping", "float64", "", "(b, 4(n+1)) matrix M of eq. 4.24"),
        Column("full/name", "str", "", "(4(n+1),) m, mx, my, Izz of every segment, base first"),
        Column("full/value", "float64", "", "(4(n+1),) one consistent solution; not identifiable individually"),
        Column("full/reference", "float64", "", "(4(n+1),) allometric values, NaN where none apply"),
        Column("bodies/value", "float64", "", "(4K,) m, mx, my, Izz of the K fitted bodies (poses.parquet)"),
        Column("bodies/reference", "float64", "", "(4K,) allometric values, NaN where none apply"),
        Column("bodies/covariance", "float64", "", "(4K, 4K) of bodies/value; NaN for the pinned chain"),
        Column("grid/segment", "int64", "", "(p,) segment of each point mass"),
        Column("grid/position", "float64", "m", "(p, 2) in the segment frame"),
        Column("held_out/base", "float64", "", "(k, b) base parameters of k fits, each without some repetitions"),
        Column("held_out/clock_offset", "float64", "s", "(k,) clock offset of each of these fits"),
        Column("grid/mass", "float64", "kg", "(p,) point masses; NaN where `consistency` is not `grid`"),
    ),
)

SCHEMAS: dict[str, TableSchema | TreeSchema] = {
    schema.file: schema
    for schema in (
        PLANAR,
        WRENCH,
        SEGMENTS,
        CHAIN,
        STATES,
        MARKERS,
        SKIN,
        ENCODER,
        POSES,
        ANGLES,
        EVENTS,
        DYNAMICS_TABLE,
        DYNAMICS_TREE,
        PHASES,
    )
}
