"""A run handed on to other programs: OpenSim's files, and tables with units in their headers."""

from mocap_id.workflows.export.exporting import FORMATS, Exported, export

__all__ = ["FORMATS", "Exported", "export"]
