"""Experiment design: which movement to record next so that the parameters are known better.

Shapes: T samples, n joints, b base parameters. A covariance is *infinite* if the movement does not determine the
parameters. Rates are in samples per second.
"""
