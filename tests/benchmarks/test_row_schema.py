"""The schema and the table of keys are those of the model."""

import json
from pathlib import Path

import pytest

from benchmarks.row_schema import SCHEMA, make_schema, make_table
from kinebench_drake.errors import InputError
from kinebench_drake.results.row import KEYS, SampleRow
from tests.rows import make_row

ROOT = Path(__file__).parents[2]


def test_the_shipped_schema_and_the_page_are_those_of_the_model() -> None:
    assert json.loads((ROOT / SCHEMA).read_text()) == make_schema()
    assert make_table() in (ROOT / "docs" / "formats.md").read_text()


def test_every_key_has_a_meaning_and_those_of_every_row_are_required() -> None:
    schema = make_schema()
    assert schema["required"] == list(KEYS)
    assert all(about["description"].endswith(".") for about in schema["properties"].values())


def test_keys_of_newer_versions_keep_their_places() -> None:
    data = make_row(extra={"seed": None, "fps": 17.0}).to_json()
    newer = {"first": [1, {"x": None}], **data, "line": 3, "frames": 4, "last": "y"}
    assert list(SampleRow.from_json(newer).to_json()) == [*KEYS, "first", "seed", "fps", "line", "frames", "last"]
    assert SampleRow.from_json(newer).to_json() == newer


@pytest.mark.parametrize(("key", "value"), [("frames", 1.5), ("frames", True), ("cause", {}), ("clip_frames", ["a"])])
def test_a_value_of_another_type_is_refused_by_its_key(key: str, value: object) -> None:
    with pytest.raises(InputError, match=key):
        make_row(extra={key: value})
    with pytest.raises(InputError, match=key):
        SampleRow.from_json({**make_row().to_json(), key: value})
