from mocap_id.errors import ConfigError as ConfigError
from mocap_id.errors import MocapIdError as MocapIdError
from mocap_id.errors import NumericalError as NumericalError
from mocap_id.errors import RecordingError as RecordingError
from mocap_id.errors import Refused as Refused
from mocap_id.errors import StoreError as StoreError
from mocap_id.interface.figures import Figure as Figure
from mocap_id.interface.run_result import Run as Run
from mocap_id.interface.run_result import Verdict as Verdict
from mocap_id.interface.running import open as open
from mocap_id.interface.running import run as run
from mocap_id.interface.simulated import simulate as simulate
from mocap_id.interface.studies import Study as Study
from mocap_id.interface.studies import study as study
from mocap_id.recording.model import Plate as Plate
from mocap_id.recording.model import Recording as Recording
from mocap_id.recording.reader import read as read
from mocap_id.verdict import Reason as Reason

__version__: str
