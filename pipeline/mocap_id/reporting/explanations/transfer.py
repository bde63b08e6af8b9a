"""Explanations of the reasons given by ``mocap-id transfer``; they never occur in the verdict of a trial."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

TRANSFER: Mapping[str, Explanation] = {
    "transfer-worse": Explanation(
        ("caution",),
        "The transferred model is no better than a table",
        "`mocap-id transfer` predicted this trial with a body identified on another trial. For the named quantities, "
        "the reference body from a table, which needs only height and mass, predicts as well or better. Unmodelled "
        "effects or differences between the trials (limbs held or moved differently, joints placed differently, "
        "sliding markers) are larger than the differences between this person and the table.",
        "First check both trials for `held-out-worse`: a model that does not predict its own repetitions will not "
        "predict others. Then compare how the arms are held, the segments, and the distance between the joint "
        "positions (`joint_apart_m` of `--json`).",
        "transfer",
        "rms error of the transferred body, divided by that of the table's body; limit 1.",
    ),
    "transfer-not-at-home": Explanation(
        ("caution",),
        "The model is no better than a table on its own trial",
        "The body was identified on a trial whose left-out repetitions are predicted as well or better by the table's "
        "body, for the named quantities. There, the difference between the model and the table is no "
        "larger than the model's errors.",
        "See `held-out-worse` on the model's trial, and transfer the model of a better trial.",
        "transfer",
        "rms error on left-out repetitions of the model's own trial, divided by that of the table's body; limit 1.",
    ),
    "transfer-not-told-apart": Explanation(
        ("caution",),
        "The transferred model does not differ significantly from a table",
        "For the motion of the other trial, the transferred body and the table's body predict nearly the same moment "
        "or centre of pressure: the rms difference is less than two standard deviations of the transferred body's "
        "prediction. These come from the covariance of the body parameters. On a pinned chain, they come from the "
        "covariance of the base parameters and, for what the wrench does not determine, from 15 % of each full "
        "parameter (`identify-dim: {reference_sd: …}`). The forces of the other trial are not used.",
        "Record the model's trial with the movement to be predicted, more repetitions or a larger range; or use the "
        "table's body.",
        "transfer",
        "rms difference to the table's prediction, in standard deviations; at least 2.",
    ),
    "transfer-worse-than-stated": Explanation(
        ("caution",),
        "The transferred model is less accurate than it states",
        "`mocap-id transfer` states a standard deviation for its predictions. It combines the covariance of the "
        "parameters with the error on left-out repetitions of the model's trial, times 1.4 for another movement. The "
        "95 % intervals should contain 95 % of the measured samples; for the named quantities they contain less than "
        "80 %. The trials differ in something that the model's trial does not show: how the arms are held, replaced "
        "markers, or the zero of a plate.",
        "Do not rely on the stated standard deviations here. Compare how the arms are held and where the markers are "
        "in both trials, and include the movement to be predicted when you record the model's trial.",
        "transfer",
        "Share of samples within the stated 95 % intervals; at least 0.8.",
    ),
    "transfer-joints": Explanation(
        ("caution",),
        "The two trials place a joint differently",
        "Relative to the same markers, a joint of the same person has the same position to within a few centimetres of "
        "skin movement. Here the distance is larger. Mass that the wrench does not assign to one of the two "
        "adjacent segments is then in another place.",
        "Check both trials for `joint-uncertain` and `small-arc`. If a joint hardly bends in one of them, use fewer "
        "segments for both (`segment: {count: …}`).",
        "transfer",
        "Distance between the joint positions of the two trials, m; limit 0.03.",
    ),
    "transfer-markers": Explanation(
        ("caution",),
        "The markers are placed differently in the two trials",
        "`mocap-id transfer` registers each body of the model to the trial by their common markers. Here they do not "
        "fit: skin and posture explain about a centimetre, and this is more. The body is turned or shifted by the "
        "same amount. Arms and head change shape and are not checked.",
        "Compare the labels and positions of the body's markers in both recordings. Between sessions, markers are "
        "rarely placed on exactly the same spots.",
        "transfer",
        "rms distance of common markers after registration, m; limit 0.025.",
    ),
    "transfer-mass": Explanation(
        ("caution",),
        "The model has another mass than the person",
        "The mass of the transferred body is not the mass that the plates measure in this trial.",
        "Check that both trials are of the same person, without carried loads, and check the plate calibration.",
        "transfer",
        "The model's mass, kg; at most 5 % from the standing mass.",
    ),
    "transfer-nothing": Explanation(
        ("caution",),
        "Nothing to compare the transferred model with",
        "Errors are computed over the samples to which the trial's own model was fitted. Nothing was identified on "
        "this trial, usually because it has no force plate.",
        "See the trial's own verdict.",
        "transfer",
        "The other trial has no identified parameters.",
    ),
}
"""Explanation of each code."""
