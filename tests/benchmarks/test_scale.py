import pytest

from benchmarks.scale import figures, measure, section
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore, read_rows
from kinebench_drake.results.trackfile import write_track
from tests.results.test_store import make_track
from tests.rows import make_row


@pytest.mark.slow
def test_every_stage_of_a_small_run_is_measured(tmp_path):
    """Few rows: what is left of a run without its measurements ends, and its folders hold every sample."""
    template = tmp_path / "template"
    videos = tmp_path / "films"
    videos.mkdir()
    (videos / "a.mp4").write_bytes(b"not read")
    with ResultStore(template) as store:
        metrics = {"sparc": -1.5, "anomalies": []}
        fields = {"task": None, "model": None, "status": Status.OK, "reason": None, "content_hash": ""}
        store.append(make_row(id="a", video="a.mp4", feasible=True, metrics=metrics, **fields), 0.1)
        write_track(template / "tracks" / "a.npz", make_track(), None, {})
        store.finish({})
    work = tmp_path / "work"
    result = measure(videos, template, work, rows=40, jobs=1, log=lambda line: None)
    assert read_rows(work / "merged").keys() == read_rows(work / "results").keys()
    assert len(read_rows(work / "merged")) == 40
    assert [stage.stage for stage in result.stages][-1] == "merge of the shards"
    assert all(value > 0.0 for value in figures(result).values())
    assert "| merge of the shards |" in section(result)
