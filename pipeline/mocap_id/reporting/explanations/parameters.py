"""What identifying the inertial parameters gives rise to."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

PARAMETERS: Mapping[str, Explanation] = {
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
    "clocks-disagree": Explanation(
        ("caution",),
        "The repetitions disagree about the clocks",
        "Each fit that leaves a repetition out finds the offset between cameras and plates anew. These offsets differ "
        "by more than 5 ms, and 5 ms change a base parameter by a fifth and more. Either one of the clocks drifts, or "
        "the model does not follow the movement and the offset makes up for it.",
        "Check how cameras and plates are synchronised, and look for dropped frames. Compare the offset with other "
        "trials of the same session: it should be the same. If the clocks are sound, look at the joints' gaps and at "
        "the residuals of the markers.",
    ),
    "clock-offset-kept": Explanation(
        ("caution",),
        "A clock offset is known and left in",
        "The offset between cameras and plates was found, and the settings ask not to take it out. Regressor and "
        "wrench then belong to different moments, and the parameters answer for it.",
        "Leave `identify-dim: {apply_clock_offset: false}` away, or correct the clocks before.",
    ),
    "joint-gives-way": Explanation(
        ("ok",),
        "A joint gives way",
        "The chain pins two segments together at a point. Here their markers show two poses that part at this point: a "
        "pelvis moves on the hip, a back bends, skin slides. Pins would hide how the mass really moved, so every body "
        "of the dynamics moves as its own markers were measured. The report's part “Motion of the masses” shows what "
        "pins would cost.",
        "Nothing, where the gap is usual: the hips of people part by 6 to 16 mm. Where it is larger, look at the "
        "skeleton: a marker may be on the wrong segment, or the joint in the wrong place.",
    ),
    "parameters-bounded": Explanation(
        ("caution",),
        "Only an impossible body would fit better",
        "Masses cannot be negative. Parameters held to that fit clearly worse than free ones, which means that "
        "something before them is wrong: a joint, a marker's segment, the plate's calibration, or mass that lies far "
        "outside the markers.",
        "Look at the skeleton and the residuals first, then at the plates' use and calibration.",
    ),
    "held-out-worse": Explanation(
        ("caution",),
        "No better than a table",
        "Each repetition was predicted by a model that was fitted to the others. For the quantities that are named, "
        "a body from a table that knows height and mass alone predicts them as well or better. The individual model is "
        "then not worth its name there: what joints, markers, skin, or limbs that move by themselves leave unexplained "
        "is larger than what this person differs from the table. The error within the fit does not show that.",
        "Look at the residuals of the markers, and for arms or a head that move: a limb outside the chain is not "
        "modelled, so keep the arms still against the trunk. A slower movement asks less of the chain. For what is "
        "named, use the table's values.",
    ),
    "held-out-far": Explanation(
        ("caution",),
        "The model does not carry over to other repetitions",
        "Each repetition was predicted by a model that was fitted to the others, and is off by far more than the fit "
        "to all of them. Either the parameters follow what is particular to single repetitions, because few of them "
        "tell many parameters, or one repetition differs from the rest: a step, a hand on the knee, a marker lost.",
        "Record more repetitions, or leave the odd one out with `window:`. Believe the error on the held-out "
        "repetitions, not the one within the fit.",
    ),
    "parameters-weak": Explanation(
        ("caution",),
        "Some base parameters are weakly known",
        "Their standard deviation is above a fifth of their size: the movement hardly shows them. Above their whole "
        "size they count as not identifiable. The others, and the wrench that all of them predict for this movement, "
        "hold.",
        "Use them with their intervals, or record the movement that the reason names: it is computed from this trial's "
        "own regressor (docs/reading-the-dynamics.md).",
    ),
    "mass-contradiction": Explanation(
        ("caution",),
        "Two masses disagree",
        "The mass that was identified and the subject's as given differ by more than scales do. One of them is wrong, "
        "and every force with it if it is the plates'.",
        "Check the plates' calibration and zero, what else stands on them, whether one carries the chair, and the mass "
        "in the trial file.",
    ),
    "mass-unchecked": Explanation(
        ("caution",),
        "The mass is not checked",
        "A chair or a support that carries a part of the body shows when the identified mass is held against the "
        "standing one. Here nobody is shown to stand, and no mass was given.",
        "Give `subject: {mass: …}`, or record some quiet standing; for a movement from a chair set "
        "`protocol: sit-to-stand`.",
    ),
    "load-shared": Explanation(
        ("caution",),
        "The body moves with less mass than it stands with",
        "The mass that was identified is not the one that the plates show in standing. Most often a chair, or a hand "
        "on a support, carried a part of the body in samples that were identified on, and all parameters are wrong "
        "with it.",
        "For a movement from a chair set `protocol: sit-to-stand`; otherwise give a `window:` without the support.",
    ),
    "components-short": Explanation(
        ("caution",),
        "The fitted components do not tell everything",
        "Base parameters from a part of the wrench decide what that part feels. Other components, the centre of "
        "pressure and some torques depend on parameters that stay open, so they are left empty. A joint inside one "
        "body of measured poses, as between pelvis and trunk, has no torque, whichever components are fitted.",
        "Fit at least Fy and tauz: they give all torques but the one inside a body.",
    ),
    "reference-assumed": Explanation(
        ("ok",),
        "The reference body rests on assumptions",
        "Height or mass were not given, so the allometric body that the results are compared with uses values from the "
        "recording itself. On the pinned chain the identified parameters depend on it only with `identify-dim: "
        "{reference_pulls: true}`. On measured poses it is the mean of a loose prior: the table of base parameters "
        "shows the prior's share.",
        "Give `subject: {height: …, mass: …, sex: …}`.",
    ),
    "no-reference": Explanation(
        ("ok",),
        "No reference body",
        "There is no allometric body to compare with. On the pinned chain the identified parameters do not depend on "
        "one; on measured poses the loose prior shares the mass evenly between the bodies instead.",
        "Give `subject:`; the tables describe people of four or five segments only.",
    ),
    "cone-unproven": Explanation(
        ("caution",),
        "The grid took the cone's place",
        "The exact set of bodies that can exist was asked for, and the solver's answer there failed the check of "
        "optimality. The parameters are those of point masses on the grid, which are as possible and fit as well or "
        "slightly worse.",
        "Set `identify-dim: {consistency: grid}`, or look at the skeleton: joints in one place or units "
        "that are off make such problems.",
    ),
    "solver-unproven": Explanation(
        ("caution",),
        "The parameters may not be the best ones",
        "No solver's answer passed the check of optimality. The one that came closest was taken; the reason says how "
        "far its cost may be above the least one.",
        "Look at the skeleton and the units. If they are right, a coarser `identify-dim: {grid: …}` is easier.",
    ),
    "solver-fallback": Explanation(
        ("ok",),
        "The second solver's answer was taken",
        "The first solver's point masses failed the check of optimality. A second one was asked, whose answer passed "
        "it: the result is as good as ever.",
        "Nothing.",
    ),
}
