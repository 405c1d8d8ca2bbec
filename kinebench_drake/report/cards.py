"""Result card of a model: `.eval_results` of the Hugging Face Hub, and every-eval-ever (schema 0.3.0)."""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import Json, as_object, write_json
from kinebench_drake.report.run import Run
from kinebench_drake.results.aggregate import Estimate
from kinebench_drake.stats import CONFIDENCE

_HUB = re.compile(r"hf://datasets/([\w.-]+/[\w.-]+)(?:@([^/]+))?")
_LIBRARY = "kinebench_drake"


def write_card(
    out: Path, model: str, part: str, shares: Mapping[str, Estimate], run: Run, time_s: str
) -> Iterator[Path]:
    """Write OUT/MODEL.json, and OUT/MODEL.yaml where the data set of the benchmark is known; yield them.

    That is the tag `dataset` of the run (ORG/NAME), or its input on the Hub. The tag `organization` is the evaluator.

    Args:
        part: part of the suites; empty without suites.
        time_s: Unix time at which the run's bundle was written [s].
    """
    name = re.sub(r"[^\w.-]+", "-", f"{model} {part}".strip()).strip("-.") or "model"
    match = _HUB.match(str(run.config.get("source")))
    version = str(as_object(run.results.get("versions")).get(_LIBRARY))
    dataset = run.tags.get("dataset") or (match and match[1])
    revision = match and match[2]
    title = part or str(run.config.get("source") or run.kind)
    source = {"dataset_name": dataset or title, "source_type": "hf_dataset" if dataset else "other"}
    path = out / f"{name}.json"
    card: dict[str, Json] = {
        "schema_version": "0.3.0",
        "evaluation_id": f"{_LIBRARY}/{model}/{time_s}",
        "retrieved_timestamp": time_s,
        "source_metadata": {
            "source_type": "evaluation_run",
            "source_organization_name": run.tags.get("organization", "unknown"),
            "evaluator_relationship": "other",
        },
        "eval_library": {"name": _LIBRARY, "version": version},
        "model_info": {
            "name": model,
            "id": model,
            "additional_details": {"deployment_type": "unknown", "model_availability": "unknown"},
        },
        "evaluation_results": [
            {"evaluation_name": title, "source_data": {**source, **({"hf_repo": dataset} if dataset else {})}, **result}
            for result in map(_result, shares, shares.values())
        ],
    }
    write_json(path, card)
    yield path
    if dataset:
        path = path.with_suffix(".yaml")
        lines = []
        for share, value in shares.items():
            task = re.sub(r"\W+", "_", f"{part or run.kind} {share}".lower()).strip("_")
            most = f", at most {value.upper:.2%}" if (value.upper or 0.0) > (value.mean or 0.0) else ""
            lines += [f"- dataset:\n    id: {json.dumps(dataset)}\n    task_id: {json.dumps(task)}"]  # JSON is YAML
            lines += [f"    revision: {json.dumps(revision)}"] if revision else []
            lines += [f"  value: {100.0 * (value.mean or 0.0):.4g}"]
            lines += [f"  notes: {json.dumps(f'n = {value.n} of {value.total}{most}; {_LIBRARY} {version}')}"]
        write_atomically(path, ("\n".join(lines) + "\n").encode())
        yield path


def _result(name: str, share: Estimate) -> dict[str, Json]:
    """Return metric and score of a share, with its interval."""
    details = {"samples": str(share.n), "total": str(share.total)}
    details |= {} if share.upper is None else {"upper": f"{share.upper:.6g}"}
    score: dict[str, Json] = {"score": share.mean, "details": details}
    if share.low is not None:
        interval: dict[str, Json] = {"lower": share.low, "upper": share.high, "confidence_level": CONFIDENCE}
        score["uncertainty"] = {"confidence_interval": interval, "num_samples": share.n}
    metric: dict[str, Json] = {"metric_id": f"{_LIBRARY}.{name}", "metric_name": name, "metric_unit": "proportion"}
    scale: dict[str, Json] = {"lower_is_better": False, "score_type": "continuous", "min_score": 0, "max_score": 1}
    return {"metric_config": {**metric, **scale}, "score_details": score}
