"""Bundles: equal folders give equal bytes, and an archive that is not sound is refused before anything is written."""

import json
import os
import stat
import zipfile

import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.io.archive import write_zip
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.results.bundle import open_bundle, write_bundle
from kinebench_drake.results.store import ResultStore
from tests.report.pages import row

METADATA = {
    **{"schema_version": 2, "suite_version": None, "kind": "score", "samples_found": 2, "config": {}, "tags": {}},
    **{"seeds": {"bootstrap": 0}, "versions": {}, "code_sha256": "", "weights_sha256": "", "host": {}},
}
MANIFEST = json.dumps({"bundle_version": 1, "files": {}, "videos": {}}).encode()
SOUND = {"bundle.json": MANIFEST, "results.json": b"{}", "samples.jsonl": b""}


@pytest.fixture
def run(tmp_path):
    with ResultStore(tmp_path / "run") as store:
        for id, digest in (("b", "11" * 32), ("a", None)):
            store.append(row(id, extra={"input_sha256": digest}), 0.1)
        store.finish(METADATA)
    write_atomically(tmp_path / "run" / "tracks" / "a.npz", b"track")
    write_atomically(tmp_path / "run" / "overlays" / "a.mp4", b"film")
    return tmp_path / "run"


def test_a_bundle_holds_the_results_with_their_hashes_and_those_of_the_videos(run, tmp_path):
    write_bundle(run, tmp_path / "r.zip")
    with open_bundle(tmp_path / "r.zip") as bundle:
        assert bundle.files.keys() == {"bundle.json", "results.json", "samples.jsonl", "tracks/a.npz"}
        assert bundle.stated == {name: digest for name, digest in bundle.files.items() if name != "bundle.json"}
        assert bundle.videos == {"b.mp4": "11" * 32}
        assert (bundle.folder / "tracks" / "a.npz").read_bytes() == b"track"
        assert bundle.folder.name == "r"
    assert not bundle.folder.exists()


def test_equal_folders_give_equal_bytes(run, tmp_path):
    write_bundle(run, tmp_path / "one.zip")
    os.utime(run / "results.json", (1, 1))
    (run / "timings.jsonl").write_text("")
    write_bundle(run, tmp_path / "two.zip")
    assert (tmp_path / "one.zip").read_bytes() == (tmp_path / "two.zip").read_bytes()


def test_an_unfinished_run_is_refused(run, tmp_path):
    (run / "results.json").rename(run / "run.json")
    with pytest.raises(UsageError, match="run the same command again to finish it"):
        write_bundle(run, tmp_path / "r.zip")
    assert not (tmp_path / "r.zip").exists()


def entry(name, **changes):
    info = zipfile.ZipInfo(name)
    for key, value in changes.items():
        setattr(info, key, value)
    return info


LINK = {"create_system": 3, "external_attr": (stat.S_IFLNK | 0o777) << 16}
HOSTILE = {
    "climbs out": [(entry("tracks/../../evil.npz"), b"x")],
    "absolute": [(entry("/tmp/evil.npz"), b"x")],
    "backslash": [(entry("tracks\\..\\evil.npz"), b"x")],
    "hidden": [(entry("tracks/.evil.npz"), b"x")],
    "stranger": [(entry("evil.py"), b"x")],
    "folder": [(entry("tracks/"), b"")],
    "deeper": [(entry("tracks/a/b.npz"), b"x")],
    "link": [(entry("tracks/a.npz", **LINK), b"/etc/passwd")],
    "twice": [(entry("tracks/a.npz"), b"x"), (entry("tracks/a.npz"), b"y")],
    "bomb": [(entry("tracks/a.npz", compress_type=zipfile.ZIP_DEFLATED), bytes(10**7))],
}


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("case", HOSTILE)
def test_an_unsound_entry_is_refused_in_one_line_and_nothing_is_written(case, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    with zipfile.ZipFile(tmp_path / "r.zip", "w") as archive:
        for name, data in SOUND.items():
            archive.writestr(name, data)
        for info, data in HOSTILE[case]:
            archive.writestr(info, data)
    with (
        pytest.raises(UsageError, match=r"cannot be read as a bundle: entry ") as refusal,
        open_bundle(tmp_path / "r.zip"),
    ):
        pass
    assert "\n" not in str(refusal.value)
    assert [path.name for path in tmp_path.rglob("*")] == ["r.zip", "temporary"]


def test_entries_that_share_their_bytes_are_refused(tmp_path):
    write_zip(tmp_path / "r.zip", {**SOUND, **{f"tracks/{k}.npz": b"x" * 100 for k in range(9)}})
    data = (tmp_path / "r.zip").read_bytes()
    size = (1000).to_bytes(4, "little") * 2
    (tmp_path / "r.zip").write_bytes(data.replace((100).to_bytes(4, "little") * 2, size))
    with pytest.raises(UsageError, match="overlap"), open_bundle(tmp_path / "r.zip"):
        pass


@pytest.mark.parametrize("cut", [0, 1, 30, 200])
def test_a_file_that_is_cut_off_is_refused(tmp_path, cut):
    write_zip(tmp_path / "r.zip", SOUND)
    (tmp_path / "r.zip").write_bytes((tmp_path / "r.zip").read_bytes()[:cut])
    with pytest.raises(UsageError, match="cannot be read as a bundle"), open_bundle(tmp_path / "r.zip"):
        pass


@pytest.mark.parametrize("name", SOUND)
def test_a_bundle_without_a_part_is_refused(tmp_path, name):
    write_zip(tmp_path / "r.zip", {other: data for other, data in SOUND.items() if other != name})
    with pytest.raises(UsageError, match=f"holds no {name}"), open_bundle(tmp_path / "r.zip"):
        pass
