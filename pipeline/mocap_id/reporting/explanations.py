"""What every code of a verdict means and what to do about it, for people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mocap_id.verdict import Level


@dataclass(frozen=True)
class Explanation:
    """A code in plain words.

    Parameters
    ----------
    levels : tuple of str
        The levels that it may come with, the gravest first.
    title : str
        What happened, as a headline.
    meaning : str
        What follows from it for the numbers.
    action : str
        What to do.
    """

    levels: tuple[Level, ...]
    title: str
    meaning: str
    action: str


EXPLANATIONS: Mapping[str, Explanation] = {
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
    "bursts": Explanation(
        ("ok",),
        "Markers jump",
        "Some samples jump away from their marker's track and back within 0.4 s: a wrong reconstruction, not a "
        "movement. They are left out before the segments are sought.",
        "Nothing, if they are few. Otherwise look at that marker in the cameras' own software.",
    ),
    "marker-swap": Explanation(
        ("caution", "ok"),
        "Two markers carry each other's label",
        "Two trajectories exchange their places at once, and the distances to the markers around them hold only if the "
        "labels are exchanged too. The labels that the file begins with count as right. Left as they are (caution), "
        "swapped markers spoil the segments, the joints and everything after them; exchanged back (note), they do no "
        "harm.",
        "Compare the frames that are named with the cameras' own software and relabel there, or give `planarise: "
        "{repair_swaps: true}`. Your file is never changed.",
    ),
    "upside-down": Explanation(
        ("caution",),
        "The chain hangs below its base",
        "The moving segments are lower than the markers that stay still. For a person that means a wrong vertical "
        "axis, and then gravity, forces and mass are wrong too. A robot may hang.",
        "Set `planarise: {vertical: …}`, or ignore this for a chain that really hangs.",
    ),
    "too-few-frames": Explanation(
        ("refused",),
        "Too few frames",
        "The joints are fitted to frames that show at least two markers of every segment, and there are not enough.",
        "Use a longer `window:`, or fill the gaps of the segment that is seen least.",
    ),
    "encoder-unused": Explanation(
        ("ok",),
        "The encoder is not read",
        "The configuration names an encoder's file. This version estimates the states from the markers alone.",
        "Nothing; the file can stay named.",
    ),
    "segments-unsure": Explanation(
        ("caution",),
        "The segments are doubtful",
        "Another reading of the same markers fits nearly as well. If the segments are wrong, every number after them "
        "is.",
        "Compare the skeleton with the person. If it is right, give `segment: {count: …}` to settle it; if it is "
        "wrong, give the count that is right, or add markers to the segment that was missed.",
    ),
    "estimator": Explanation(
        ("caution",),
        "Joints fitted for comparison",
        "The configuration asks for an estimator that is kept to be compared with. On the whole its joints lie further "
        "off than those of the whole chain's fit (docs/link-by-link.md), and so does what follows from them.",
        "Leave `fit-joints: {estimator: …}` away, unless the comparison is what you want.",
    ),
    "small-arc": Explanation(
        ("caution",),
        "A joint hardly turned",
        "Skin that slips over the bone looks like a joint that lies elsewhere, the more so the less the joint turns. "
        "The centre may be off by more than its standard deviation says, and with it the lengths on either side.",
        "Use or record a movement with more of this joint in it; a deep squat serves ankle, knee and hip.",
    ),
    "gap": Explanation(
        ("caution",),
        "A joint was out of sight for long",
        "While no marker tells the angle of a joint its uncertainty grows; beyond the limit no value is given, and "
        "nothing is identified from that stretch or near it. Shorter gaps are bridged and shaded in the figure.",
        "Fill or re-label the missing markers, or leave the stretch out with `window:`.",
    ),
    "no-plate": Explanation(
        ("caution",),
        "No force plate under the feet",
        "Skeleton and joint states do not need one and hold. Masses, moments of inertia and torques need the ground's "
        "wrench, so they are null.",
        "Record with a force plate; where there is one, say which carries the feet: `plates: {feet: [1]}`.",
    ),
    "plate-unit-assumed": Explanation(
        ("caution",),
        "The unit of a force plate was assumed",
        "The file does not say in which unit the plate under the feet measures, so that of the format's custom was "
        "taken: N, and the file's unit of length. If it is another, every force, mass or moment is wrong by a constant "
        "factor, and nothing else shows it.",
        "Compare the mass in the report with the person's. Then give `planarise: {force_unit: …, moment_unit: …}`, "
        "which also settles the matter where the assumption is right.",
    ),
    "no-wrench": Explanation(
        ("caution",),
        "Nothing to identify from",
        "No sample has a usable wrench of the ground, so there are no inertial parameters, no model wrench and no "
        "torques. The kinematics hold.",
        "See the reason that stands with it, usually `no-plate`.",
    ),
    "no-common-samples": Explanation(
        ("caution",),
        "Forces and angles are not known together",
        "The wrench is known when the joint angles are not, and the other way round, so that nothing can be "
        "identified.",
        "Choose a `window:` in which the markers are seen and the person stands on the plates.",
    ),
    "too-few-samples": Explanation(
        ("caution",),
        "Too little to identify on",
        "Samples with the chair in contact, near gaps and near the ends are left out, since the filter would carry "
        "their errors over. What remains is too short.",
        "Record longer, with fewer gaps, or with longer standing phases.",
    ),
    "standing-still": Explanation(
        ("caution",),
        "Only the mass is known",
        "The joints move while the chair carries part of the weight, and rest where the ground alone carries it. A "
        "body at rest shows its mass and where its weight acts, nothing more.",
        "Record a movement without the chair, such as squats, or more repetitions of the sit-to-stand.",
    ),
    "not-excited": Explanation(
        ("caution",),
        "A joint rests",
        "Segments on either side of a joint that rests move as one, and so do their parameters: the wrench cannot "
        "tell them apart. No parameters are given, because any would be a guess.",
        "Record a movement of every joint, or lower the number of segments with `segment: {count: …}`.",
    ),
    "clock-offset-unknown": Explanation(
        ("caution",),
        "The clocks of cameras and plates may differ",
        "One millisecond between the clocks costs up to a third of a base parameter. Here the offset could not be "
        "found, so it was taken as zero, and the parameters are only as good as that assumption.",
        "Check that markers and forces belong to the same trial; record a faster movement, in which the clocks show; "
        "or widen `identify-dim: {clock_offset_limit_s: …}`.",
    ),
    "parameters-bounded": Explanation(
        ("caution",),
        "Only an impossible body would fit better",
        "Masses cannot be negative. Parameters held to that fit clearly worse than free ones, which means that "
        "something before them is wrong: a joint, a marker's segment, the plate's calibration, or mass that lies far "
        "outside the markers.",
        "Look at the skeleton and the residuals first, then at the plates' use and calibration.",
    ),
    "parameters-weak": Explanation(
        ("caution",),
        "Some base parameters are weakly known",
        "Their standard deviation is large against their size: the movement hardly shows them. The others, and the "
        "wrench that all of them predict for this movement, hold.",
        "Use them with their intervals, or record a faster and larger movement of the segments concerned.",
    ),
    "mass-contradiction": Explanation(
        ("caution",),
        "Two masses disagree",
        "The mass that was identified and the subject's as given differ by more than scales do. One of them is wrong, "
        "and every force with it if it is the plates'.",
        "Check the plates' calibration and zero, what else stands on them, whether one carries the chair, and the mass "
        "in the trial file.",
    ),
    "contact-rule": Explanation(
        ("caution",),
        "The chair's contact is a rough guess",
        "The chair's contact could not be found from its force: too few samples are surely off it, or Fy, in which "
        "that force shows, is not fitted. A cruder rule was used. Some contact may have slipped into the "
        "identification and bias it.",
        "Record longer standing phases, fit Fy, or choose the rule with `identify-dim: {contact: …}`.",
    ),
    "contact-unknown": Explanation(
        ("caution",),
        "The plates do not show the chair",
        "The plates have no reading while the person stands, or none while the person is low, so it is not known "
        "whether a chair carries part of the body. Only samples with a straight knee were identified on, which is safe "
        "and leaves out the most telling part of the movement.",
        "Record so that the plates are read throughout, or choose a `window:` where they are.",
    ),
    "contact-unsettled": Explanation(
        ("caution",),
        "The chair's contact did not settle",
        "The contact is found with a model and the model without the contact, in turns, until neither changes. Here "
        "they kept changing: some contact may have slipped into the identification, or free samples were left out.",
        "Compare seat-off and seat-on with the figure of the repetitions; try `identify-dim: {contact: weight}`.",
    ),
    "not-free": Explanation(
        ("caution",),
        "A chair may carry part of the body throughout",
        "In a sit-to-stand without a rise the person may be seated all the time, and what the chair carries is not "
        "measured. Parameters from the rest of the weight would be far too small, so none are given.",
        "Use a `window:` in which the person rises and stands.",
    ),
    "components-short": Explanation(
        ("caution",),
        "The fitted components do not tell everything",
        "Base parameters from a part of the wrench decide what that part feels. Other components, the centre of "
        "pressure and some torques depend on parameters that stay open, so they are left empty.",
        "Fit Fy and tauz at least, which decide all of them.",
    ),
    "load-shared": Explanation(
        ("caution",),
        "The body moves with less mass than it stands with",
        "The mass that was identified is not the one that the plates show in standing. Most often a chair, or a hand "
        "on a support, carried a part of the body in samples that were identified on, and all parameters are wrong "
        "with it.",
        "For a movement from a chair set `protocol: sit-to-stand`; otherwise give a `window:` without the support.",
    ),
    "no-repetitions": Explanation(
        ("caution",),
        "Nobody rises",
        "The trial is declared a sit-to-stand, yet the body does not go up and down as one does. There are no "
        "repetitions. Only if the markers show that the person stands is anything identified.",
        "Use a window that holds a whole rise. Set `protocol: free` if the movement is another and without a chair; "
        "otherwise check the segments and the vertical axis.",
    ),
    "recording-oddity": Explanation(
        ("ok",),
        "Something odd in the file",
        "The file contradicts itself or its format in a way that could be read around, as the message says.",
        "Compare with what you know of the recording; `mocap-id inspect FILE` shows all that the file holds.",
    ),
    "window-proposed": Explanation(
        ("ok",),
        "Only a part of the recording was used",
        "People walk on and off. The longest part in which markers stay put was taken, because a chain needs a base.",
        "Give `window: [from, to]`, in seconds of the recording's clock, to choose another part.",
    ),
    "facing-unsure": Explanation(
        ("ok",),
        "Which way the person faces is unsure",
        "A plane has two sides. If the wrong one was taken, x, every angle, Fx, the moment and the centre of pressure "
        "have the other sign; sizes do not change.",
        "Compare the skeleton with the person; if it is mirrored, give `planarise: {facing: +x}`.",
    ),
    "mass-unchecked": Explanation(
        ("caution",),
        "The mass is not checked",
        "A chair or a support that carries a part of the body shows when the identified mass is held against the "
        "standing one. Here nobody is shown to stand, and no mass was given.",
        "Give `subject: {mass: …}`, or record some quiet standing; for a movement from a chair set "
        "`protocol: sit-to-stand`.",
    ),
    "no-chair": Explanation(
        ("ok",),
        "No chair",
        "The feet carry the whole weight all the time, as in squats: the repetitions have no seat-off and seat-on.",
        "Nothing, unless there was a chair: then its plate was taken for one of the feet's (`plates:`).",
    ),
    "reference-assumed": Explanation(
        ("ok",),
        "The reference body rests on assumptions",
        "Height or mass were not given, so the allometric body that the results are compared with uses values from the "
        "recording itself. The identified parameters do not depend on it.",
        "Give `subject: {height: …, mass: …, sex: …}`.",
    ),
    "no-reference": Explanation(
        ("ok",),
        "No reference body",
        "There is no allometric body to compare with; the identified parameters do not depend on one.",
        "Give `subject:`; the tables describe people of four or five segments only.",
    ),
    "solver-fallback": Explanation(
        ("ok",),
        "The second solver's answer was taken",
        "Two solvers look for the same point masses. The first one's answer failed the check of optimality, the second "
        "one's passed it: the result is as good as ever.",
        "Nothing.",
    ),
    "joint-uncertain": Explanation(
        ("caution",),
        "A joint centre is uncertain",
        "The markers on either side do not determine the centre well: they are few, close together, noisy or rarely "
        "seen. Lengths and angles that rest on it carry the same uncertainty.",
        "Spread more markers over the two segments, or use a longer part of the recording.",
    ),
}

LEVELS: Mapping[Level, tuple[str, str]] = {
    "ok": ("Good", "Every check passed: the numbers below can be used, each with the interval that stands beside it."),
    "caution": (
        "Usable with care",
        "The trial went through, but what is listed here limits what can be concluded from it.",
    ),
    "refused": (
        "Refused",
        "This recording is not what the method can treat. That is a finding, not a failure of the program: below is "
        "why, what to change, and what the recording shows all the same.",
    ),
}
"""Headline and first sentence for each level of a verdict."""


def as_markdown() -> str:
    """The codes as a chapter of the documentation."""
    order: tuple[Level, ...] = ("refused", "caution", "ok")
    names = {"refused": "refused", "caution": "caution", "ok": "note"}
    entries = sorted(EXPLANATIONS.items(), key=lambda item: (order.index(item[1].levels[0]), item[0]))
    parts = (
        f"### `{code}`: {entry.title}\n\n"
        f"*{' or '.join(names[level] for level in entry.levels)}*\n\n"
        f"{entry.meaning}\n\n**What to do.** {entry.action}\n"
        for code, entry in entries
    )
    return "\n".join(parts)
