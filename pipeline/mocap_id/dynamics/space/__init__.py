"""Identification of inertial parameters in space, for a base that rests on a force plate; the y axis points up.

Shapes and common arguments are as in :mod:`mocap_id.dynamics`, with N coordinates of the n joints of K segments.
"""
