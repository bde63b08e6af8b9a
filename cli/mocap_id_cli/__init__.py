"""Command line of mocap-id: one module for each command, named after it."""
