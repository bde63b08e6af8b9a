"""Devices for a measured person: workspaces, springs, level sets, pneumatic cylinders, controllers (thesis part II).

Mathematics, with numpy, scipy and numba alone:

- ``workspace``: reachable workspace of a chain within its joint limits
- ``springs``, ``holding_kernels``: springs for one joint or a chain, and sub-workspaces
- ``level_set``, ``level_set_kernels``: states that a joint with a spring reaches within a time
- ``devices``: pressures, gas and identified parameters of a cylinder (the cylinder: ``mocap_id.dynamics.cylinder``)
- ``controllers``: controllers that change the pressures between sub-workspaces

Commands:

- ``workspaces``: ``mocap-id workspace``
- ``pneumatic``: ``mocap-id pneumatic``
- ``assisted_body``, ``prescriptions``, ``device_control``, ``prescription_output``: ``mocap-id prescribe``
- ``files``: the YAML file of a prescription

``mocap_id`` does not import this package; the commands do.
"""
