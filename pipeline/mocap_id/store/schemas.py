"""The artefacts' schemas: names, units and meanings are an interface; add freely, rename only with a new version."""

from __future__ import annotations

from mocap_id.store.artefacts import Column, TableSchema, TreeSchema

_TIME = Column("time", "float64", "s", "the recording's own clock")
_WRENCH = ("Fx", "N"), ("Fy", "N"), ("tauz", "N*m"), ("cop_x", "m")


def _wrench(suffix: str, meaning: str, prefix: str = "") -> tuple[Column, ...]:
    return tuple(Column(f"{prefix}{name}{suffix}", "float64", unit, f"{meaning}: {name}") for name, unit in _WRENCH)


PLANAR = TableSchema(
    "planar.parquet",
    1,
    (
        Column("frame", "int64", "", "the file's own frame number"),
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
        Column("tauz", "float64", "N*m", "moment of the ground on the body about the plane-frame origin"),
        Column("cop_x", "float64", "m", "centre of pressure, NaN where Fy is under the threshold"),
        Column("plate_ok", "bool", "", "every channel of the feet's plates is finite and unsaturated"),
    ),
    (
        Column("Fx_p{k}", "float64", "N", "plate k alone, Fx"),
        Column("Fy_p{k}", "float64", "N", "plate k alone, Fy"),
        Column("tauz_p{k}", "float64", "N*m", "plate k alone, tauz about the plane-frame origin"),
    ),
    (
        (
            Column("Fx_seat", "float64", "N", "force of the chair on the body along x, less the plate's empty reading"),
            Column("Fy_seat", "float64", "N", "force of the chair on the body upwards, likewise"),
            Column("tauz_seat", "float64", "N*m", "moment of the chair on the body about the plane-frame origin"),
        ),
        (
            Column("Fx_external_{k}", "float64", "N", "force of sensor k of `external:` on the body along x"),
            Column("Fy_external_{k}", "float64", "N", "force of sensor k on the body upwards"),
            Column("tauz_external_{k}", "float64", "N*m", "moment of sensor k about the plane-frame origin"),
        ),
    ),
)

SEGMENTS = TableSchema(
    "segments.parquet",
    1,
    (
        Column("marker", "category", "", "label"),
        Column("segment", "Int64", "", "0 = base, 1…n towards the tip, null = none"),
        Column("residual", "float64", "m", "rms distance from the rigid segment"),
        Column("reason", "str", "", "why this segment, or why none"),
    ),
)

CHAIN = TreeSchema(
    "chain.h5",
    1,
    (
        Column("joints/name", "str", "", "(n,) joint names"),
        Column("joints/parent", "int64", "", "(n,) index of the parent segment"),
        Column("joints/centre", "float64", "m", "(n, 2) centre in the parent segment's frame"),
        Column("joints/covariance", "float64", "m^2", "(n, 2, 2) of the centre"),
        Column("joints/arc", "float64", "rad", "(n,) angle travelled, 2.5 to 97.5 % quantile"),
        Column("segments/name", "str", "", "(n + 1,) segment names, base first"),
        Column("segments/length", "float64", "m", "(n - 1,) distance between joints of segments 1…n-1"),
        Column("segments/length_sd", "float64", "m", "(n - 1,) standard deviation"),
        Column("markers/name", "str", "", "(M,) labels of the assigned markers"),
        Column("markers/segment", "int64", "", "(M,) segment of each"),
        Column("markers/local", "float64", "m", "(M, 2) coordinates in the segment frame"),
        Column("markers/residual", "float64", "m", "(M,) rms re-projection error of the joint fit"),
    ),
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
        Column(
            "sd_theta_{k}",
            "float64",
            "rad",
            "standard deviation of the angle but for a constant, from camera noise and slipping skin",
        ),
        Column(
            "sd_dtheta_{k}",
            "float64",
            "rad/s",
            "standard deviation of the velocity, from camera noise and slipping skin",
        ),
        Column("sd_ddtheta_{k}", "float64", "rad/s^2", "standard deviation of the acceleration, likewise"),
        Column("observed_{k}", "bool", "", "the angle rests on markers in this frame; false = bridged"),
    ),
)

POSES = TableSchema(
    "poses.parquet",
    1,
    (_TIME,),
    (
        Column("x_{k}", "float64", "m", "centroid of the markers of body k (fact `bodies`), along the motion"),
        Column("y_{k}", "float64", "m", "the same upwards"),
        Column("angle_{k}", "float64", "rad", "angle of the body's frame from the plane frame"),
        Column("markers_{k}", "int64", "", "markers that this frame's pose rests on"),
    ),
)

MARKERS = TableSchema(
    "markers.parquet",
    1,
    (
        Column("frame", "int64", "", "the file's own frame number"),
        _TIME,
        Column("marker", "category", "", "label"),
        Column("x", "float64", "m", "predicted from the states, plane frame"),
        Column("y", "float64", "m", "predicted from the states, plane frame"),
        Column("residual", "float64", "m", "distance to the measurement, NaN where unseen"),
        Column("used", "bool", "", "the states rest on it: on a moving segment, no jump, within the gate"),
    ),
    long=True,
)

ENCODER = TableSchema(
    "encoder.parquet",
    1,
    (
        _TIME,
        Column("theta", "float64", "rad", "the joint's angle by its encoder, in the plane's sense and from its zero"),
        Column("dtheta", "float64", "rad/s", "velocity"),
        Column("ddtheta", "float64", "rad/s^2", "acceleration"),
        Column("sd_theta", "float64", "rad", "standard deviation of the angle but for a constant, from encoder noise"),
        Column("sd_dtheta", "float64", "rad/s", "standard deviation of the velocity, likewise"),
        Column("sd_ddtheta", "float64", "rad/s^2", "standard deviation of the acceleration, likewise"),
    ),
)

SKIN = TreeSchema(
    "skin.h5",
    1,
    (
        Column("joints/centre", "float64", "m", "(n, 2) as in chain.h5"),
        Column("joints/mean_angle", "float64", "rad", "(n,) from which the slides are counted"),
        Column("markers/name", "str", "", "(K,) labels of the moving segments' markers"),
        Column("markers/segment", "int64", "", "(K,) segment of each"),
        Column("markers/local", "float64", "m", "(K, 2) coordinates in the segment frame"),
        Column("markers/seen", "float64", "1", "(K,) share of the frames in which the states rest on it"),
        Column("markers/variance", "float64", "m^2", "(K,) of the slide, a coordinate"),
        Column("markers/unshaped_variance", "float64", "m^2", "(K,) of its part that follows no joint"),
        Column("markers/spread", "float64", "rad", "(K,) rms of the angles of the joints below and above"),
        Column(
            "response/slides",
            "float64",
            "1",
            "(K, 2, 2, 2(n + K)) change of centres, then coordinates, with a slide along x or y of the segment in step "
            "with the joint below or above",
        ),
        Column("response/noise", "float64", "m", "(P, P) square root of their covariance from other causes"),
    ),
)

RISE = (
    Column("seat_off_72", "float64", "s", "the feet's force passes the thesis's share of the standing weight"),
    Column("seat_off_model", "float64", "s", "measured and modelled force come together"),
    Column("reached", "float64", "1", "greatest height, of the trial's rise from seat to standing"),
    Column("held", "float64", "s", "time in pauses between seat and standing"),
    Column("attempts", "int64", "", "failed attempts before this rise"),
    Column("support", "float64", "1", "vertical force that neither ground nor chair explains, of the standing weight"),
    Column("left_seated", "float64", "1", "left foot's share of the feet's load, on the chair before the rise"),
    Column("left_rising", "float64", "1", "left foot's share of the feet's load, from start to stand"),
    Column("left_standing", "float64", "1", "left foot's share of the feet's load, standing after the rise"),
)
"""What a sit-to-stand's table of events tells beside them."""

EVENTS = TableSchema(
    "events.parquet",
    1,
    (
        Column("start", "float64", "s", "the rise begins"),
        Column("seat_off", "float64", "s", "the chair is released"),
        Column("stand", "float64", "s", "upright"),
        Column("seat_on", "float64", "s", "the chair is touched"),
        Column("end", "float64", "s", "seated, or the repetition's end"),
        Column("complete", "bool", "", "every event of the protocol was found"),
        Column("why", "str", "", "what is missing or unusual, or empty"),
    ),
    (),
    (RISE,),
)

PHASES = TableSchema(
    "phases.parquet",
    1,
    (
        Column("span", "category", "", "repetition (start to end) or rise (start to stand)"),
        Column("percent", "float64", "%", "of the span's time, 0 to 100"),
        Column("quantity", "category", "", "as in states.parquet and dynamics.parquet; theta_k_other: another system"),
        Column("unit", "category", "", "of mean and sd"),
        Column("mean", "float64", "", "over the repetitions"),
        Column("sd", "float64", "", "standard deviation over the repetitions"),
        Column("count", "float64", "1", "repetitions in which it is known there"),
    ),
)

DYNAMICS_TABLE = TableSchema(
    "dynamics.parquet",
    1,
    (
        _TIME,
        *_wrench("", "ground, measured, at the corrected clock, less the plate's constant error of Fx"),
        *_wrench("_model", "ground, identified model less what chair and sensors are measured to do"),
        *_wrench("_model", "standard deviation of the model", "sd_"),
        *_wrench("_reference", "ground, allometric model, likewise"),
        *_wrench("_held_out", "ground, model fitted without this repetition, likewise"),
        Column("in_fit", "bool", "", "this sample was identified on"),
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
    ),
)

DYNAMICS_TREE = TreeSchema(
    "dynamics.h5",
    1,
    (
        Column("base/name", "str", "", "(b,) base parameters in symbols"),
        Column("base/value", "float64", "", "(b,) SI"),
        Column("base/sd", "float64", "", "(b,) standard deviation"),
        Column("base/covariance", "float64", "", "(b, b) behind base/sd, SI"),
        Column("base/unit", "str", "", "(b,) kg, kg*m or kg*m^2"),
        Column("base/verdict", "str", "", "(b,) known, weak or not identifiable"),
        Column("base/excitation", "float64", "", "(b,) norm of the column's own part, residual sds per SI unit"),
        Column("base/own_share", "float64", "", "(b,) of the whole column's norm, 0 ... 1"),
        Column("base/relative_sd", "float64", "", "(b,) standard deviation by the parameter's size"),
        Column("base/prior_share", "float64", "1", "(b,) how much of the precision is the prior's, 0 ... 1"),
        Column("base/regrouping", "float64", "", "(b, 4(n+1)) matrix M of eq. 4.24"),
        Column("full/name", "str", "", "(4(n+1),) m, mx, my, Izz of every segment, base first"),
        Column("full/value", "float64", "", "(4(n+1),) one physically consistent solution, not identifiable alone"),
        Column("full/reference", "float64", "", "(4(n+1),) allometric values, NaN where none apply"),
        Column("bodies/value", "float64", "", "(4K,) m, mx, my, Izz of the K bodies that were fitted (poses.parquet)"),
        Column("bodies/reference", "float64", "", "(4K,) allometric values, NaN where none apply"),
        Column("bodies/covariance", "float64", "", "(4K, 4K) of bodies/value; NaN for the pinned chain"),
        Column("grid/segment", "int64", "", "(p,) segment of each point mass"),
        Column("grid/position", "float64", "m", "(p, 2) in the segment frame"),
        Column(
            "held_out/base", "float64", "", "(k, b) base parameters of the fits that leave out repetitions, in turn"
        ),
        Column("held_out/clock_offset", "float64", "s", "(k,) clock offset of each"),
        Column("grid/mass", "float64", "kg", "(p,) point masses, none negative; NaN where `consistency` is not `grid`"),
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
        EVENTS,
        DYNAMICS_TABLE,
        DYNAMICS_TREE,
        PHASES,
    )
}
