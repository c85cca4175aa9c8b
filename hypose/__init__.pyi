"""Types of the names that `hypose/__init__.py` imports when they are used."""

from hypose.body.body import Body as Body
from hypose.body.default_body import human as human
from hypose.body.joint_angles import joint_angles as joint_angles
from hypose.body.motion import Motion as Motion
from hypose.cameras.camera import Camera as Camera
from hypose.cameras.camera import CameraRig as CameraRig
from hypose.errors import HyposeError as HyposeError
from hypose.errors import InputError as InputError
from hypose.evidence.cues import OwnEvidence as OwnEvidence
from hypose.evidence.frame import Frame as Frame
from hypose.evidence.frame import Silhouettes as Silhouettes
from hypose.evidence.terms import PointTerm as PointTerm
from hypose.evidence.terms import RowTerm as RowTerm
from hypose.fusion.fuse import fuse_clip as fuse_clip
from hypose.fusion.people import LiveFuser as LiveFuser
from hypose.inference import kernels as kernels
from hypose.inference import resampling as resampling
from hypose.inference.annealing import SmoothedWeight as SmoothedWeight
from hypose.inference.hypotheses import Hypotheses as Hypotheses
from hypose.inference.layer import Layer as Layer
from hypose.inference.layer import Recipe as Recipe
from hypose.inference.layer import follow as follow
from hypose.inference.layer import search as search
from hypose.inference.layer import stream as stream
from hypose.io.calibrations.calibration_formats import read_any as _read_calibration
from hypose.io.calibrations.calibration_formats import write_calibration as write_calibration
from hypose.io.motions.export import export_motion as export_motion
from hypose.io.motions.results import load_body as load_body
from hypose.io.motions.results import load_motion as load_motion
from hypose.io.motions.results import save_body as save_body
from hypose.io.motions.results import save_motion as save_motion
from hypose.io.recordings.recording import Recording as Recording
from hypose.io.recordings.recording import load_recording as load_recording
from hypose.io.sensors.skeleton_files import read_skeletons as read_skeletons
from hypose.pipeline.gesture_files import load_model as _load_gesture_model
from hypose.pipeline.run import TrackResult as TrackResult
from hypose.pipeline.run import load_tracked as _load_result
from hypose.pipeline.sources import FrameList as FrameList
from hypose.pipeline.track import track as track
from hypose.pipeline.track_options import TrackOptions as TrackOptions
from hypose.synthetic.scenes import make_scene as make_scene
from hypose.tracking.frame_evidence import SilhouetteXor as SilhouetteXor
from hypose.tracking.recipes import recipe as recipe
from hypose.tracking.refinement import pose_mean as pose_mean
from hypose.tracking.tracker import Tracker as Tracker
from hypose.tracking.tracker import TrackerSettings as TrackerSettings

read_calibration = _read_calibration
load_gesture_model = _load_gesture_model
load_result = _load_result

__version__: str
__all__: list[str]
