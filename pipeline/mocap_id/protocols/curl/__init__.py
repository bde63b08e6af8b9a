"""Curls of the elbow: their times, tempo and end of the trial, compensation, torque and fatigue (thesis 8.3)."""
