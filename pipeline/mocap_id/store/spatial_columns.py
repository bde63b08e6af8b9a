"""Columns and nodes that only trials in space have."""

from __future__ import annotations

from mocap_id.store.columns import Column

CHAIN_IN_SPACE = (
    Column("joints/kind", "str", "", "(n,) in space: ball, two-axis or hinge"),
    Column("joints/axes", "float64", "1", "(n, 2, 3) unit axes, in the parent's and in the child's frame"),
    Column("joints/axes_covariance", "float64", "1", "(n, 2, 3, 3) covariance of the axes; NaN: no such axis"),
    Column("joints/offset", "float64", "1", "(n, 3, 3) constant rotation between the axes"),
    Column("joints/glide", "float64", "m", "(n, 3) shift of the centre at an elevation of 180 degrees"),
    Column("joints/glide_covariance", "float64", "m^2", "(n, 3, 3) covariance of the glide"),
    Column("joints/rest", "float64", "1", "(n, 3) direction in the parent from which the elevation is measured"),
    Column("joints/long_axis", "float64", "1", "(n, 3) direction in the child whose elevation is measured"),
    Column("joints/untwisted", "float64", "1", "(n, 3, 3) rotation at which the skin of the child is not twisted"),
    Column("joints/known", "bool", "", "(n,) the centre follows from the motion"),
    Column("joints/slide_sd", "float64", "m", "(n,) slide of whole clusters on the bones, per axis; 0: none"),
    Column("markers/on_glide", "bool", "", "(M,) the marker moves with the glide of the first joint"),
    Column(
        "markers/skin",
        "float64",
        "1",
        "(M,) share of the axial rotation that the skin does not follow",
    ),
    Column("markers/skin_sd", "float64", "1", "(M,) standard deviation of this share"),
    Column("landmarks/name", "str", "", "(L,) names of the anatomical landmarks"),
    Column("landmarks/segment", "int64", "", "(L,) segment of each landmark"),
    Column("landmarks/local", "float64", "m", "(L, 3) coordinates in the segment frame"),
    Column("landmarks/sd", "float64", "m", "(L,) standard deviation of each coordinate"),
)
"""Nodes of chain.h5."""

POSES_IN_SPACE = (
    Column("{name}_qw", "float64", "1", "in space: rotation of the segment's frame, unit quaternion, scalar"),
    *(Column(f"{{name}}_q{axis}", "float64", "1", f"unit quaternion, {axis}") for axis in "xyz"),
    *(Column(f"{{name}}_{axis}", "float64", "m", f"origin of the segment, {axis}") for axis in "xyz"),
    *(Column(f"{{name}}_omega_{axis}", "float64", "rad/s", f"angular velocity along {axis}") for axis in "xyz"),
    *(Column(f"{{name}}_alpha_{axis}", "float64", "rad/s^2", f"angular acceleration along {axis}") for axis in "xyz"),
    Column("sd_{name}_rotation", "float64", "rad", "standard deviation of the rotation per axis"),
    Column("sd_{name}_omega", "float64", "rad/s", "standard deviation of the angular velocity per axis"),
    Column("sd_{name}_alpha", "float64", "rad/s^2", "standard deviation of the angular acceleration per axis"),
    Column("{name}_observed", "bool", "", "estimated from markers in this frame; false = bridged"),
)
"""Columns of poses.parquet for one segment."""

ANGLE = (
    Column("sd_dd{name}", "float64", "rad/s^2", "standard deviation of the acceleration"),
    Column("{name}", "float64", "rad", "angle, signs as in the page on ISB frames"),
    Column("d{name}", "float64", "rad/s", "velocity"),
    Column("dd{name}", "float64", "rad/s^2", "acceleration"),
    Column("sd_{name}", "float64", "rad", "standard deviation of its changes, by camera and skin"),
    Column("sd_d{name}", "float64", "rad/s", "standard deviation of the velocity"),
    Column("constant_sd_{name}", "float64", "rad", "standard deviation of a constant error, by the landmarks"),
)
"""Columns of angles.parquet for one angle."""
