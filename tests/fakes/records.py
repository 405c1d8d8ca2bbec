"""What a run leaves: its folder, and its reports to an observer."""

from kinebench_drake.runs.runner import NullRunObserver


def content(out, without=("timings.jsonl",)):
    """Every byte of an output folder but the timings."""
    return {
        p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file() and p.name not in without
    }


class RunRecorder(NullRunObserver):
    """Observer that keeps what it receives."""

    def __init__(self):
        self.warnings = []
        self.finished = []

    def warn(self, message):
        self.warnings.append(message)

    def finish(self, row, wall_s):
        self.finished.append(row.id)
