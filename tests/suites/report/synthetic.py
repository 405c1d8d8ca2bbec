"""Synthetic output folders of suite runs."""

import json

from kinebench_drake.io.jsonl import dump
from kinebench_drake.results.row import Status, sample_suffix
from kinebench_drake.results.store import RESULTS, SAMPLES
from tests.rows import make_cause, make_row

EVIL = "<script>alert('x')</script> & 50% _of_ $x$"


def outcome(success, progress=None, verdict=None, sparc=-2.0, cost=8.0, rounds=1, **changes):
    """Fields of one episode's row, for `write_run`."""
    done = progress if progress is not None else float(success)
    failure = verdict or (None if success else "task")
    cause = make_cause(failure, f"because of {failure}") if failure else None
    return {
        "status": Status.OK,
        "metrics": {"sparc": sparc, "manipulability_cost_mean": cost, "tracked_fraction": 1.0, "anomalies": []},
        "extra": {"success": success, "progress": done, "rounds": rounds, "verdict": failure, "cause": cause},
        **changes,
    }


def failed(status=Status.ERROR, reason="broken"):
    return {"status": status, "reason": reason, "metrics": {"sparc": None}, "extra": {}}


def write_run(
    out,
    episodes,
    model="wan",
    suite=0,
    split="test",
    variant="plain",
    tags=None,
    first_seed=0,
    kind="suite",
    spec=None,
    **changes,
):
    """Write the output folder of a suite run.

    `episodes` holds outcomes (or True and False) by task, or lists of those of several samples.
    """
    out.mkdir(parents=True)
    rows = []
    for task, outcomes in episodes.items():
        samples = [
            (seed, index, result)
            for seed, own in enumerate(outcomes, first_seed)
            for index, result in enumerate(own if isinstance(own, list) else [own])
        ]
        for seed, index, result in samples:
            result = outcome(result) if isinstance(result, bool) else result
            id = f"{task.replace('/', '_')}_s{seed:04d}{sample_suffix(index)}"
            labels = {"seed": seed, "sample_index": index, "pool": "all", "variant": variant}
            row = {"id": id, "video": f"videos/{id}_r0.mp4", "task": task, "model": model, "reason": None}
            row |= {"content_hash": "0", **result, "extra": {**result["extra"], **labels}}
            rows.append(make_row(**row))
    config = {"suite": suite, "split": split, "variant": variant, "rounds": 3, "control": "pd_joint_pos"}
    config |= {} if spec is None else {"world_model_sha256": spec}
    results = {
        **{"schema_version": 1, "suite_version": None, "kind": kind, "tags": tags or {}},
        **{"samples_found": len(rows), "config": config, **changes},
    }
    (out / SAMPLES).write_text("".join(dump(row.to_json()) for row in rows))
    (out / RESULTS).write_text(dump(results))
    return out


def change(folder, **changes):
    """Change what a folder's results.json says."""
    path = folder / "results.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))
