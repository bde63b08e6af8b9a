"""What finding the segments, their joints and the joint states gives rise to."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

SKELETON: Mapping[str, Explanation] = {
    "no-fixed-base": Explanation(
        ("refused",),
        "No fixed base",
        "The method measures everything from a segment that stays on the ground. In this recording nothing does: "
        "people walk, jump, or step during the part that was used.",
        "Give a `window:` in which the feet stay put, or record such a part with markers on the feet or the plate.",
    ),
    "no-motion": Explanation(
        ("refused",),
        "No joint moves",
        "A joint is found by its motion. Nothing here turns enough to place one, so there are no segments, states or "
        "inertial parameters; the mass and the centre of pressure that the plates show still hold.",
        "Record a movement that bends every joint of interest by 15° or more; a static pose is no substitute.",
    ),
    "no-chain": Explanation(
        ("refused",),
        "No chain on the base",
        "Bodies move, but none of them turns about a point that is fixed to the base within the limits, so no serial "
        "chain can be built.",
        "Check that the base carries markers, that the window holds one movement only, and that the motion is planar.",
    ),
    "not-planar": Explanation(
        ("refused", "caution"),
        "The motion leaves its plane",
        "The chain is planar: motion across the plane is not modelled. A little of it (caution) makes angles and "
        "lengths those of the projection, with lengths somewhat short; much of it (refused) leaves nothing to fit.",
        "Leave out the part that turns, steps or leans sideways (`window:`), or record the movement facing one way.",
    ),
    "segments-unsure": Explanation(
        ("caution",),
        "The segments are doubtful",
        "The confidence is the chance, 0 to 1, that count and assignment of the segments are right. Below 0.5 they are "
        "more likely wrong, and with them every number that follows. Evidence takes it down: a segment that could be "
        "left out at little cost, moving markers on no segment, a still marker that might as well be on the other side "
        "of the first joint, a first joint that is no fixed point, still markers that hardly stand out, another number "
        "of segments that fits about as well; the report shows what each takes off. The same code tells of left and "
        "right that turn differently, where one segment stands for both.",
        "Compare the skeleton with the person, and read in the report which other segments were weighed up and why "
        "they lost. If it is right, the numbers hold. If it is wrong, say what you know under `segment:`: the `count`, "
        "markers that are `together` on one segment or `apart` on different ones, markers to `ignore`. `names` renames "
        "the segments, and `joint_markers` name markers about a joint, which place its centre.",
    ),
    "too-few-frames": Explanation(
        ("refused",),
        "Too few frames",
        "The joints are fitted to frames that show at least two markers of every segment, and there are not enough.",
        "Use a longer `window:`, or fill the gaps of the segment that is seen least.",
    ),
    "estimator": Explanation(
        ("caution",),
        "Joints fitted for comparison",
        "The configuration asks for an estimator that is kept to be compared with. On the whole its joints lie further "
        "off than those of the whole chain's fit (docs/link-by-link.md), and so does what follows from them.",
        "Leave `fit-joints: {estimator: …}` away, unless the comparison is what you want.",
    ),
    "joint-markers": Explanation(
        ("ok",),
        "Markers pull a joint's centre",
        "Markers that `segment: {joint_markers: …}` names draw the centre of their joint towards their middle (3.15), "
        "with the weight λ_A (3.16). That helps where skin has slipped over a joint that turns little, and spoils a "
        "centre that the motion places well. The standard deviation does not say how far their middle is from the "
        "joint.",
        "Compare with a run without `joint_markers`; `fit-joints: {lambda_a: …}` sets the weight. Leave them away for "
        "a joint that turns by much.",
    ),
    "small-arc": Explanation(
        ("caution",),
        "A joint hardly turned",
        "Skin that slips over the bone looks like a joint that lies elsewhere, the more so the less the joint turns. "
        "The centre may be off by more than its standard deviation says, and with it the lengths on either side.",
        "Use or record a movement with more of this joint in it; a deep squat serves ankle, knee and hip.",
    ),
    "joint-uncertain": Explanation(
        ("caution",),
        "A joint centre is uncertain",
        "The markers on either side do not determine the centre well: they are few, close together, noisy or rarely "
        "seen. Lengths and angles that rest on it carry the same uncertainty.",
        "Spread more markers over the two segments, or use a longer part of the recording.",
    ),
    "gap": Explanation(
        ("caution",),
        "A joint was out of sight for long",
        "While no marker tells the angle of a joint its uncertainty grows; beyond the limit no value is given, and "
        "nothing is identified from that stretch or near it. Shorter gaps are bridged and shaded in the figure.",
        "Fill or re-label the missing markers, or leave the stretch out with `window:`.",
    ),
    "states-method": Explanation(
        ("caution",),
        "States estimated for comparison",
        "The configuration asks for a way to the joint states that is kept to be compared with. On the whole its "
        "velocities and accelerations lie further off than those of the filter and its smoother "
        "(docs/states-compared.md), and so do the inertial parameters. The low-pass and the spline know no standard "
        "deviations: those of the states, and of the wrench and torques that rest on them, are missing.",
        "Leave `ukf-smooth: {method: …}` away, unless the comparison is what you want.",
    ),
}
