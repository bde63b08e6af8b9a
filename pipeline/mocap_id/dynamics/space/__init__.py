"""Identification of inertial parameters in space, for a base that rests on a force plate.

The functions are called in this order: :func:`preparation.prepare_in_space`,
:func:`identification.identify_parameters_in_space`, :func:`identification.predict_in_space`. Shapes and common
arguments are as in :mod:`mocap_id.dynamics`, with ten full parameters for each of K segments (base included), n joints
and N joint coordinates. The y axis of the trial's frame points up.
"""
