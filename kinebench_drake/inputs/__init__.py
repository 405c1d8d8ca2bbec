"""From what the user named to the list of videos to work on: one module a format, a registry of them in `find`."""

from kinebench_drake.inputs.find import find_samples
from kinebench_drake.inputs.sample import CameraSource, Inputs, Sample

__all__ = ["CameraSource", "Inputs", "Sample", "find_samples"]
