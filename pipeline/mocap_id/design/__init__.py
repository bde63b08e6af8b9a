"""Experiment design: which movement to record next so that the parameters are known better."""
