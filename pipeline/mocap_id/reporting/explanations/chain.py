"""Explanations of reasons about segments, joints and joint states."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

CHAIN: Mapping[str, Explanation] = {
    "no-fixed-base": Explanation(
        ("refused",),
        "No fixed base",
        "The method needs a base segment that stays still on the ground. In this recording nothing does: the person "
        "walks, jumps or steps during the part that was used.",
        "Give a `window:` in which the feet stay still, or record such a part with markers on the feet or the plate.",
        "segment",
        "rms movement of the second stillest marker, m; limit `segment: {still_limit_m}`.",
    ),
    "no-motion": Explanation(
        ("refused",),
        "No joint moves",
        "Joints are located by their motion. No joint here turns enough, so there are no segments, joint states or "
        "inertial parameters. The mass and the centre of pressure measured by the plates are still valid.",
        "Record a movement that bends every joint of interest by at least 15°. A static pose is not enough.",
        "segment",
        "Every marker stays within `segment: {still_limit_m}`, or no two moving markers form a rigid body.",
    ),
    "no-chain": Explanation(
        ("refused",),
        "No chain attached to the base",
        "There are moving bodies, but none rotates about a point of the base within the limits, so no serial chain can "
        "be built.",
        "Check that the base carries markers, that the window holds only one movement, and that the motion is planar.",
        "segment",
        "Residual of the best joint on the base, m; limit `segment: {max_joint_residual_m}`. Residual of its body, m; "
        "limit `segment: {max_body_residual_m}`. Its arc, degrees; limit `segment: {min_arc_deg}`. Or there is no "
        "chain of `segment: {count}` segments.",
    ),
    "not-planar": Explanation(
        ("refused", "caution"),
        "The motion leaves the plane",
        "The model is planar; motion out of the plane is not modelled. If the share is small (caution), angles and "
        "lengths are those of the projection, and lengths are slightly too short. If it is large (refused), no chain "
        "is fitted.",
        "Exclude turning, stepping or leaning sideways (`window:`), or record the movement facing in one direction.",
        "segment",
        "Share of the chain's motion that is out of the plane; limits `segment: {planarity_caution}` and "
        "`segment: {planarity_limit}`.",
    ),
    "heel-lifts": Explanation(
        ("caution", "ok"),
        "The heels lift",
        "A foot turns about the toes while the person rises, so the ankle is not a fixed point. If the markers show "
        "the foot as a segment (note), the chain begins at the toes: ground, foot, shank, thigh. Otherwise (caution) "
        "the ankle's torque is wrong by the weight on the feet times the ankle's displacement, and angles of knee and "
        "hip may be wrong by some degrees.",
        "Record again with the heels on the ground, for example from a higher chair.",
        "segment",
        "Largest turn of the line between two markers on one foot, degrees; found from 3 with a rise of 12 mm.",
    ),
    "segments-unsure": Explanation(
        ("caution",),
        "The segments are uncertain",
        "The confidence is the probability, 0 to 1, that the number of segments and the assignment of markers are "
        "right. Below 0.5 they are more likely wrong, and so is every later result. It is reduced by: a segment that "
        "could be omitted at little cost; moving markers without a segment; a still marker that may belong to the "
        "other side of the first joint; a first joint that is not a fixed point; still markers that are hardly stiller "
        "than the others; another number of segments that fits almost as well. The report shows the effect of each. "
        "The same code reports that left and right turn differently although one segment represents both.",
        "Compare the skeleton with the person, and read in the report which other segmentations were considered and "
        "why they were rejected. If the skeleton is right, the numbers are valid. If it is wrong, say what you know "
        "under `segment:`: the `count`, markers that are `together` on one segment or `apart` on different segments, "
        "and markers to `ignore`. `names` renames the segments, and `joint_markers` lists markers around a joint, "
        "which help to locate its centre.",
        "segment",
        "Confidence, 0 to 1; limit 0.5. Or the angle between left and right, degrees rms; limit "
        "`segment: {asymmetry_deg}`.",
    ),
    "names-contradict": Explanation(
        ("ok", "caution"),
        "Marker names contradict the motion",
        "The labels are those of a known marker set (Plug-in Gait and usual synonyms), but the motion puts a marker on "
        "another segment than its name says: two labels are exchanged, a marker was placed differently, or the "
        "segments are wrong. The motion decides, names are only compared with it. It is a caution if the segments are "
        "not sure.",
        "Check the named markers in the camera software. If the names are right and the skeleton is wrong, set "
        "`segment: {count: …}`, or name markers that are `together` or `apart`.",
        "segment",
        "Number of such markers, if at least five names of the set are found; a caution below a confidence of 0.8.",
    ),
    "marker-frozen": Explanation(
        ("ok",),
        "A marker was frozen for some time",
        "The coordinates of a marker stand still in the laboratory while the other markers of its segment move: the "
        "software repeated its last position. These samples are left out of all results; the other samples of the "
        "marker are used.",
        "Nothing, if other markers of the segment were visible. Otherwise delete these samples in the camera software, "
        "or fill them from the markers beside it.",
        "segment",
        "The marker stays within 2 mm while its segment moves by more than 20 mm there. If exactly the same "
        "coordinates are repeated, the limit is 3 mm. The value is the duration, s.",
    ),
    "marker-moved": Explanation(
        ("ok",),
        "A marker changed its place",
        "A marker is at one place on its segment at first and at another one later: it fell off and was taped on "
        "again, or it was pushed. The longer part is used; the shorter one is left out of all results.",
        "Nothing, if other markers of the segment were visible. To use both parts, name them as two markers.",
        "segment",
        "One step of at least 15 mm, and 5 times the usual distance from the place. The value is the duration, s.",
    ),
    "marker-elsewhere": Explanation(
        ("ok",),
        "A marker was elsewhere for some time",
        "A marker jumps away from its place on its segment and later returns: its label was on another marker, or on a "
        "reflection. These samples are left out of all results; the other samples of the marker are used.",
        "Check the named times in the camera software, and relabel there.",
        "segment",
        "At least 15 mm away, and 5 times the usual distance from the place, with a jump before or after. The value is "
        "the duration, s.",
    ),
    "marker-ghost": Explanation(
        ("ok",),
        "A trajectory is no marker of the body",
        "A trajectory is on no segment and keeps its distance from no other moving marker, unlike the markers of a "
        "limb: it is a reflection or a passer-by, or the only marker of a limb. It is left out of all results.",
        "Delete it in the camera software, or list it under `planarise: {ignore: …}`.",
        "segment",
        "The distances from all other moving markers change by 20 to 40 mm or more. The value is the duration, s.",
    ),
    "joint-unsettled": Explanation(
        ("refused",),
        "The joint fit does not converge",
        "Joint centres and marker places are improved step by step until they no longer change. Here a centre still "
        "moves after 300 steps. Two segments that hardly turn relative to each other have no certain joint; this also "
        "happens if one segment was taken for two, or if markers are on the wrong segment.",
        "Look at the segments in the report. Set `segment: {count: …}`, name markers that are `together` or `apart`, "
        "or markers to `ignore`. Otherwise record larger movements of this joint.",
        "fit-joints",
        "Movement of the centre in the last iteration, m, if the cost still changes by more than 1e-7 of its size "
        "after 300 iterations.",
    ),
    "too-few-frames": Explanation(
        ("refused",),
        "Too few frames",
        "The joints are fitted to frames in which at least two markers of every segment are visible. There are too few "
        "such frames.",
        "Use a longer `window:`, or fill the gaps of the segment that is visible least.",
        "fit-joints",
        "Frames with at least two visible markers on every segment; at least 10 per joint.",
    ),
    "estimator": Explanation(
        ("caution",),
        "A joint estimator for comparison was used",
        "The configured estimator is provided for comparison only. Its joint centres, and all results that depend on "
        "them, are on the whole less accurate than those of the fit of the whole chain (docs/measured/accuracy.md).",
        "Remove `fit-joints: {estimator: …}` unless you want the comparison.",
        "fit-joints",
        "`fit-joints: {estimator}` is not the default.",
    ),
    "joint-markers": Explanation(
        ("ok",),
        "Markers pull a joint centre",
        "The markers in `segment: {joint_markers: …}` pull the centre of their joint towards their mean position "
        "(3.15), with weight λ_A (3.16). This helps when skin slides over a joint that turns little, and harms when "
        "the motion locates the centre well. The standard deviation includes 10 mm in each direction for the distance "
        "of their mean from the joint. In a conventional marker set, the markers at the ankle and the knee are found "
        "by their motion.",
        "Compare with a run without `joint_markers`; `fit-joints: {lambda_a: …}` sets the weight. Remove the "
        "markers of a joint that turns far.",
        "fit-joints",
        "`segment: {joint_markers}` lists markers, or the motion shows them; the value is λ_A.",
    ),
    "small-arc": Explanation(
        ("caution",),
        "A joint turned through a small angle",
        "Skin that slides over the bone shifts the joint centre, and more so for a small rotation. The error of "
        "the centre may exceed its standard deviation, and so may the errors of the lengths on either side.",
        "Use or record a movement that turns this joint farther; a deep squat suits ankle, knee and hip.",
        "fit-joints",
        "Arc of the joint (2.5 to 97.5 % of its angles), degrees; limit `fit-joints: {small_arc_deg}`.",
    ),
    "joint-uncertain": Explanation(
        ("caution",),
        "A joint centre is uncertain",
        "The markers on either side of the joint do not determine its centre well: they are few, close together, noisy "
        "or rarely visible. Lengths and angles that depend on this centre have the same uncertainty.",
        "Spread more markers over the two segments, or use a longer part of the recording.",
        "fit-joints",
        "Standard deviation of the centre, m; limit `fit-joints: {large_sd_m}`, or 5 mm for a joint that markers "
        "represent if a segment has a single marker, and for the first joint if the next segment has markers at fewer "
        "than three places: with the weight on it, 5 mm at the ankle are 3.5 N·m.",
    ),
    "gap": Explanation(
        ("caution",),
        "Long gap in a joint angle",
        "While no marker shows the joint angle, its uncertainty grows. Beyond the limit no value is given, and samples "
        "in or near that interval are not used for identification. Shorter gaps are bridged and shaded in the figure.",
        "Fill or re-label the missing markers, or exclude the interval with `window:`.",
        "ukf-smooth",
        "Time with a standard deviation of the angle above `ukf-smooth: {angle_sd_limit}`, s.",
    ),
    "prefiltered": Explanation(
        ("caution",),
        "The markers were filtered before the export",
        "Camera noise is present at all frequencies up to half the frame rate. Here the residuals of the markers end "
        "at the frequency in the message: a low-pass filter or resampling removed the rest, and fast movement with it. "
        "The intervals of the states include the noise that is left. Below 5 Hz the movement itself is changed: peaks "
        "of velocity and acceleration are too low, by an unknown amount, and the states have no intervals.",
        "Export the markers without a filter, at the rate of the cameras. The smoother of `ukf-smooth` adapts to the "
        "noise, so filtered markers never give better states.",
        "ukf-smooth",
        "Cut-off frequency of the residuals' spectrum, Hz; limit 12, without intervals below 5.",
    ),
    "repeated-frames": Explanation(
        ("caution", "ok"),
        "Frames are repeated",
        "In some frames every marker is exactly where it was in the frame before, although the person moves. This "
        "happens if frames were lost, or if a recording was resampled to a higher rate. These frames hold old "
        "positions and are left out of the states, which are bridged there. Below 1 % this is only a note.",
        "Export again at the rate of the cameras. If the frames were lost in the recording, check the load of the "
        "recording computer.",
        "ukf-smooth",
        "Share of frames that repeat the one before; limit 0.01.",
    ),
    "markers-oscillate": Explanation(
        ("caution",),
        "The markers of a segment oscillate together",
        "All markers of a segment move to and fro together, at one frequency, against the chain. Soft tissue that "
        "wobbles does this, and so does a loose plate with markers. The angles follow such a motion, which the bones "
        "do not make. Accelerations suffer most; their intervals include the oscillation.",
        "Fix the markers to bony places, or tape the plates on firmly. If the movement itself shakes at this "
        "frequency, check that the segments are rigid.",
        "ukf-smooth",
        "Largest rms oscillation of a segment's markers that is left in their residuals, m. The peak of its spectrum, "
        "from 2 to 15 Hz, is 10 times above both sides.",
    ),
    "states-method": Explanation(
        ("caution",),
        "A state estimator for comparison was used",
        "The configured method for the joint states is provided for comparison only. Its velocities and accelerations "
        "are on the whole less accurate than those of the filter and smoother (docs/measured/accuracy.md), and so are "
        "the inertial parameters. The low-pass filter and the spline give no standard deviations for the states, so "
        "those of the wrench and torques that depend on them are missing too.",
        "Remove `ukf-smooth: {method: …}` unless you want the comparison.",
        "ukf-smooth",
        "`ukf-smooth: {method}` is not the default.",
    ),
}
"""Explanation of each code."""
