"""mocap-id: an individual's skeleton, joint states and inertial parameters from one recording."""

__version__ = "0.1.0"
