"""Export of a run to other programs: OpenSim files, and tables with units in their headers."""

from mocap_id.workflows.export.formats import FORMATS, Export, export_run

__all__ = ["FORMATS", "Export", "export_run"]
