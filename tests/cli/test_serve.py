"""`serve` as a program: it listens on this machine alone, and guards what others can reach."""

import subprocess
import sys

import httpx
import pytest
from click.testing import CliRunner

from kinebench_drake.cli.serve import serve
from kinebench_drake.errors import UsageError


def test_other_machines_need_a_token(monkeypatch):
    monkeypatch.delenv("KINEBENCH_TOKEN", raising=False)
    with pytest.raises(UsageError, match=r"--host 0\.0\.0\.0: .* --token-file"):
        CliRunner().invoke(serve, ["--port", "0", "--host", "0.0.0.0"], catch_exceptions=False)


def test_the_program_says_where_it_listens_and_asks_for_its_token(tmp_path):
    token = tmp_path / "token"
    token.write_text("secret\n")
    command = [sys.executable, "-m", "kinebench_drake", "serve", "--port", "0", "--token-file", str(token)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            url = server.stdout.readline().split()[-1]
            assert url.startswith("http://127.0.0.1:")
            assert httpx.get(f"{url}/health", timeout=60.0).json()["status"] == "ok"
            bearer = {"Authorization": "Bearer secret"}
            statuses = [httpx.get(f"{url}/metrics", headers=h, timeout=60.0).status_code for h in ({}, bearer)]
            assert statuses == [401, 200]
        finally:
            server.kill()
