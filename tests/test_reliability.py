"""What may go wrong around a run - disk, clock, signals, hostile names - and what the sources never do."""

import ast
import errno
import json
import os
import signal
import threading
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake import storage
from kinebench_drake.camera import Camera
from kinebench_drake.engines import Done
from kinebench_drake.engines.local import LocalEngine
from kinebench_drake.errors import InputError, SetupError, UsageError, one_line
from kinebench_drake.inputs import find_samples
from kinebench_drake.interrupt import patient
from kinebench_drake.manifest import inside
from kinebench_drake.plainfile import parse_json, read_bytes
from kinebench_drake.report import write_report
from kinebench_drake.results import ResultStore, read_rows
from kinebench_drake.row import Status
from kinebench_drake.suite_report import write_suite_report
from tests.report.pages import Page, row
from tests.suite_report.synthetic import write_run

ROOT = Path(__file__).parent.parent
SOURCES = sorted(
    path
    for folder in ("kinebench_drake", "grounding", "models", "suites", "examples")
    for path in (ROOT / folder).rglob("*.py")
    if path.resolve() == path
)


@cache
def syntax(path: Path) -> ast.Module:
    """The syntax tree of a source."""
    return ast.parse(path.read_text())


def dotted(node: ast.expr) -> str:
    """The name that is called, such as `os.system`."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "?"


def literal(call: ast.Call, name: str) -> object:
    """The constant given for a keyword; None where there is none."""
    found = next((k.value for k in call.keywords if k.arg == name), None)
    return found.value if isinstance(found, ast.Constant) else None


FORBIDDEN = {
    *("eval", "exec", "compile", "__import__", "os.system", "os.popen", "os.execv", "os.execvp", "os.spawnl"),
    *("subprocess.getoutput", "subprocess.getstatusoutput", "torch.load", "torch.save", "torch.jit.load"),
    *(
        "joblib.load",
        "yaml.load",
        "yaml.unsafe_load",
        "marshal.loads",
        "marshal.load",
        "np.fromregex",
        "tempfile.mktemp",
    ),
    *("zipfile.ZipFile.extractall", "shutil.unpack_archive", "pandas.read_pickle", "pd.read_pickle"),
}
ALLOWED = {"models/perception/network.py": ["calls torch.load"]}
"""The encoder's first weights, for training alone: a file of a pinned package, read with weights_only."""
MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "yaml"}


def faults(tree: ast.AST):
    """What a module does that may run or load what an input says."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (f"imports {a.name}" for a in node.names if a.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            yield f"imports {node.module}"
        elif isinstance(node, ast.Call):
            name = dotted(node.func)
            if name in FORBIDDEN or name.rsplit(".", 1)[-1] == "extractall":
                yield f"calls {name}"
            if literal(node, "shell"):
                yield f"calls {name} with a shell"
            if literal(node, "allow_pickle") and not name.startswith("np.lib.format.write_array"):
                yield f"calls {name} with allow_pickle"


@pytest.mark.parametrize(
    "text",
    [
        *("import pickle", "from pickle import loads", "eval('1')", "os.system('ls')", "torch.load('a.pt')"),
        *("subprocess.run('ls', shell=True)", "np.load('a', allow_pickle=True)", "archive.extractall()"),
    ],
)
def test_the_search_finds_what_it_looks_for(text):
    assert list(faults(ast.parse(text)))


def test_no_source_loads_pickles_or_runs_what_an_input_says():
    found = {path.relative_to(ROOT).as_posix(): list(faults(syntax(path))) for path in SOURCES}
    assert {name: told for name, told in found.items() if told} == ALLOWED


def test_weights_are_safetensors_only():
    kept = [
        p.name for p in (ROOT / "models").rglob("*") if p.suffix in (".pt", ".pth", ".pkl", ".ckpt", ".bin", ".npy")
    ]
    assert kept == []
    assert list((ROOT / "models").rglob("*.safetensors"))


# What users hand in


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "/etc/passwd", "a/../../b.mp4", "out.mp4", "a\0b.mp4", "up/b.mp4"]
)
def test_a_manifest_leads_nowhere_else(tmp_path, name):
    folder = tmp_path / "in"
    folder.mkdir()
    (tmp_path / "b.mp4").write_bytes(b"x")
    (folder / "out.mp4").symlink_to(tmp_path / "b.mp4")
    (folder / "up").symlink_to(tmp_path)
    with pytest.raises(InputError, match=r"relative path|leads out|cannot be followed"):
        inside(folder, name, "video")
    (folder / "manifest.jsonl").write_text(json.dumps({"video": name}) + "\n")
    (sample,) = find_samples(folder / "manifest.jsonl").samples
    assert sample.problem is not None
    assert sample.path == folder


@pytest.mark.parametrize(
    "name", ["camera.json", "manifest.jsonl", "metadata.csv", "clip.mp4", "clip.npz", "frames/0.png"]
)
def test_a_pipe_is_not_waited_for(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    os.mkfifo(tmp_path / name)
    done = threading.Event()

    def read():
        try:
            source = tmp_path / name if name.endswith(("jsonl", "npz")) else tmp_path
            from kinebench_drake.grounding.video import read_video

            for sample in find_samples(source).samples:
                read_video(sample.path, sample.part)
        except (InputError, UsageError):
            pass
        done.set()

    threading.Thread(target=read, daemon=True).start()
    assert done.wait(30)


def test_an_endless_file_is_not_read(tmp_path):
    (tmp_path / "camera.json").symlink_to("/dev/zero")
    with pytest.raises(UsageError, match="regular file"):
        Camera.load(tmp_path / "camera.json")
    (tmp_path / "big").write_bytes(b"x" * 11)
    with pytest.raises(OSError, match="Larger"):
        read_bytes(tmp_path / "big", most=10)


def test_deep_json_and_long_numbers_are_values_or_refused():
    with pytest.raises(ValueError, match="deep"):
        parse_json("[" * 100_000)
    assert parse_json("[1, " + "9" * 400 + "]") == [1, float("inf")]
    with pytest.raises(ValueError, match="Expecting"):
        parse_json(b"")


def test_a_playlist_is_no_film(tmp_path):
    from kinebench_drake.grounding.decoded import WHOLE
    from kinebench_drake.grounding.film import read_film
    from kinebench_drake.mp4 import write_video

    write_video(tmp_path / "real.mp4", np.zeros((3, 96, 96, 3), np.uint8), 10)
    (tmp_path / "list.mp4").write_text("ffconcat version 1.0\nfile real.mp4\n")
    assert len(read_film(tmp_path / "real.mp4", WHOLE).frames) == 3
    with pytest.raises(InputError, match="not a readable video"):
        read_film(tmp_path / "list.mp4", WHOLE)


def test_errors_are_one_plain_line_whatever_names_they_repeat():
    text = str(InputError("a\nb\x1b[2Jc\u202ed\udcff" + "x" * 5000))
    assert text.isprintable()
    assert text.startswith("a b\\x1b[2Jc\\u202ed\\udcff")
    assert len(text) <= 1000
    assert one_line("plain") == "plain"


# Html


HOSTILE = [
    "<script>alert(1)</script>",
    "a\"onload='x",
    "</script><img src=x onerror=alert(1)>",
    "{{7*7}}",
    "<!--",
    "&lt;",
]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_report_shows_names_and_runs_none(tmp_path, name):
    fault = {"kind": name, "frame_start": 0, "frame_end": 1, "joint": 2, "value": 2.0, "limit": 1.0}
    texts = {"prompt": name, "warnings": [name], "given": {name: name}}
    with ResultStore(tmp_path / "out") as store:
        for id, changes in {
            "a": {"violations": (fault,), "feasible": False, "details": {name: {name: name}}, "extra": texts},
            "b": {"status": Status.ERROR, "reason": name},
        }.items():
            store.append(row(id, task=name, model=name, video=name, null_reasons={name: name}, **changes), 0.1)
        results = {"kind": "score", "config": {"source": name}, "tags": {name: name}, "versions": {name: name}}
        store.finish(results)
    page = Page(write_report(tmp_path / "out").read_text())
    clean(page)


def test_a_suite_report_shows_names_and_runs_none(tmp_path):
    for k, name in enumerate(HOSTILE):
        write_run(tmp_path / str(k), {name: [True, False], "T": [True, True]}, model=name, tags={"k": name})
    page = Page(write_suite_report([tmp_path / str(k) for k in range(len(HOSTILE))], tmp_path / "page").read_text())
    clean(page)


def clean(page: Page) -> None:
    """The page holds as many scripts as one of plain names, loads nothing, and no tag of a name became one."""
    assert page.scripts <= 2
    assert all(
        link.startswith(("data:", "#", "replays/", "tracks/", "overlays/", "figures/")) or "/" not in link
        for link in page.links
    )
    assert "x" not in page.links


# Disk


def full(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def filled(out, ids="ab"):
    with ResultStore(out) as store:
        for id in ids:
            store.append(row(id), 0.1)


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path, monkeypatch):
    filled(tmp_path)
    with ResultStore(tmp_path) as store, monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(SetupError, match="free some space and run the same command again"):
            store.append(row("c"), 0.1)
        with pytest.raises(SetupError, match="free some space"):
            store.finish({})
    assert sorted(read_rows(tmp_path)) == ["a", "b"]
    assert not [p for p in tmp_path.rglob("*") if ".part." in p.name]
    with ResultStore(tmp_path) as store:
        store.append(row("c"), 0.1)
        store.finish({"kind": "score"})
    assert sorted(read_rows(tmp_path)) == ["a", "b", "c"]


def test_a_disk_that_fills_amid_a_line_keeps_whole_lines(tmp_path):
    """With a true limit of the system: a file may grow to so many bytes and no more."""
    import resource

    filled(tmp_path)
    limit = (tmp_path / "samples.jsonl").stat().st_size + 40
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with ResultStore(tmp_path) as store:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
            with pytest.raises(SetupError, match="cannot write"):
                store.append(row("c"), 0.1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert sorted(read_rows(tmp_path)) == ["a", "b"]
    assert (tmp_path / "samples.jsonl").read_bytes().endswith(b"\n")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_told(tmp_path):
    out = tmp_path / "out"
    filled(out)
    out.chmod(0o500)
    try:
        with pytest.raises(UsageError, match="cannot be written"):
            ResultStore(out)
    finally:
        out.chmod(0o700)


def test_a_folder_that_cannot_be_written_is_told(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    filled(tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", refuse)
        with pytest.raises(UsageError, match=r"--out .* cannot be written \(Read-only file system\)"):
            ResultStore(tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", refuse)
        with pytest.raises(SetupError, match="make the folder writable"):
            storage.write_atomically(tmp_path / "out" / "x", b"1")
    assert sorted(read_rows(tmp_path / "out")) == ["a", "b"]


# Clock


@pytest.mark.parametrize("jump_s", [-1e9, 1e9, -3600.0])
def test_a_clock_that_jumps_changes_no_time_and_no_result(tmp_path, monkeypatch, jump_s):
    from kinebench_drake.suites.worldmodels.deadline import Deadline

    true, calls = time.time, iter(range(10**9))
    monkeypatch.setattr(time, "time", lambda: true() + jump_s * (next(calls) % 2))
    deadline = Deadline(60.0)
    assert 59.0 < deadline.left() <= 60.0
    filled(tmp_path)
    for path in tmp_path.iterdir():
        os.utime(path, (true() + jump_s, true() + jump_s))
    with ResultStore(tmp_path) as store:
        assert sorted(store.rows) == ["a", "b"]
        store.append(row("c"), 0.1)
        store.finish({"kind": "score"})
    walls = [json.loads(line)["wall_s"] for line in (tmp_path / "timings.jsonl").read_text().splitlines()]
    assert all(wall >= 0 for wall in walls)


def test_durations_are_measured_by_clocks_that_do_not_jump():
    """No source measures with the clock on the wall."""
    for path in SOURCES:
        called = {dotted(node.func) for node in ast.walk(syntax(path)) if isinstance(node, ast.Call)}
        assert "time.time" not in called, path


# Signals


def make_slow():
    def work(item):
        if item == 0:
            signal.raise_signal(signal.SIGINT)
            time.sleep(0.05)
        return item

    return work


def test_the_first_interrupt_finishes_what_is_at_hand_and_begins_no_more():
    engine, told = LocalEngine(jobs=1), []
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with patient(engine.drain, told.append) as asked:
            found = [outcome.result for outcome in engine.run(make_slow, [0, 1, 2]) if isinstance(outcome, Done)]
            assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        assert asked.is_set()
        assert found == [0]
        give_up = time.monotonic() + 10
        while not told and time.monotonic() < give_up:
            time.sleep(0.01)
        assert "press Ctrl-C again to stop at once" in told[0]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_handler_of_the_programs_own_stays():
    mine = lambda *_: None  # noqa: E731
    before = signal.signal(signal.SIGINT, mine)
    try:
        with patient(lambda: None, print):
            assert signal.getsignal(signal.SIGINT) is mine
    finally:
        signal.signal(signal.SIGINT, before)


# Fuzz


@pytest.mark.slow
def test_the_same_seed_gives_the_same_inputs_and_readers_stand_them(tmp_path):
    from kinebench_drake.validation.fuzz.campaign import Campaign, distinct

    one = Campaign(5)
    assert [one.draw(n) for n in range(40)] == [Campaign(5).draw(n) for n in range(40)]
    trials = list(one.run(range(40), tmp_path))
    assert not distinct(trials)
    assert {t.outcome.fate.value for t in trials} == {"read", "refused"}


def test_a_fuzzed_input_that_fails_is_kept(tmp_path, monkeypatch):
    from kinebench_drake.validation.fuzz import campaign
    from kinebench_drake.validation.fuzz.worker import Fate, Outcome

    class Broken:
        def __init__(self, home):
            pass

        def read(self, kind, folder):
            return Outcome(fate=Fate.TRACEBACK, told="boom\nValueError: no")

        def close(self):
            pass

    monkeypatch.setattr(campaign, "Worker", Broken)
    (trial,) = campaign.Campaign(0).run([3], tmp_path)
    kept = json.loads((tmp_path / "failures" / "000003" / "failure.json").read_text())
    assert (kept["seed"], kept["number"], kept["fate"]) == (0, 3, "traceback")
    assert list(campaign.distinct([trial])) == ["traceback: ValueError: no"]
