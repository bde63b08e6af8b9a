"""What `mocap-id transfer` says of a model on another trial; no verdict of a trial holds these."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

TRANSFER: Mapping[str, Explanation] = {
    "transfer-worse": Explanation(
        ("caution",),
        "A carried model is no better than a table",
        "`mocap-id transfer` predicted this trial by the body that was identified on another one. For the quantities "
        "that are named, a body from a table that knows height and mass alone is as good or better. What the two "
        "trials leave unexplained, or what differs between them, is larger than what this person differs from the "
        "table: limbs that are held or moved otherwise, joints that were placed otherwise, markers that slid.",
        "Look at `held-out-worse` on both trials first: a model that does not predict its own repetitions will predict "
        "no others. Then compare how the arms are held, the segments, and how far apart the joints are placed "
        "(`joint_apart_m` of `--json`).",
    ),
    "transfer-not-at-home": Explanation(
        ("caution",),
        "The model is no better than a table on its own trial",
        "`mocap-id transfer` carries a body over whose own trial, repetitions left out, is predicted by a body from a "
        "table as well or better in the quantities that are named. What it holds of the individual there is no more "
        "than what the chain cannot follow.",
        "See `held-out-worse` on the model's trial, and carry over the model of a better one.",
    ),
    "transfer-not-told-apart": Explanation(
        ("caution",),
        "A carried model cannot be told from a table",
        "On the motion of the other trial the carried body's moment or centre of pressure differs from those of the "
        "table's body by less than two of its own standard deviations (rms over the trial). These come from the "
        "covariance of the bodies' parameters; on a pinned chain from that of the base parameters, and from 15 % "
        "(`identify-dim: {reference_sd: …}`) of each full parameter in what the wrench does not determine. The other "
        "trial's forces are not used for this.",
        "Record the model's trial with the movement that is to be predicted in it, more repetitions, or a larger "
        "range; or use the table's body.",
    ),
    "transfer-worse-than-stated": Explanation(
        ("caution",),
        "A carried model is off by more than it states",
        "`mocap-id transfer` states a standard deviation for what the carried body predicts: from the covariance of "
        "its parameters and from its error on repetitions of its own trial that were left out, times 1.4 for another "
        "movement. Of the measured samples 95 % should lie inside the intervals; for the named quantities it is less "
        "than 80 %. The two trials differ in something that the model's trial does not show: how the arms are "
        "held, markers that were placed anew, a plate's zero.",
        "Do not rely on the stated standard deviations here. Compare how the arms are held and where the markers are "
        "in both trials, and include the movement to be predicted when you record the model's trial.",
    ),
    "transfer-joints": Explanation(
        ("caution",),
        "The two trials place a joint differently",
        "Among the same markers a joint of the same person lies in the same place, within skin's centimetres. Here the "
        "two trials put it farther apart, and a mass that the wrench leaves open between the segments on either side "
        "comes to another place.",
        "See `joint-uncertain` and `small-arc` on both trials; hold both to fewer segments (`segment: {count: …}`) "
        "where a joint hardly bends in one of them.",
    ),
    "transfer-markers": Explanation(
        ("caution",),
        "The markers lie otherwise in the two trials",
        "`mocap-id transfer` lays each body of the model onto the trial's by the markers that both have. Here they do "
        "not fit: skin and posture leave about a centimetre, this is more. The body is then turned or shifted by as "
        "much. Arms and head change their shape, and are not judged.",
        "Compare the labels and the places of that body's markers in both recordings; between sessions markers are "
        "rarely put back to the same place.",
    ),
    "transfer-mass": Explanation(
        ("caution",),
        "The model has another mass than the person",
        "The mass of the body that `mocap-id transfer` carries over is not the one that the plates show in this trial.",
        "Check that both trials are of the same person, without things carried, and the plates' calibration.",
    ),
    "transfer-nothing": Explanation(
        ("caution",),
        "There is nothing to compare a carried model with",
        "Errors are taken over the samples that the trial's own model was fitted to. On this trial nothing was "
        "identified, most often because it has no force plate.",
        "See the trial's own verdict.",
    ),
}
"""Codes and their explanations."""
