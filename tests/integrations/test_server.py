"""The reward server: nothing lost, nothing answered twice, whatever dies; limits, token, the interface of cosmos-rl."""

import asyncio
import contextlib
import io
import json
import os
import random
import signal
from collections import Counter
from contextlib import asynccontextmanager

import httpx
import numpy as np
import pytest

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.executors.queue import JobQueue
from kinebench_drake.integrations import server
from kinebench_drake.integrations.server import ClipWorkerFactory, RewardService
from tests.fakes.clip_worker import FakeClipWorker

CLIPS = 200
CLIENTS = 8
KILLS = 6


@asynccontextmanager
async def running(tmp_path, *, workers=2, most=64, most_bytes=10_000, timeout_s=60.0, token=None, seconds=0.02):
    jobs = JobQueue(FakeClipWorker(tmp_path / "notes", seconds), workers=workers, most=most, timeout_s=timeout_s)
    app = RewardService(jobs, most_bytes=most_bytes, token=token).app
    try:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://server") as client:
            yield client, jobs
    finally:
        jobs.close()


async def ask(client, body, **params):
    return await client.post("/score", content=body, params=params)


async def settle(client, id):
    while (answer := await client.get(f"/jobs/{id}")).status_code == 202:
        await asyncio.sleep(0.05)
    return answer.json()


@pytest.mark.slow
def test_every_clip_of_eight_clients_is_answered_once_while_workers_are_killed(tmp_path):
    async def run():
        ids = {}

        async def send(client, own):
            for number in own:
                while (answer := await ask(client, str(number))).status_code == 429:
                    await asyncio.sleep(0.1)
                assert answer.status_code == 202
                ids[number] = answer.json()["id"]

        async def kill(jobs):
            rng = random.Random(0)
            for _ in range(KILLS):
                while not jobs.pids:
                    await asyncio.sleep(0.05)
                await asyncio.sleep(1.0)
                with_process = jobs.pids
                if with_process:
                    with contextlib.suppress(ProcessLookupError):  # it ended in the meantime
                        os.kill(rng.choice(with_process), signal.SIGKILL)

        async with running(tmp_path, workers=3, most=50) as (client, jobs):
            clients = [send(client, range(k, CLIPS, CLIENTS)) for k in range(CLIENTS)]
            await asyncio.gather(kill(jobs), *clients)
            answers = {number: await settle(client, id) for number, id in ids.items()}
            return answers, dict(jobs.counts), jobs.open

    answers, counts, unanswered = asyncio.run(run())
    assert len(answers) == CLIPS
    assert {number: answer["reward"] for number, answer in answers.items()} == {n: float(n) for n in range(CLIPS)}
    assert len({answer["id"] for answer in answers.values()}) == CLIPS
    assert (counts["answered"], counts["failed"], unanswered) == (CLIPS, 0, 0)
    assert counts["deaths"] >= 1
    processed = Counter((tmp_path / "notes").read_text().split())
    assert len(processed) == CLIPS
    assert (
        sum(processed.values()) - CLIPS <= counts["deaths"]
    )  # a clip is scored again only if its process died over it


def test_clips_that_fail_are_answered_with_their_reason(tmp_path):
    async def run():
        async with running(tmp_path, timeout_s=5.0, workers=3) as (client, jobs):
            ids = [(await ask(client, body)).json()["id"] for body in ("crash", "slow", "0.5")]
            return [await settle(client, id) for id in ids], dict(jobs.counts)

    (crash, slow, good), counts = asyncio.run(run())
    [reason] = crash["reasons"]
    assert "3 processes ended over this item" in reason
    assert slow["reasons"] == ["took more than 5 s"]
    assert (crash["reward"], slow["reward"], good["reward"]) == (0.0, 0.0, 0.5)
    assert counts == {"answered": 1, "failed": 2, "deaths": 4}


def test_an_error_of_any_kind_is_an_answer_and_the_worker_goes_on(tmp_path):
    async def run():
        async with running(tmp_path, workers=1) as (client, jobs):
            ids = [(await ask(client, body)).json()["id"] for body in ("no number", "0.5")]
            return [await settle(client, id) for id in ids], dict(jobs.counts)

    (wrong, good), counts = asyncio.run(run())
    assert "could not convert string to float" in wrong["reasons"][0]
    assert (wrong["reward"], good["reward"]) == (0.0, 0.5)
    assert (counts["answered"], counts["failed"]) == (1, 1)


def test_limits_and_wrong_requests_have_their_status(tmp_path, monkeypatch):
    monkeypatch.setattr(server, "MOST_TICKETS", 2)

    async def run():
        async with running(tmp_path, most=2, workers=1, most_bytes=100, seconds=0.5) as (client, _):
            statuses = [(await ask(client, b"x" * 101)).status_code]
            statuses += [(await ask(client, b"1", period_s="a")).status_code]
            first, second, third = [await ask(client, b"1") for _ in range(3)]
            statuses += [first.status_code, second.status_code, third.status_code]
            assert third.headers["Retry-After"] == "1"
            await settle(client, second.json()["id"])
            assert (await settle(client, (await ask(client, b"0.25")).json()["id"]))["reward"] == 0.25
            statuses.append((await client.get(f"/jobs/{first.json()['id']}")).status_code)  # forgotten
            metrics = (await client.get("/metrics")).text
            health = (await client.get("/health")).json()
            return statuses, metrics, health

    statuses, metrics, health = asyncio.run(run())
    assert statuses == [413, 400, 202, 202, 429, 404]
    assert "# TYPE kinebench_answered_total counter\nkinebench_answered_total 3\n" in metrics
    assert "# TYPE kinebench_open_clips gauge\nkinebench_open_clips 0\n" in metrics
    assert health == {"status": "ok", "workers": 1, "open": 0}


def test_a_token_guards_all_but_the_health(tmp_path):
    async def run():
        async with running(tmp_path, token="secret") as (client, _):
            paths = ("/jobs/a", "/metrics", "/health")
            without = [(await client.get(path)).status_code for path in paths]
            bearer = {"Authorization": "Bearer secret"}
            return without, [(await client.get(path, headers=bearer)).status_code for path in paths]

    assert asyncio.run(run()) == ([401, 401, 200], [404, 200, 200])


class FakeScores(FakeClipWorker):
    """Reward: the mean grey level of the npy file."""

    def work(self, request):
        frames = np.load(io.BytesIO(request.body))
        assert request.period_s == 1.0 / 16.0
        return super().work(type(request)(body=f"{frames.mean() / 255.0:.2f}".encode()))


def test_batches_of_cosmos_rl_are_answered_in_its_form(tmp_path):
    clips = np.stack([np.full((3, 5, 8, 8), level, np.float32) for level in (-1.0, 0.5, 1.0)])
    data = {"media_type": "video", "prompts": ["a"] * 3, "reward_fn": {"executability": 1.0}}
    line = json.dumps({**data, "video_infos": [{"video_fps": 16.0}] * 3}).encode()
    file = io.BytesIO()
    np.save(file, clips)

    async def run():
        jobs = JobQueue(FakeScores(tmp_path / "notes"), workers=1)
        app = RewardService(jobs, most_bytes=100_000).app
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://server") as client:
            answer = await client.post("/api/reward/enqueue", content=line + b"\n" + file.getvalue())
            form = {"uuid": answer.json()["uuid"], "type": "executability"}
            while (pulled := await client.post("/api/reward/pull", data=form)).status_code == 400:
                await asyncio.sleep(0.05)
            latents = io.BytesIO()
            np.save(latents, np.zeros((2, 16, 3, 4, 4)))
            refused = await client.post("/api/reward/enqueue", content=line + b"\n" + latents.getvalue())
        jobs.close()
        return pulled.json(), refused

    pulled, refused = asyncio.run(run())
    assert pulled["scores"] == {"executability": [0.0, 0.5, 1.0]}
    assert set(pulled) == {"scores", "input_info", "duration", "decoded_duration", "type"}
    assert refused.status_code == 400


def test_the_worker_reads_frames_and_refuses_damaged_files(tmp_path):
    file = io.BytesIO()
    np.savez(file, frames=np.zeros((9, 96, 96, 3), np.uint8), period_s=0.1, motion_m=0.3)
    work = ClipWorkerFactory(camera="benchmark", period_s=0.2)()
    score = work(server.ClipRequest(body=file.getvalue()))
    assert (score.reward, score.executable) == (0.0, None)
    for damaged in (file.getvalue()[:-100], b"x"):
        with pytest.raises(InputError):
            work(server.ClipRequest(body=damaged))
    with pytest.raises(UsageError, match="period_s"):
        work(server.ClipRequest(body=file.getvalue(), period_s=-1.0))
