"""Result cards of models: `.eval_results` of the Hugging Face Hub, and every-eval-ever (schema 0.3.0)."""

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.jsonl import Json, write_json
from kinebench_drake.report.run import Run
from kinebench_drake.results.aggregate import Estimate
from kinebench_drake.stats import CONFIDENCE

EVERY_EVAL_EVER = "0.3.0"
"""Version of the schema of every-eval-ever."""
_HUB = re.compile(r"hf://datasets/([\w.-]+/[\w.-]+)(?:@([^/]+))?")
_LIBRARY = "kinebench_drake"
_MEANINGS = {
    "success": "Share of episodes that end with success in simulation; unmeasured episodes are failures",
    "executable": "Share of samples that a robot can execute as they are seen; open verdicts count as no",
    "feasible": "Share of judged samples whose motion exceeds no limit of the robot",
}
Card = tuple[str, str, Mapping[str, Estimate], Run, str]
"""Model, part of the suites or empty, shares by name, run, and Unix time at which its bundle was written [s]."""


def write_cards(cards: Iterable[Card], out: Path) -> list[Path]:
    """Write the cards of models to OUT/cards, a `.yaml` and a `.json` of each; returns them.

    A `.yaml` names the data set of the benchmark: the tag `dataset` of the run (ORG/NAME), or its input on the Hub.
    Without one there is none. The tag `organization` is the evaluator.

    Raises:
        SetupError: writing failed.
    """
    paths = []
    for model, part, shares, run, time_s in cards:
        name = re.sub(r"[^\w.-]+", "-", f"{model} {part}".strip()).strip("-.") or "model"
        path = out / "cards" / f"{name}.json"
        write_json(path, _every_eval_ever(model, part, shares, run, time_s))
        paths.append(path)
        if dataset := _dataset_of(run):
            paths.append(path.with_suffix(".yaml"))
            write_atomically(paths[-1], _eval_results(part, shares, run, *dataset).encode())
    return paths


def _dataset_of(run: Run) -> tuple[str, str | None] | None:
    """Return name and revision of the data set of a benchmark; None if it is not known."""
    match = _HUB.match(str(run.config.get("source")))
    name = run.tags.get("dataset") or (match and match[1])
    return (name, match[2] if match else None) if name else None


def _eval_results(part: str, shares: Mapping[str, Estimate], run: Run, dataset: str, revision: str | None) -> str:
    """Return the YAML of the shares in percent: a list of results, whose texts are quoted as in JSON."""
    lines = []
    for name, share in shares.items():
        task = re.sub(r"\W+", "_", f"{part or run.kind} {name}".lower()).strip("_")
        notes = f"n = {share.n} of {share.total}, {_LIBRARY} {_version(run)}"
        if share.upper is not None and share.mean is not None and share.upper > share.mean:
            notes += f"; at most {share.upper:.2%}"
        lines += ["- dataset:", f"    id: {json.dumps(dataset)}", f"    task_id: {json.dumps(task)}"]
        lines += [f"    revision: {json.dumps(revision)}"] * (revision is not None)
        lines += [f"  value: {100.0 * (share.mean or 0.0):.4g}", f"  notes: {json.dumps(notes)}"]
    return "\n".join(lines) + "\n"


def _every_eval_ever(
    model: str, part: str, shares: Mapping[str, Estimate], run: Run, time_s: str
) -> Mapping[str, Json]:
    """Return the JSON object of one model."""
    dataset = _dataset_of(run)
    title = part or str(run.config.get("source") or run.kind)
    source: dict[str, Json] = {"dataset_name": dataset[0] if dataset else title, "source_type": "other"}
    if dataset:
        source |= {"source_type": "hf_dataset", "hf_repo": dataset[0]}
    unknown = {"deployment_type": "unknown", "model_availability": "unknown"}
    return {
        "schema_version": EVERY_EVAL_EVER,
        "evaluation_id": f"{_LIBRARY}/{model}/{time_s}",
        "retrieved_timestamp": time_s,
        "source_metadata": {
            "source_type": "evaluation_run",
            "source_organization_name": run.tags.get("organization", "unknown"),
            "evaluator_relationship": "other",
        },
        "eval_library": {"name": _LIBRARY, "version": _version(run)},
        "model_info": {"name": model, "id": model, "additional_details": unknown},
        "evaluation_results": [_result(title, name, share, source) for name, share in shares.items()],
    }


def _result(title: str, name: str, share: Estimate, source: Mapping[str, Json]) -> Mapping[str, Json]:
    """Return one share as a result, with its interval."""
    details = {"samples": str(share.n), "total": str(share.total)}
    details |= {} if share.upper is None else {"upper": f"{share.upper:.6g}"}
    score: dict[str, Json] = {"score": share.mean, "details": details}
    if share.low is not None:
        interval = {"lower": share.low, "upper": share.high, "confidence_level": CONFIDENCE}
        score["uncertainty"] = {"confidence_interval": interval, "num_samples": share.n}
    return {
        "evaluation_name": title,
        "source_data": source,
        "metric_config": {
            "metric_id": f"{_LIBRARY}.{name}",
            "metric_name": name,
            "metric_unit": "proportion",
            "evaluation_description": _MEANINGS[name],
            "lower_is_better": False,
            "score_type": "continuous",
            "min_score": 0,
            "max_score": 1,
        },
        "score_details": score,
    }


def _version(run: Run) -> str:
    versions = run.results.get("versions")
    return str(versions.get(_LIBRARY) if isinstance(versions, Mapping) else "unknown")
