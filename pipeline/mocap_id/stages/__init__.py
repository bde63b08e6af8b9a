"""The pipeline: the one ordered tuple of stages, from which commands, Makefile rules and documentation come.

Each stage stands after the stages whose outputs it reads. The last one is the report: when a stage refuses a trial,
the report is made of what exists.
"""

from mocap_id.stages.base import Stage
from mocap_id.stages.fit_joints import STAGE as FIT_JOINTS
from mocap_id.stages.identify_dim import STAGE as IDENTIFY_DIM
from mocap_id.stages.planarise import STAGE as PLANARISE
from mocap_id.stages.report import STAGE as REPORT
from mocap_id.stages.segment import STAGE as SEGMENT
from mocap_id.stages.ukf_smooth import STAGE as UKF_SMOOTH

STAGES: tuple[Stage, ...] = (PLANARISE, SEGMENT, FIT_JOINTS, UKF_SMOOTH, IDENTIFY_DIM, REPORT)

__all__ = ["STAGES", "Stage"]
