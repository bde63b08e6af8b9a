"""Curls of the elbow: repetitions, end of the trial, compensation, torque and fatigue (thesis 8.3)."""
