"""Identification of inertial parameters in space, for a base that rests on a force plate.

The steps, in order: :func:`trial.prepare`, :func:`identification.identify`, :func:`prediction.predict`. Shapes and
common arguments are as in :mod:`mocap_id.dynamics`, with ten full parameters for each of K segments and N joint
coordinates. The frame of the trial has y up.
"""
