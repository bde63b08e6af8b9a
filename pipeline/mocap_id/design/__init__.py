"""Experiment design: which movement to record next to determine the parameters more precisely.

Shapes: T samples, n joints, b base parameters, S error modes. Units are SI; rates are in samples per second. A
covariance is infinite if the movement does not determine the parameters.
"""
