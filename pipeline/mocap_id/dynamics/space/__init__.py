"""Identification of inertial parameters in space, where a plate carries the base.

The steps, in order: :func:`trial.prepare`, :func:`identification.identify`, :func:`prediction.predict`.
"""
