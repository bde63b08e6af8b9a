"""Explanations of reasons about the identification of the inertial parameters."""

from __future__ import annotations

from collections.abc import Mapping

from mocap_id.reporting.explanations.explanation import Explanation

PARAMETERS: Mapping[str, Explanation] = {
    "standing-still": Explanation(
        ("caution",),
        "Only the mass is known",
        "The joints move only while the chair carries part of the weight, and rest when the ground alone carries it. A "
        "body at rest shows only its mass and the position where its weight acts.",
        "Record a movement without the chair, such as squats, or more repetitions of the sit-to-stand.",
        "identify-dim",
        "Largest arc of a joint off the chair, degrees; limit `identify-dim: {still_arc_deg}`. The value is the known "
        "mass, kg.",
    ),
    "not-excited": Explanation(
        ("caution",),
        "A joint does not move",
        "The segments on either side of a joint at rest move as one body, so the wrench cannot separate their "
        "parameters. No parameters are given, because any values would be a guess.",
        "Record a movement of every joint, or reduce the number of segments with `segment: {count: …}`.",
        "identify-dim",
        "On samples without chair contact, the regressor has a lower rank than for a moving chain. The value is the "
        "known mass, kg.",
    ),
    "clock-offset-unknown": Explanation(
        ("caution",),
        "The clocks of cameras and plates may differ",
        "One millisecond between the clocks can change a base parameter by up to a third. Here the offset could not be "
        "found and zero was assumed. The parameters are only as good as this assumption.",
        "Check that markers and forces belong to the same trial; record a faster movement, which shows the offset "
        "better; or widen `identify-dim: {clock_offset_limit_s: …}`.",
        "identify-dim",
        "Best offset, s; limit `identify-dim: {clock_offset_limit_s}`. Or the cost has no clear minimum.",
    ),
    "clocks-disagree": Explanation(
        ("caution",),
        "The repetitions give different clock offsets",
        "Each fit that leaves a repetition out estimates the offset between cameras and plates again. These offsets "
        "differ by more than 5 ms, and 5 ms change a base parameter by a fifth or more. Either one of the clocks "
        "drifts, or the model does not follow the movement and the offset compensates for it.",
        "Check how cameras and plates are synchronised, and look for dropped frames. Compare the offset with other "
        "trials of the session: it should be the same. If the clocks are good, look at the joint gaps and at the "
        "marker residuals.",
        "identify-dim",
        "Range of the clock offsets of the fits without one repetition, s; limit 0.005.",
    ),
    "clock-offset-kept": Explanation(
        ("caution",),
        "A known clock offset was not corrected",
        "The offset between cameras and plates was found, but the settings switch its correction off. Regressor and "
        "wrench then belong to different instants, which biases the parameters.",
        "Remove `identify-dim: {apply_clock_offset: false}`, or correct the clocks first.",
        "identify-dim",
        "Offset found, s, if `identify-dim: {apply_clock_offset}` is false; limit 3 standard deviations and 0.0005.",
    ),
    "joint-gives-way": Explanation(
        ("ok",),
        "The two sides of a joint separate",
        "The chain pins two segments together at a point. Their markers show that the two segments move apart at this "
        "point: a pelvis moves on the hip, a back bends, skin slides. Pins would hide how the mass really moved, so in "
        "the dynamics every body moves as its own markers were measured. The section “Motion of the masses” of the "
        "report shows the effect of pins.",
        "Nothing, if the gap is usual: 6 to 16 mm at the hip of a person. If it is larger, look at the skeleton: a "
        "marker may be on the wrong segment, or the joint in the wrong place.",
        "identify-dim",
        "Acceleration of the gap between the two sides of a joint below 3 Hz, m/s² rms; limit 0.03. The value is the "
        "largest gap, m rms.",
    ),
    "pinned-joint-gives-way": Explanation(
        ("caution",),
        "A joint that gives way was pinned",
        "`identify-dim: {motion: chain}` pins all joints, but the markers show that the two sides of a joint separate "
        "by more than noise. The pins hide how the mass really moved. This error recurs in every repetition, so "
        "standard deviations, which follow from residuals, contain only a part of it.",
        "Remove `motion: chain`. If you need the chain, for example for comparison with another program, do not use "
        "the intervals of parameters and torques.",
        "identify-dim",
        "As `joint-gives-way`, if `identify-dim: {motion: chain}` is set. The value is the largest gap, m rms.",
    ),
    "parameters-bounded": Explanation(
        ("caution",),
        "Only an impossible body would fit better",
        "Masses cannot be negative. Parameters with this constraint fit clearly worse than unconstrained ones. This "
        "points to an earlier error: a joint, the segment of a marker, the plate calibration, or mass far outside the "
        "markers.",
        "Check the skeleton and the residuals first, then the use and calibration of the plates.",
        "identify-dim",
        "Relative increase of the cost from unconstrained to physically consistent parameters; limit 0.05.",
    ),
    "held-out-worse": Explanation(
        ("caution",),
        "No better than a table",
        "Each repetition was predicted by a model fitted to the others. For the named quantities, the reference body "
        "from a table, which needs only height and mass, predicts as well or better. The individual model has no "
        "advantage there: errors from joints, markers, skin or unmodelled limbs are larger than the differences "
        "between this person and the table. The error within the fit does not show this.",
        "Check the marker residuals, and whether arms or head move: limbs outside the chain are not modelled, so keep "
        "the arms still against the trunk. A slower movement is easier to model. For the named quantities, use the "
        "table values.",
        "identify-dim",
        "rms error on held-out repetitions, divided by that of the table's body; limit 1.",
    ),
    "held-out-far": Explanation(
        ("caution",),
        "The model does not generalise to other repetitions",
        "Each repetition was predicted by a model fitted to the others. These predictions have much larger errors than "
        "the fit to all repetitions. Either there are too few repetitions for so many parameters, which then fit "
        "details of single repetitions, or one repetition differs: a step, a hand on the knee, a lost marker.",
        "Record more repetitions, or exclude the different one with `window:`. Trust the error on held-out "
        "repetitions, not the error within the fit.",
        "identify-dim",
        "rms error on held-out repetitions, divided by that within the fit; limit 1.5.",
    ),
    "parameters-weak": Explanation(
        ("caution",),
        "Some base parameters are weakly known",
        "Their standard deviation exceeds a fifth of their size: the movement hardly excites them. Above their whole "
        "size they count as not identifiable. The other parameters are valid, and so is the wrench that all of them "
        "together predict for this movement.",
        "Use them with their intervals, or record the movement named in the reason. It was computed from the regressor "
        "of this trial (docs/reading-the-dynamics.md).",
        "identify-dim",
        "Number of base parameters with a standard deviation above 20 % of their size. Above 100 % a parameter is not "
        "identifiable.",
    ),
    "torque-uncertain": Explanation(
        ("caution",),
        "A joint torque is uncertain",
        "In more than one of 100 trials like this one a torque is wrong by more than 5 N·m. The causes are the place "
        "of the joint, the masses beyond it, and wrong accelerations where markers are missing; most often a segment "
        "has markers at one or two places only. Errors of scale of plate and cameras do not count here, because they "
        "are the same in all trials; the interval of the torque contains them.",
        "Use the torque with its interval. If the reason names a time, fill the markers there or leave it out with "
        "`window:`; otherwise place three markers or more on the segments beside the joint.",
        "identify-dim",
        "The rms error of a torque, while only the ground touches the body, that one of 100 such trials exceeds, "
        "N·m; limit 5. Only for people on the pinned chain; with a measured chair or hand, only with one or two marker "
        "places on a segment.",
    ),
    "foot-prior": Explanation(
        ("ok",),
        "The foot's first moment comes from the reference body",
        "The data hardly separate the foot's first moment from those of the other segments, and with one or two marker "
        "places on a segment the torque of the ankle would be uncertain by 5 N·m and more. The foot has only 3 % of "
        "the mass, so the place of the ankle and the reference body give it to 1 mm times the body's mass. The "
        "deviation of the ankle's place is included. With three marker places or more on every segment, only the "
        "torques use this prior, and not if the data contradict it or if forces of a chair or on a hand are measured.",
        "Nothing. To use the data alone, set `identify-dim: {reference_pulls: false}`.",
        "identify-dim",
        "A person on the pinned chain with a reference body, if `identify-dim: {reference_pulls}` is not set or is "
        "`foot`.",
    ),
    "scale-error": Explanation(
        ("caution",),
        "An instrument has a wrong scale",
        "Gravity and inertia act on the same masses, forces and moments belong to one wrench, and some ratios of the "
        "parameters are almost the same in all people. In this recording they contradict each other, and one cause "
        "explains it better than all others: a wrong frame rate, plate gain, zero or position, camera scale or tilt. "
        "Every quantity that depends on it is wrong by this amount; the standard deviations of parameters and torques "
        "contain it.",
        "Check what the reason names, correct it, and run the trial again.",
        "identify-dim",
        "Size of the error, relative, N, m or rad; limit 2.58 of its standard deviations, and a decrease of χ² by 6.6 "
        "more than by any other cause.",
    ),
    "scales-contradict": Explanation(
        ("caution",),
        "Scales of plate, cameras and clocks contradict each other",
        "As for `scale-error`, but several causes explain the contradiction about equally well, so the data do not "
        "name one. The standard deviations of parameters and torques contain all of them.",
        "Check the causes in the order in which the reason lists them. `subject: {mass: …}` from a scale, a faster "
        "movement or more repetitions separate them better.",
        "identify-dim",
        "Size of the likeliest error; another cause is within 6.6 of its decrease of χ².",
    ),
    "scale-on-trust": Explanation(
        ("ok",),
        "Nothing shows the gain of the plate",
        "If all channels of the plate are wrong by the same factor, all masses and torques are wrong by this factor, "
        "and everything else fits. Only a known mass shows it. The standard deviations contain "
        "`identify-dim: {plate_gain_sd: …}`.",
        "Give `subject: {mass: …}` from a scale, or test the plate with a known weight.",
        "identify-dim",
        "No `subject: {mass}`.",
    ),
    "mass-contradiction": Explanation(
        ("caution",),
        "Two masses disagree",
        "The identified mass and the given mass of the subject differ by more than the errors of scales. One is wrong. "
        "If it is that of the plates, every force is wrong too.",
        "Check the calibration and zero of the plates, other loads on them, whether one carries the chair, and the "
        "mass in the trial file.",
        "identify-dim",
        "Standing mass, kg; at most 5 % from `subject: {mass}`, or 2.58 standard deviations of gain and scale if these "
        "are less, as in a heavy person.",
    ),
    "mass-unchecked": Explanation(
        ("caution",),
        "The mass is not checked",
        "Comparing the identified mass with the standing mass reveals a chair or support that carries part of the "
        "body. Here no standing was found, and no mass was given.",
        "Give `subject: {mass: …}`, or record some quiet standing; for a movement from a chair set "
        "`protocol: sit-to-stand`.",
        "identify-dim",
        "Neither the standing mass nor `subject: {mass}` is known.",
    ),
    "load-shared": Explanation(
        ("caution",),
        "The identified mass differs from the standing mass",
        "The identified mass is not the one that the plates measure during standing. Most often a chair, or a hand on "
        "a support, carried part of the body in samples used for identification. All parameters are then wrong.",
        "For a movement from a chair set `protocol: sit-to-stand`; otherwise give a `window:` without the support.",
        "identify-dim",
        "Identified mass, kg; at most 5 % from the standing mass.",
    ),
    "components-short": Explanation(
        ("caution",),
        "The fitted components do not determine everything",
        "A fit to part of the wrench determines only the parameters that this part depends on. Other components, the "
        "centre of pressure and some torques depend on further parameters, so they are left empty. A joint within "
        "one body of the measured poses, as between pelvis and trunk, has no torque for any choice of components.",
        "Fit at least Fy and tauz: they give all torques except those within a body.",
        "identify-dim",
        "A row of the regressor is not a linear combination of the rows of `identify-dim: {components}`.",
    ),
    "reference-assumed": Explanation(
        ("ok",),
        "Assumptions in the reference body",
        "Height, mass or sex was not given. The allometric reference body uses values from the recording or the mean "
        "table instead. With the pinned chain, the identified parameters depend on it only if `identify-dim: "
        "{reference_pulls: true}` is set. With measured poses, it is the mean of a loose prior; the table of base "
        "parameters shows the share of the prior.",
        "Give `subject: {height: …, mass: …, sex: …}`.",
        "identify-dim",
        "`subject:` lacks height, mass or sex.",
    ),
    "no-reference": Explanation(
        ("ok",),
        "No reference body",
        "There is no allometric body to compare with. With the pinned chain, the identified parameters do not depend "
        "on one; with measured poses, the loose prior divides the mass evenly between the bodies instead.",
        "Give `subject:`. The tables describe only people of four or five segments.",
        "identify-dim",
        "No table has a body with this number of segments, or mass or height is unknown.",
    ),
    "cone-unproven": Explanation(
        ("caution",),
        "Grid parameters were used instead of the cone",
        "The exact cone of physically consistent bodies was requested, but the solver's solution failed the "
        "optimality check. The parameters are those of point masses on the grid, which are also physically consistent "
        "and fit equally well or slightly worse.",
        "Set `identify-dim: {consistency: grid}`, or check the skeleton: coinciding joints or wrong units cause such "
        "problems.",
        "identify-dim",
        "Optimality gap (KKT) of the solution in the cone; limit 1e-6.",
    ),
    "solver-unproven": Explanation(
        ("caution",),
        "The parameters may not be optimal",
        "No solver's solution passed the optimality check. The best one was used; the reason says by how much its cost "
        "may exceed the minimum.",
        "Check the skeleton and the units. If they are right, try a coarser `identify-dim: {grid: …}`.",
        "identify-dim",
        "Optimality gap (KKT) of the best solution; limit 1e-6.",
    ),
    "solver-fallback": Explanation(
        ("ok",),
        "The second solver was used",
        "The point masses of the first solver failed the optimality check. Those of the second solver passed it, so "
        "the result is fully valid.",
        "Nothing.",
        "identify-dim",
        "The optimality gap of the first solver's solution is above 1e-6.",
    ),
}
"""Explanation of each code."""
