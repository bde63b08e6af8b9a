"""Command line of mocap-id; each command has a module with its name."""
