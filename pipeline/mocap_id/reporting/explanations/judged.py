"""How every code of a verdict is judged: the stage (or command) that does, what is measured, against which limit.

Limits without a setting are constants of the code. The codes are those of
:data:`mocap_id.reporting.explanations.EXPLANATIONS`; a test holds the two together, and the settings to those that
there are.
"""

from __future__ import annotations

from collections.abc import Mapping

JUDGED: Mapping[str, tuple[str, str]] = {
    # recording
    "recording-oddity": ("planarise", "The reader says so."),
    "window-proposed": ("planarise", "No `window:` is given, and markers stay put in a part of the recording only."),
    "facing-unsure": ("planarise", "The sign by which the rule tells front from back is within its noise."),
    "upside-down": ("segment", "The mean height of the moving markers is below that of the base."),
    "marker-swap": (
        "segment",
        "Two tracks jump at once by 8 to 15 mm or more, and distances to neighbours hold after an exchange only.",
    ),
    "bursts": ("segment", "A sample jumps by 12 mm or more, and by 4 times the usual change of step, and comes back."),
    "no-plate": ("planarise", "The file has no force plate, or none that can be used."),
    "plate-unit-assumed": ("planarise", "The file declares no unit of force or moment."),
    "plates-doubtful": (
        "planarise",
        "The load of a plate named under `plates:` contradicts its use: a seat that "
        "carries the standing person, feet that carry nothing then.",
    ),
    "plate-misplaced": (
        "planarise",
        "Distance of the centre of pressure from the standing foot's markers, m; limit "
        "0.05 m and what their places leave open.",
    ),
    "plate-height": (
        "planarise",
        "Height of the feet's lowest marker over the surface, m; limits 0.008 below, 0.12 above.",
    ),
    "plate-tilted": (
        "planarise",
        "Inclination of the corners, degrees, limit 1.5; or of the standing force, limit 2.",
    ),
    "plate-turned": (
        "planarise",
        "Angle about the vertical between the horizontal force and the markers' mean acceleration, degrees; limit 30, "
        "or 90 for one foot's plate.",
    ),
    "plate-saturated": ("planarise", "Share of samples at the end of a channel's range; limit 0."),
    "plate-short": ("planarise", "Share of frames without a force; a caution above 0.05."),
    "plate-dropout": (
        "planarise",
        "Share of frames, 0.6 s or longer, in which the plates carry less than a fifth of "
        "what they do otherwise; limit 0.",
    ),
    "encoder-disagrees": (
        "ukf-smooth",
        "r² of the cameras' angle against the encoder's, once sense, zero and clock are found; limit 0.999.",
    ),
    "encoder-weak": (
        "ukf-smooth",
        "Whether another sense fits nearly as well, whether the offset of the clock lies at "
        "`ukf-smooth: {encoder_offset_limit_s}`, or its standard deviation, s; limit 0.001.",
    ),
    # skeleton
    "no-fixed-base": ("segment", "rms scatter of the second stillest marker, m, against `segment: {still_limit_m}`."),
    "no-motion": (
        "segment",
        "Every marker stays within `segment: {still_limit_m}`, or the moving ones make no rigid body of two.",
    ),
    "no-chain": (
        "segment",
        "Residual of the best joint on the base, m, against `segment: {max_joint_residual_m}`, its "
        "body's against `segment: {max_body_residual_m}` and its arc against `segment: {min_arc_deg}`; or "
        "there is no chain of `segment: {count}` segments.",
    ),
    "not-planar": (
        "segment",
        "Share of the chain's motion that is out of the plane, against `segment: "
        "{planarity_caution}` and `segment: {planarity_limit}`.",
    ),
    "segments-unsure": (
        "segment",
        "Confidence, 0 to 1; limit 0.5. Or the angle between left and right, degrees rms, "
        "against `segment: {asymmetry_deg}`.",
    ),
    "too-few-frames": ("fit-joints", "Frames that show two markers of every segment; at least 10 a joint."),
    "estimator": ("fit-joints", "`fit-joints: {estimator}` is not the default."),
    "joint-markers": ("fit-joints", "`segment: {joint_markers}` names markers; the value is λ_A."),
    "small-arc": (
        "fit-joints",
        "Arc of the joint (2.5 to 97.5 % of its angles), degrees, against `fit-joints: {small_arc_deg}`.",
    ),
    "joint-uncertain": ("fit-joints", "Standard deviation of the centre, m, against `fit-joints: {large_sd_m}`."),
    "gap": ("ukf-smooth", "Time for which the angle's standard deviation is above `ukf-smooth: {angle_sd_limit}`, s."),
    "states-method": ("ukf-smooth", "`ukf-smooth: {method}` is not the default."),
    # contact
    "no-repetitions": ("identify-dim", "Rise of the highest joint, m, against 15 % of the legs' length."),
    "contact-unknown": ("identify-dim", "No plate reading while the person stands, or none in a low phase."),
    "no-chair": ("identify-dim", "The feet never carry less than 80 % of the weight."),
    "contact-rule": (
        "identify-dim",
        "`identify-dim: {contact}` asks for a rule that needs Fy among `identify-dim: "
        "{components}` and samples off the chair.",
    ),
    "contact-unsettled": ("identify-dim", "Contact still moves by more than 0.02 s after 8 rounds."),
    "not-free": ("identify-dim", "No sample is known to be off the chair."),
    "seat-measured": ("identify-dim", "A plate under the chair is read, and agrees with the feet's."),
    "seat-contradiction": (
        "identify-dim",
        "Factor of the chair's wrench with which all forces add up best; expected 1 "
        "within 4 standard deviations or 5 % of the weight.",
    ),
    "seat-zero-unknown": ("planarise", "Nobody stands for 0.2 s, so the chair's plate has no empty reading."),
    "external-contradiction": ("identify-dim", "Factor of the sensor's wrench, as for the chair's."),
    # rising
    "repetition-cut": ("identify-dim", "The recording begins or ends within a movement."),
    "attempt-failed": (
        "identify-dim",
        "Rises that turn back before standing; the hips go up by 8 % of the rise, or the chair is unloaded to 40 %.",
    ),
    "rise-partial": ("identify-dim", "Greatest height, of the way from seat to standing; limit 0.9."),
    "rise-paused": ("identify-dim", "Time for which the rise is slower than 8 % of its peak speed, s; from 0.3 s on."),
    "support-unexplained": (
        "identify-dim",
        "Vertical force that neither plates nor chair explain, of the weight; limit 0.05.",
    ),
    # wrench
    "no-wrench": ("identify-dim", "planarise found no usable plate."),
    "no-common-samples": ("identify-dim", "Time for which wrench and angles are known together, s."),
    "too-few-samples": ("identify-dim", "Time off the chair and clear of gaps by the filter's reach, s."),
    "standing-still": (
        "identify-dim",
        "Largest arc of a joint off the chair, degrees, against `identify-dim: "
        "{still_arc_deg}`; the value is the mass that is known, kg.",
    ),
    "not-excited": (
        "identify-dim",
        "The regressor off the chair has a lower rank than the chain's; the value is the mass that is known, kg.",
    ),
    # parameters
    "clock-offset-unknown": (
        "identify-dim",
        "Best offset, s, against `identify-dim: {clock_offset_limit_s}`, and whether the cost shows it.",
    ),
    "clocks-disagree": (
        "identify-dim",
        "Range of the clock offsets that the fits without one repetition find, s; limit 0.005.",
    ),
    "clock-offset-kept": (
        "identify-dim",
        "The offset that was found, s, where `identify-dim: {apply_clock_offset}` is false; limit 3 standard "
        "deviations, and 0.0005.",
    ),
    "joint-gives-way": (
        "identify-dim",
        "Acceleration of the gap between a joint's two sides below 3 Hz, m/s² rms; limit 0.03. The value is the "
        "largest gap, m rms.",
    ),
    "parameters-bounded": (
        "identify-dim",
        "Rise of the cost from free parameters to those of a possible body, of the least cost; limit 0.05.",
    ),
    "parameters-weak": (
        "identify-dim",
        "Number of base parameters whose standard deviation is above 20 % of their "
        "size; above 100 % one is not identifiable.",
    ),
    "held-out-worse": ("identify-dim", "rms error on held-out repetitions over that of the table's body; limit 1."),
    "held-out-far": ("identify-dim", "rms error on held-out repetitions over that within the fit; limit 1.5."),
    "mass-contradiction": ("identify-dim", "Standing mass against `subject: {mass}`, kg; 5 % apart."),
    "mass-unchecked": ("identify-dim", "Neither a standing mass nor `subject: {mass}` is known."),
    "load-shared": ("identify-dim", "Identified mass against the standing one, kg; 5 % apart."),
    "components-short": ("identify-dim", "Rows of the regressor outside the span of `identify-dim: {components}`."),
    "reference-assumed": ("identify-dim", "`subject:` lacks height, mass or sex."),
    "no-reference": ("identify-dim", "No table has a body of as many segments, or mass or height are not known."),
    "cone-unproven": ("identify-dim", "Distance from the least cost (KKT) of the answer in the cone, against 1e-6."),
    "solver-unproven": ("identify-dim", "Distance from the least cost (KKT) of the best answer; limit 1e-6."),
    "solver-fallback": ("identify-dim", "The first solver's answer is farther than 1e-6 from the least cost."),
    # transfer
    "transfer-worse": ("transfer", "rms error of the carried body over that of the table's; limit 1."),
    "transfer-not-at-home": ("transfer", "The same on the model's own trial, repetitions left out; limit 1."),
    "transfer-not-told-apart": ("transfer", "Carried less table's prediction, rms in standard deviations; at least 2."),
    "transfer-worse-than-stated": ("transfer", "Share of the samples in the stated 95 % intervals; at least 0.8."),
    "transfer-joints": ("transfer", "Distance between the two trials' places of a joint, m; limit 0.03."),
    "transfer-markers": ("transfer", "rms distance of common markers after registration, m; limit 0.025."),
    "transfer-mass": ("transfer", "The model's mass against the standing one, kg; 5 % apart."),
    "transfer-nothing": ("transfer", "The other trial has no identified parameters."),
}
"""Stage or command, and the measure."""
