"""Identification of inertial parameters from states and contact wrench (thesis chapter 4).

The functions are called in this order: :func:`preparation.prepare`, :func:`fit.fit`, :func:`identification.identify`,
:func:`prediction.predict`.

Shapes: T samples, R of them in the fit, n joints, K bodies (the n + 1 segments of a chain, base first), c fitted
components of the wrench, b base parameters, k constant errors of the plate, S error modes (independent errors of one
standard deviation each). Units are SI: m, rad, kg, N, N·m and s. Missing values are NaN.

Many functions have the same arguments, which their docstrings do not describe again. ``prepared`` or ``trial`` is a
trial in the plane or in space, with regressor and filtered signals. ``gate`` (T,) marks samples in which the body
touches only the ground. ``result`` is the result of the fit, or the identified parameters. ``base`` (b,) are base
parameters, ``full`` (4K,) the full parameters m, mx, my, Izz of every body about the origin of its frame (in space ten
for each body). ``centres`` (n, 2) are the centre of each joint in the frame of the segment before it. ``q``, ``dq`` and
``ddq`` (T, n) are joint angles and their time derivatives. ``grid`` are the point masses, and ``error`` is the
uncertainty of the geometry.
"""
