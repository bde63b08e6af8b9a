"""Explanations of reasons about force plates, the chair, other force sensors and repetitions."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

CONTACT: Mapping[str, Explanation] = {
    "no-plate": Explanation(
        ("caution",),
        "No force plate under the feet",
        "The skeleton and the joint states are valid without force plates. Masses, moments of inertia and torques "
        "need the ground reaction wrench, so they are null.",
        "Record with a force plate. If the file has one, say which plate is under the feet: `plates: {feet: [1]}`.",
        "planarise",
        "The file has no usable force plate.",
    ),
    "no-wrench": Explanation(
        ("caution",),
        "No ground reaction wrench",
        "No sample has a usable ground reaction wrench. There are therefore no inertial parameters, no modelled wrench "
        "and no torques. The kinematics are valid.",
        "See the other reasons of this trial; the cause is usually `no-plate`.",
        "identify-dim",
        "`planarise` found no usable plate.",
    ),
    "no-common-samples": Explanation(
        ("caution",),
        "Forces and angles are never known together",
        "The wrench is known only when the joint angles are unknown, and the reverse. Nothing can be identified.",
        "Choose a `window:` in which the markers are visible and the person stands on the plates.",
        "identify-dim",
        "Time with both wrench and angles known, s.",
    ),
    "too-few-samples": Explanation(
        ("caution",),
        "Too few samples for identification",
        "Samples with chair contact, near gaps and near the ends of the recording are excluded, because filtering "
        "would spread their errors. The remaining samples are too few.",
        "Make a longer recording, with fewer gaps or longer standing phases.",
        "identify-dim",
        "Time without chair contact and beyond the filter's reach around gaps, s.",
    ),
    "contact-rule": Explanation(
        ("caution",),
        "Chair contact is only roughly known",
        "Chair contact could not be found from the chair's force: too few samples are clearly off the chair, or Fy, "
        "which shows that force, is not fitted. A cruder rule was used. Some samples with contact may have been used "
        "in the identification and may bias it.",
        "Record longer standing phases, fit Fy, or choose the rule with `identify-dim: {contact: …}`.",
        "identify-dim",
        "The rule of `identify-dim: {contact}` needs Fy in `identify-dim: {components}` and samples off the chair.",
    ),
    "contact-unknown": Explanation(
        ("caution",),
        "Chair contact is unknown",
        "The plates have no reading while the person stands, or none while the hips are low. It is therefore not known "
        "whether a chair carries part of the body. Only samples with a straight knee were used. This is safe, but "
        "excludes the most informative part of the movement.",
        "Record with plate readings throughout, or choose a `window:` that has them.",
        "identify-dim",
        "No plate reading while the person stands, or none while the hips are low.",
    ),
    "contact-unsettled": Explanation(
        ("caution",),
        "Chair contact did not converge",
        "A model gives the contact, and the samples without contact give the next model. This is repeated until both "
        "stay the same; here they kept changing. Some samples with contact may have been used, or some without "
        "contact excluded.",
        "Compare seat-off and seat-on with the figure of the repetitions; try `identify-dim: {contact: weight}`.",
        "identify-dim",
        "Contact still changes by more than 0.02 s after 8 iterations.",
    ),
    "not-free": Explanation(
        ("caution",),
        "A chair may carry part of the body throughout",
        "In a sit-to-stand trial without a rise, the person may be seated all the time. The force of the chair is not "
        "measured, and parameters from the remaining weight would be far too small, so none are given.",
        "Use a `window:` in which the person rises and stands.",
        "identify-dim",
        "No sample is certain to be off the chair.",
    ),
    "no-repetitions": Explanation(
        ("caution",),
        "No repetition found",
        "The trial is declared as a sit-to-stand, but the body does not rise and descend enough for one. Parameters "
        "are identified only if the markers show that the person stands.",
        "Use a window with at least one whole rise. If this is another movement without a chair, set "
        "`protocol: free`. Otherwise check the segments and the vertical axis.",
        "identify-dim",
        "Rise of the joint that moves up and down most, m; limit 15 % of the leg length.",
    ),
    "no-chair": Explanation(
        ("ok",),
        "No chair",
        "The feet carry the whole weight all the time, as in squats. The repetitions have no seat-off and seat-on.",
        "Nothing, if there was no chair. If there was one, its plate was taken for one under the feet: see `plates:`.",
        "identify-dim",
        "The feet never carry less than 80 % of the weight.",
    ),
    "attempt-failed": Explanation(
        ("caution",),
        "Failed attempt to rise",
        "The hips left the seat, or the feet took over at least 40 % of the chair's load, and the person fell back. A "
        "failed attempt is not a repetition. Between two counted rises, its duration is part of the five-times test "
        "time. Its samples count as chair contact and do not affect the identification.",
        "Look at the times in the table of attempts. Record again if the rules of the test require it.",
        "identify-dim",
        "Number of rises that end before standing: the hips rise by 8 %, or the feet take over 40 % of the chair load.",
    ),
    "rise-partial": Explanation(
        ("caution",),
        "A rise does not reach standing",
        "The hips stay below 90 % of the height that they reach elsewhere in the trial. The repetition is listed as "
        "incomplete and is not counted in the five-times test. Parameters identified from it are valid.",
        "If every rise is partial, the highest one counts as standing, because the recording shows nothing else. "
        "Record quiet upright standing too.",
        "identify-dim",
        "Greatest height, as a share of the rise from seat to standing; limit 0.9.",
    ),
    "rise-paused": Explanation(
        ("caution",),
        "A rise pauses midway",
        "The person is still for 0.3 s or longer between the seat and standing. The events are those of the whole "
        "rise, and the five-times test times include the pause.",
        "Nothing is needed for the parameters. For the test, decide whether the trial counts.",
        "identify-dim",
        "Time in pauses of 0.3 s or longer with less than 8 % of the peak speed, s.",
    ),
    "support-unexplained": Explanation(
        ("caution",),
        "Unexplained external support",
        "During the rise, the plates measure at least 5 % of the weight less than the body's acceleration requires. A "
        "hand on an armrest or rail, or another person, may be helping. Without a plate under the chair, support is "
        "found only while the hips are above a quarter of the rise; below that, it looks like the chair. Pushing with "
        "the hands on one's own thighs is an internal force, which no plate can show.",
        "Record with the arms crossed, or measure the support and give it under `external:`.",
        "identify-dim",
        "Vertical force not explained by plates or chair, as a share of the weight; limit 0.05.",
    ),
    "repetition-cut": Explanation(
        ("ok",),
        "A repetition is cut off by the recording",
        "Events outside the recording are unknown. The repetition is kept and marked as incomplete.",
        "Record from quiet sitting to quiet sitting, or widen `window:`.",
        "identify-dim",
        "The recording begins or ends within a movement.",
    ),
    "seat-measured": Explanation(
        ("ok",),
        "The chair's force is measured",
        "The chair stands on its own force plate. The force on the thigh is the plate reading minus its reading while "
        "the person stands. Samples with chair contact are therefore used too, and joint torques include this force.",
        "Nothing. `identify-dim: {seat_segment: …}` selects another segment; `{seat_plate: false}` ignores the plate.",
        "identify-dim",
        "The plate under the chair has readings, and they agree with those of the plates under the feet.",
    ),
    "seat-contradiction": Explanation(
        ("caution",),
        "The force of the chair is inconsistent",
        "Ground and chair forces together must explain the movement of the body that was identified off the chair. "
        "Here this would need another size or sign of the chair's force. The chair's plate and the samples with chair "
        "contact were ignored.",
        "Check the plate's sign, corners and units. The whole chair, and nothing else, must stand on it.",
        "identify-dim",
        "Factor of the chair's wrench that fits the movement best; expected: 1 to within 4 standard deviations or 5 % "
        "of the weight.",
    ),
    "seat-zero-unknown": Explanation(
        ("caution",),
        "The chair's own weight is unknown",
        "The chair's weight is normally taken from its plate while the person stands; here nobody stands. Unless the "
        "plate was zeroed with the chair on it, the identified mass includes the chair.",
        "Record some quiet standing. If the plate was zeroed with the chair on it, set `planarise: {seat_zero: none}`.",
        "planarise",
        "Nobody stands for 0.2 s, so the chair's plate has no unloaded reading.",
    ),
    "plates-doubtful": Explanation(
        ("caution",),
        "The load on a plate contradicts its configured use",
        "While the person stands, plates under the feet stay loaded and a plate under a chair is unloaded. A plate "
        "named in the configuration does the opposite.",
        "Check `plates: {feet: …, seat: …}`. Plates are numbered from 1, in the order shown by `mocap-id inspect`.",
        "planarise",
        "The load of a plate named under `plates:` contradicts its use: a seat plate loaded, or a foot plate unloaded, "
        "while the person stands.",
    ),
    "external-contradiction": Explanation(
        ("caution",),
        "The force of a sensor is inconsistent",
        "All external forces together must explain the movement of the body. This sensor's force would have to be "
        "multiplied by the factor given; a factor of minus one means that the file holds the force of the body on the "
        "sensor. The force was used as given, so parameters and torques are wrong.",
        "Check `force:`, `at:`, `clock_offset_s:` and the axes of the file under `external:`.",
        "identify-dim",
        "Factor of the sensor's wrench, as for `seat-contradiction`.",
    ),
}
"""Explanation of each code."""
