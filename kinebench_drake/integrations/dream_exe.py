"""Pose engine of Dream.exe (https://github.com/showlab/Dream.exe); its files that select it: docs/integrations.md."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from kinebench_drake.api.runs import PathName
from kinebench_drake.api.single import ground_video
from kinebench_drake.errors import UnmeasurableError, UsageError
from kinebench_drake.formats.dream_exe import ENVIRONMENT, DreamScene, hand_from_site, read_scene


class PoseBackend:
    """Poses of the gripper's mesh in the camera frame (OpenCV axes), from the frames and the case's camera.

    The mesh, the mask and the estimated depth of a request are not used: the grounding has its own CAD and estimates
    depth relative to the gripper. A candidate is valid where the gripper is tracked; its quality is the confidence.
    """

    provider_kind = "external"
    backend_id = "kinebench"
    contract_version = "pose_backend"

    def __init__(self, *, environment: PathName | None = None, period_s: float = 0.05) -> None:
        """Create the engine; models are loaded with the first request.

        Args:
            environment: environment.json of the case; None: that of the case to which the mesh of a request belongs.
            period_s: task time between two frames [s].
        """
        self._environment = None if environment is None else Path(environment)
        self._period_s = period_s

    def infer(self, request: Any) -> Any:
        """Return a `PosePrediction` with a candidate for each frame of a `PoseBackendRequest`.

        Raises:
            UsageError: there is no environment.json.
            InputError: it is damaged.
            SetupError: weights or libraries are missing.
        """
        contract = import_module(type(request).__module__)  # the classes of the version of Dream.exe that asks
        scene = self._scene(Path(request.mesh_path))
        frames = np.stack([np.asarray(frame, dtype=np.uint8) for frame in request.video_frames])
        try:
            grounding = ground_video(frames, camera=scene.camera, frame_period_s=self._period_s, first=scene.first)
        except UnmeasurableError as error:
            candidates = [self._candidate(contract, None, 0.0, str(error))] * len(frames)
            return contract.PosePrediction(candidates=candidates, meta=self._identity())
        track = grounding.track
        X_CS = track.X_CH @ hand_from_site()
        candidates = [
            self._candidate(contract, X if ok else None, float(confidence), "not tracked")
            for X, ok, confidence in zip(X_CS, track.tracked, track.confidence, strict=True)
        ]
        return contract.PosePrediction(candidates=candidates, meta=self._identity())

    def _identity(self) -> dict[str, str]:
        names = ("provider_kind", "backend_id", "contract_version")
        return {name: getattr(self, name) for name in names}  # a prediction without it is refused

    def _candidate(self, contract: Any, X_CS: Any, confidence: float, reason: str) -> Any:
        valid = X_CS is not None
        meta = {} if valid else {"reason": reason}
        return contract.PoseCandidate(
            pose_cam=X_CS, valid=valid, source=self.backend_id, pose_quality=confidence if valid else 0.0, meta=meta
        )

    def _scene(self, mesh: Path) -> DreamScene:
        # case: env/geometry/eef/visual.obj; a run's copy of it: artifacts/init/cad/, beside artifacts/env/
        places = (folder / part / ENVIRONMENT for folder in mesh.resolve().parents for part in (".", "env"))
        path = self._environment or next((place for place in places if place.is_file()), None)
        if path is None:
            raise UsageError(f"{mesh}: no {ENVIRONMENT} in the case's folder above it; name its path by environment=")
        return read_scene(path)
