"""What the force plates, the chair and the repetitions give rise to."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

CONTACT: Mapping[str, Explanation] = {
    "no-plate": Explanation(
        ("caution",),
        "No force plate under the feet",
        "Skeleton and joint states do not need one and hold. Masses, moments of inertia and torques need the ground's "
        "wrench, so they are null.",
        "Record with a force plate; where there is one, say which carries the feet: `plates: {feet: [1]}`.",
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
    "no-repetitions": Explanation(
        ("caution",),
        "Nobody rises",
        "The trial is declared a sit-to-stand, yet the body does not go up and down as one does. There are no "
        "repetitions. Only if the markers show that the person stands is anything identified.",
        "Use a window that holds a whole rise. Set `protocol: free` if the movement is another and without a chair; "
        "otherwise check the segments and the vertical axis.",
    ),
    "no-chair": Explanation(
        ("ok",),
        "No chair",
        "The feet carry the whole weight all the time, as in squats: the repetitions have no seat-off and seat-on.",
        "Nothing, unless there was a chair: then its plate was taken for one of the feet's (`plates:`).",
    ),
}
