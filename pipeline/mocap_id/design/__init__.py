"""Experiment design: which movement to record next so that the parameters are known better.

Shapes: T samples, n joints, b base parameters, S error modes. Units are SI; rates are in samples per second. A
covariance is infinite if the movement does not determine the parameters. A docstring describes the arguments
``predictor``, ``limits``, ``family`` and ``joints`` (names of the joints) only where they differ from the class of this
name.
"""
