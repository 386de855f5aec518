"""GelStereo tactile sensors as LeRobot cameras. Importing this package registers the camera type
``gelstereo``.
"""

from .camera_gelstereo import GelStereoCamera
from .config_gelstereo import GelStereoCameraConfig

__all__ = ["GelStereoCamera", "GelStereoCameraConfig"]
