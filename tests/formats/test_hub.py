"""Data sets of the Hub: fetched once from a server that speaks its protocol, then read from the cache."""

import hashlib
import json
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import urlsplit

import numpy as np
import pytest
from huggingface_hub import constants

from kinebench_drake.errors import UsageError
from kinebench_drake.formats.hub import find_source
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.container import write_video
from kinebench_drake.runs.audit import AuditConfig
from kinebench_drake.runs.config import ScoreConfig

COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """A server of the data set lab/set with the tag v1; returns the files that were fetched from it."""
    root = tmp_path / "hub"
    fetched = []
    write_video(root / "videos" / "clip.mp4", np.zeros((4, 64, 64, 3), np.uint8), 10)
    (root / "tracks").mkdir()
    np.savez(root / "tracks" / "swing.npz", t_s=np.arange(5) * 0.1, q=np.zeros((5, 7)))

    class Hub(BaseHTTPRequestHandler):
        def answer(self, data, **headers):
            self.send_response(200 if data is not None else 404)
            for name, value in {**headers, "Content-Length": len(data or b"")}.items():
                self.send_header(name.replace("_", "-"), str(value))
            self.end_headers()
            if self.command == "GET":
                self.wfile.write(data or b"")

        def do_GET(self):
            path = urlsplit(self.path).path
            if path == "/api/datasets/lab/set/revision/v1":
                return self.answer(json.dumps({"id": "lab/set", "sha": COMMIT}).encode())
            if path == f"/api/datasets/lab/set/tree/{COMMIT}":
                files = [p for p in root.rglob("*") if p.is_file()]
                listing = [
                    {"type": "file", "path": p.relative_to(root).as_posix(), "size": p.stat().st_size, "oid": "0" * 40}
                    for p in files
                ]
                return self.answer(json.dumps(listing).encode())
            name = path.removeprefix(f"/datasets/lab/set/resolve/{COMMIT}/")
            if name == path or not (root / name).is_file():
                return self.answer(None)
            fetched.extend([name] * (self.command == "GET"))
            data = (root / name).read_bytes()
            return self.answer(data, ETag=f'"{hashlib.sha256(data).hexdigest()}"', X_Repo_Commit=COMMIT)

        do_HEAD = do_GET

        def log_message(self, *_):
            """Keep the output of the tests clean."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Hub)
    Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}"
    monkeypatch.setattr(constants, "ENDPOINT", address)
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", address + "/{repo_id}/resolve/{revision}/{filename}")
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    yield fetched
    server.shutdown()


def test_videos_and_trajectories_of_a_revision_are_read_and_fetched_once(hub):
    (sample,) = find_samples(Path("hf://datasets/lab/set@v1")).samples
    (track,) = find_trajectories(Path("hf://datasets/lab/set@v1/tracks"), TrajectoryOptions())
    assert (sample.id, sample.video, track.id) == ("clip", "videos/clip.mp4", "swing")
    assert sorted(hub) == ["tracks/swing.npz", "videos/clip.mp4"]


def test_a_part_of_a_data_set_is_fetched_alone(hub):
    assert find_source(Path("hf://datasets/lab/set@v1/videos/clip.mp4")).stat().st_size > 0
    assert hub == ["videos/clip.mp4"]


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("hf://datasets/lab", "expected hf://datasets/ORG/NAME, with @REVISION or /FOLDER"),
        ("hf://models/lab/set", "expected hf://datasets/ORG/NAME"),
        ("hf://datasets/lab/set@v1/../../etc", "expected hf://datasets/ORG/NAME"),
        ("hf://datasets/lab/set@v2", "cannot be fetched"),
        ("hf://datasets/lab/set@v1/absent", "holds no such file or folder"),
    ],
)
def test_an_address_that_leads_nowhere_is_refused_in_one_line(hub, address, message):
    with pytest.raises(UsageError, match=message) as refusal:
        find_source(Path(address))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("config", [ScoreConfig, AuditConfig])
def test_results_name_the_address(config, tmp_path):
    source = "hf://datasets/lab/set@v1/tracks"
    assert config(source=source, out=tmp_path).to_json()["source"] == source
