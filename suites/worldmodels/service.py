"""What a service may take, and how it fails."""

from dataclasses import dataclass

from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How long and how much."""

    attempts: int = 8
    """Times that one call is tried."""
    first_wait_s: float = 1.0
    """Wait before the second attempt; each further one is twice as long, and up to this much is added by chance."""
    longest_wait_s: float = 60.0
    """Longest wait of our own choice; a service may ask for longer ones."""
    silence_s: float = 60.0
    """Longest time without a byte, save where a service makes a video while we wait."""
    poll_s: float = 10.0
    """Pause between two questions whether a video is ready."""
    json_bytes: int = 4 << 20
    """Largest answer in JSON that holds no video."""
    video_bytes: int = 512 << 20
    """Largest video."""


class ServiceError(WorldModelError):
    """A service did not give what was asked for.

    Args:
        message: what happened.
        status: HTTP status of its answer; None if there was none.
        code: its own code for what it did not like.
    """

    def __init__(self, message: str, *, status: int | None = None, code: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.code = code


class BusyError(ServiceError):
    """The same request may succeed a little later: after `after_s` seconds if the service said so."""

    after_s: float | None = None
