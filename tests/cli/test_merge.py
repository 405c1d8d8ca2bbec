"""Shards of real runs with fake analyzer, merged by the program and gone on from."""

import os
import shlex
import subprocess
from pathlib import Path

import pytest

from kinebench_drake.results.store import read_rows
from tests.fakes.records import content

EXAMPLES = Path(__file__).parent.parent.parent / "examples"


@pytest.mark.parametrize("command", ["score", "ground"])
def test_merged_shards_equal_one_run_byte_by_byte(film, program, fakes, tmp_path, command):
    behaviors = ({}, {"feasible": False}, {"has_gripper": False}, {"raises": RuntimeError()}, {})
    for k, behavior in enumerate(behaviors):
        film(f"videos/v{k}.mp4", side=160, **behavior)
    shared = [command, tmp_path / "videos", "--overlay", "--tag", "run=7", "--model", "m"]
    program(*shared, "--out", tmp_path / "whole")
    parts = [tmp_path / f"part{k}" for k in (1, 2, 3)]
    for k, part in enumerate(parts, 1):
        program(*shared, "--out", part, "--shard", f"{k}/3")
    code, said, err = program("merge", *parts, "--out", tmp_path / "out")
    assert (code, err) == (0, "")
    reason = "unmeasurable: 1 of 5 samples: no Franka hand is found in any of"
    assert reason in said
    assert "; error: 1 of 5 samples: " in said
    assert content(tmp_path / "out") == content(tmp_path / "whole")

    code, _, err = program("merge", *parts[:2], "--out", tmp_path / "most")
    assert (code, err) == (0, "warning: 1 of 5 samples are absent: no folder is of shard 3/3\n")
    fakes.take_calls()
    program(*shared, "--out", tmp_path / "most")
    assert content(tmp_path / "most") == content(tmp_path / "whole")
    assert len(fakes.take_calls()) == 2  # the absent one, and the one that had failed


def test_shards_of_different_configurations_are_refused_in_one_line(film, program, refusal, tmp_path):
    film("videos/a.mp4")
    program("score", tmp_path / "videos", "--out", tmp_path / "one")
    program("score", tmp_path / "videos", "--out", tmp_path / "two", "--frame-period", "0.1")
    line = refusal("merge", tmp_path / "one", tmp_path / "two", "--out", tmp_path / "out")
    assert "frame_period_s is null and 0.1" in line
    assert read_rows(tmp_path / "one").keys() == {"a"}
    for arguments in ([], ["--out", tmp_path / "out"], [tmp_path / "videos", "--out", tmp_path / "out"]):
        assert program("merge", *arguments)[0] == 2


def test_the_slurm_example_uses_existing_commands_and_options(program, tmp_path):
    """Every array task does its shard, the last step merges them."""
    said = tmp_path / "said"
    said.write_text('#!/usr/bin/env bash\nprintf "%s\\n" "$@"\n')
    said.chmod(0o755)
    (tmp_path / "shards" / "3").mkdir(parents=True)
    told = {"VIDEOS": "videos", "RESULTS": str(tmp_path), "KINEBENCH": str(said), "PATH": os.environ["PATH"]}
    told |= {"SLURM_ARRAY_TASK_ID": "3", "SLURM_CPUS_PER_TASK": "8"}
    script = EXAMPLES / "cluster" / "score.sbatch"
    calls = {
        step: subprocess.run(
            ["bash", script, *step], env=told, capture_output=True, text=True, check=True
        ).stdout.split()
        for step in ((), ("merge",), ("--seed", "3"))
    }
    assert calls[()][-4:] == ["--shard", "3/16", "--jobs", "8"]
    assert calls[("--seed", "3")] == [*calls[()], "--seed", "3"]
    assert calls[("merge",)] == ["merge", f"{tmp_path}/shards/3", "--out", f"{tmp_path}/merged"]
    assert "videos: there is no such file" in program(*calls[()])[2]
    assert "holds no samples.jsonl" in program(*calls[("merge",)])[2]


def test_the_rounds_example_submits_each_job_after_the_one_before(program, tmp_path):
    """Export, then by turns a job of the model and one of the benchmark, which asks for the next videos."""
    (tmp_path / "bin").mkdir()
    fake = tmp_path / "bin" / "sbatch"
    fake.write_text('#!/usr/bin/env bash\nprintf "%s\\0" "$@" >>"$LOG"; echo >>"$LOG"\nwc -l <"$LOG"\n')
    fake.chmod(0o755)
    told = {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "LOG": str(tmp_path / "log"), "ROUNDS": "2"}
    told |= {"GENERATE": "generate.sbatch", "VIDEOS": str(tmp_path / "my videos"), "RESULTS": str(tmp_path / "out")}
    script = EXAMPLES / "cluster" / "rounds.sh"
    last = subprocess.run(
        ["bash", script, "--suite", "0", "--episodes", "20"], env=told, capture_output=True, text=True, check=True
    ).stdout
    jobs = [line.split("\0")[:-1] for line in (tmp_path / "log").read_text().splitlines()]
    assert last.split() == ["5"]
    after = [[word for word in job if word.startswith("--dependency")] for job in jobs]
    assert after == [[], *([f"--dependency=afterok:{k}"] for k in range(1, 5))]
    videos = told["VIDEOS"]
    assert jobs[1][-3:] == ["generate.sbatch", f"{videos}/manifest.jsonl", videos]
    assert jobs[3][-3:] == ["generate.sbatch", f"{tmp_path}/out/ask/manifest.jsonl", videos]
    export, *runs = (shlex.split(job[job.index("--wrap") + 1]) for job in (jobs[0], jobs[2], jobs[4]))
    assert export[:6] == ["kinebench-drake", "suite", "export", "--suite", "0", "--episodes"]
    assert runs[0] == runs[1]
    assert f"--world-model folder:{videos}: expected folder:DIR" in program(*runs[0][1:])[2]
