"""The HTTP client against a server that misbehaves."""

import gzip
import logging
import re
import time
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime
from pathlib import Path

import httpx
import pytest
from pydantic import SecretStr

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.worldmodels.http_client import Deadline, HttpClient
from kinebench_drake.suites.worldmodels.remote import Limits, ServiceError, is_loopback, retry_after, web_address
from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError
from tests.suites.worldmodels.servant import Reply, Servant


@pytest.fixture
def client(servant: Servant, hurried: Limits, keys: str) -> HttpClient:
    return HttpClient("it", servant.url, key=SecretStr(keys), limits=hurried)


def get(client: HttpClient, limit_s: float = 5.0) -> dict:
    return client.call("GET", "/x", Deadline(limit_s))


@pytest.mark.parametrize("status", [429, 500, 502, 503, 504])
def test_transient_http_errors_are_retried(client: HttpClient, servant: Servant, status: int) -> None:
    servant.routes["/x"] = [Reply(status=status), Reply({"a": 1})]
    assert get(client) == {"a": 1}
    assert len(servant.asked) == 2


@pytest.mark.parametrize("status", [400, 404, 409, 422, 501])
def test_permanent_http_errors_are_not_retried(client: HttpClient, servant: Servant, status: int) -> None:
    servant.routes["/x"] = [Reply({"code": "Bad", "message": "no"}, status=status)]
    with pytest.raises(ServiceError, match=f"it answered HTTP {status}: Bad: no") as caught:
        get(client)
    assert (caught.value.status, caught.value.code) == (status, "Bad")
    assert len(servant.asked) == 1


def test_retries_end_after_the_maximum_of_attempts(client: HttpClient, servant: Servant, hurried: Limits) -> None:
    servant.routes["/x"] = [Reply({"error": {"message": "out of\nmemory"}}, status=500)]
    with pytest.raises(ServiceError, match="HTTP 500: out of memory"):
        get(client)
    assert len(servant.asked) == hurried.attempts


def test_a_retry_after_beyond_the_deadline_fails_at_once(client: HttpClient, servant: Servant) -> None:
    servant.routes["/x"] = [Reply(status=429, headers={"Retry-After": "3600"}), Reply({})]
    start = time.monotonic()
    with pytest.raises(WorldModelError, match="HTTP 429"):
        get(client, limit_s=60)
    assert time.monotonic() - start < 30  # so long may not be waited: given up at once
    assert len(servant.asked) == 1


def test_retry_after_is_parsed_from_a_number_or_a_date() -> None:
    assert retry_after(" 7 ") == 7
    later = retry_after(format_datetime(datetime.now(UTC) + timedelta(seconds=100), usegmt=True))
    assert later == pytest.approx(100, abs=5)
    assert retry_after(format_datetime(datetime(2020, 1, 1, tzinfo=UTC), usegmt=True)) == 0
    for unusable in ("", "soon", "1 Jan 2030 0:0:0 +9999999999", f"1 Jan {'9' * 20} 0:0:0 GMT"):
        assert retry_after(unusable) is None
    assert retry_after("9" * 5000) == float("inf")


@pytest.mark.parametrize("status", [401, 403])
def test_a_refused_key_ends_the_run_and_is_masked_everywhere(
    client: HttpClient, servant: Servant, keys: str, status: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    servant.routes["/x"] = [Reply({"message": f"wrong key {keys}, sorry"}, status=status)]
    with pytest.raises(SetupError, match=r"wrong key \*\*\*, sorry") as caught:
        get(client)
    assert servant.asked[0].headers["Authorization"] == f"Bearer {keys}"
    told = f"{caught.value} {caught.value!r} {caplog.text} {client.__dict__}"
    assert caplog.text
    assert keys not in told


def test_a_key_is_sent_only_over_https_or_to_this_machine() -> None:
    key = SecretStr("secret")
    for base in ("https://example.org", "http://127.0.0.1:9", "http://localhost:9", "http://[::1]:9"):
        HttpClient("it", base, key=key).close()
    with pytest.raises(SetupError, match="only over https"):
        HttpClient("it", "http://example.org", key=key)


@pytest.mark.parametrize("status", [301, 302, 307, 308])
def test_calls_do_not_follow_redirects(client: HttpClient, servant: Servant, status: int) -> None:
    other = Servant()
    servant.routes["/x"] = [Reply(status=status, headers={"Location": f"{other.url}/y"})]
    with pytest.raises(ServiceError, match="redirects"):
        get(client)
    other.stop()
    assert other.asked == []


def test_downloads_follow_redirects_without_the_key(
    client: HttpClient, servant: Servant, keys: str, film: bytes, tmp_path: Path
) -> None:
    other = Servant()
    servant.routes["/v"] = [Reply(status=302, headers={"Location": f"{other.url}/v"})]
    other.routes["/v"] = [Reply(film)]
    client.download(f"{servant.url}/v", tmp_path / "v", Deadline(5))
    other.stop()
    assert (tmp_path / "v").read_bytes() == film
    assert servant.asked[0].headers["Authorization"].endswith(keys)
    assert "Authorization" not in other.asked[0].headers


@pytest.mark.parametrize("address", ["file:///etc/hosts", "ftp://x/y", "/v", "http://", "", "http://u:p@127.0.0.1/v"])
def test_downloads_accept_only_http_and_https_addresses(client: HttpClient, address: str, tmp_path: Path) -> None:
    with pytest.raises(WorldModelError, match="not http or https"):
        client.download(address, tmp_path / "v", Deadline(5))


def test_redirects_to_other_schemes_or_in_circles_are_refused(
    client: HttpClient, servant: Servant, tmp_path: Path
) -> None:
    servant.routes["/a"] = [Reply(status=302, headers={"Location": "file:///etc/hosts"})]
    servant.routes["/b"] = [Reply(status=302, headers={"Location": "/b"})]
    for path, message in (("/a", "not http or https"), ("/b", "redirects more than")):
        with pytest.raises(WorldModelError, match=message):
            client.download(servant.url + path, tmp_path / "v", Deadline(5))


@pytest.mark.parametrize("host", ["localhost", "127.1", "0.0.0.0", "2130706433", "0x7f.1", "[::ffff:127.0.0.1]"])
def test_a_remote_service_cannot_direct_downloads_to_this_machine(tmp_path: Path, host: str) -> None:
    with pytest.raises(WorldModelError, match="on this machine"):
        HttpClient("it", "https://example.org").download(f"http://{host}:80/v", tmp_path / "v", Deadline(5))


@pytest.mark.parametrize("headers", [{}, {"Content-Length": "99999999"}])
def test_answers_and_downloads_above_the_size_limit_are_refused(
    client: HttpClient, servant: Servant, headers: dict[str, str], tmp_path: Path
) -> None:
    servant.routes["/x"] = [Reply(b'{"a": "' + b"a" * 5000 + b'"}')]
    servant.routes["/v"] = [Reply(b"v" * 20_001, headers=headers)]
    with pytest.raises(WorldModelError, match=r"more than 0\.0039"):
        get(client)
    with pytest.raises(WorldModelError, match=r"more than 0\.019"):
        client.download(f"{servant.url}/v", tmp_path / "v", Deadline(5))


@pytest.mark.parametrize(
    "reply",
    [
        Reply(endless=b"HTTP/1.1 100 Continue\r\n\r\n", drip_s=0.01),
        Reply(endless=b"HTTP/1.1 100 Continue\r\n\r\n" * 1000),
        Reply(endless=b"H", drip_s=0.05),
        Reply({"a": "a" * 1000}, drip_s=0.01),  # the whole body would take 10 s
    ],
)
def test_headers_without_end_and_slow_bodies_run_into_the_deadline(
    client: HttpClient, servant: Servant, reply: Reply
) -> None:
    servant.routes["/x"] = [reply]
    start = time.monotonic()
    with pytest.raises(WorldModelError, match=r"no video within 0\.3 s|broke off"):
        get(client, limit_s=0.3)
    assert time.monotonic() - start < 5  # no timeout between bytes would ever pass


def test_the_structure_of_an_answer_is_bounded_apart_from_its_files(client: HttpClient, servant: Servant) -> None:
    file = "A" * 9000
    servant.routes["/x"] = [Reply({"files": [file], "error": {"message": "no " * 3000}, "text": 'a"\\'})]
    answer = client.call("GET", "/x", Deadline(5.0), files=("files",))
    assert [bytes(view).decode() for view in answer["files"]] == [file]
    assert answer["text"] == 'a"\\'
    assert answer["error"]["message"].startswith("no no ")
    servant.routes["/x"] = [Reply(b'{"files": ["", ' + b"{}," * 3000 + b'""]}')]
    with pytest.raises(WorldModelError, match=r"more than 0\.0039\S* MiB of JSON"):
        client.call("GET", "/x", Deadline(5.0), files=("files",))
    servant.routes["/x"] = [Reply(b'{"files": "' + b"A" * 9000)]
    with pytest.raises(WorldModelError, match="expected a JSON object"):
        client.call("GET", "/x", Deadline(5.0), files=("files",))


def test_only_a_server_that_listens_passes_the_check(keys: str, servant: Servant, hurried: Limits) -> None:
    HttpClient("it", servant.url, limits=hurried).require_connection(5.0)  # its 404 is an answer
    servant.stop()
    with pytest.raises(SetupError, match=r"it cannot be reached \(ConnectError\): is the server running"):
        HttpClient("it", servant.url, limits=hurried).require_connection(5.0)


def test_a_silent_service_times_out_after_its_retries(servant: Servant, tmp_path: Path) -> None:
    client = HttpClient("it", servant.url, limits=Limits(attempts=2, first_wait_s=0.001, silence_s=0.05))
    servant.routes["/x"] = [Reply({"a": 1}, drip_s=0.5)]
    with pytest.raises(ServiceError, match=re.escape("it broke off (ReadTimeout)")):
        get(client)
    assert len(servant.asked) == 2


@pytest.mark.parametrize("body", [b"<html>", b"[1]", b"", b"\xff\xfe", b"[" * 3000])
def test_an_answer_other_than_a_json_object_is_refused(client: HttpClient, servant: Servant, body: bytes) -> None:
    servant.routes["/x"] = [Reply(body, headers={"Content-Type": "text/html"})]
    with pytest.raises(WorldModelError, match="answered with text/html, expected a JSON object") as caught:
        get(client)
    assert len(str(caught.value)) < 200


def test_the_beginning_of_an_unusable_answer_is_quoted_with_masked_key(
    client: HttpClient, servant: Servant, keys: str
) -> None:
    servant.routes["/x"] = [Reply(f"<html> {keys} {'x' * 200}".encode())]
    with pytest.raises(WorldModelError, match=r"it begins: '<html> \*\*\* x+'$"):
        get(client)


def test_a_compressed_answer_is_refused_before_unpacking(client: HttpClient, servant: Servant) -> None:
    """Unpacked, an answer of some kilobytes may be gigabytes."""
    body = gzip.compress(b'{"a": "' + b"a" * 50_000_000 + b'"}')
    servant.routes["/x"] = [Reply(body, headers={"Content-Encoding": "gzip"})]
    start = time.monotonic()
    with pytest.raises(WorldModelError, match="Content-Encoding gzip; send it uncompressed"):
        get(client, limit_s=1.0)
    assert time.monotonic() - start < 0.5
    assert servant.asked[0].headers["Accept-Encoding"] == "identity"


def test_a_401_without_a_key_names_the_key_option(servant: Servant, hurried: Limits) -> None:
    servant.routes["/x"] = [Reply({"message": "who are you"}, status=401)]
    with pytest.raises(SetupError, match=r"who are you; no key was sent; name one with key_env=VARIABLE"):
        get(HttpClient("it", servant.url, limits=hurried))


def test_a_torn_answer_is_retried_only_if_the_call_is_repeatable(client: HttpClient, servant: Servant) -> None:
    servant.routes["/x"] = [Reply(b'{"a', headers={"Content-Length": "10"}), Reply({"a": 1})]
    assert get(client) == {"a": 1}
    servant.routes["/y"] = servant.routes["/x"]
    with pytest.raises(ServiceError, match="broke off"):
        client.call("POST", "/y", Deadline(5), body={}, repeatable=False)
    assert len(servant.at("/y")) == 1


def test_an_unreachable_server_is_reported(keys: str, hurried: Limits) -> None:
    servant = Servant()
    servant.stop()
    with pytest.raises(WorldModelError, match=re.escape("it cannot be reached (ConnectError)")):
        get(HttpClient("it", servant.url, limits=hurried))


def test_loopback_and_web_addresses_are_recognised() -> None:
    for own in ("http://localhost", "http://a.localhost:1", "http://127.3.2.1", "http://[::1]/", "http://LOCALHOST."):
        assert is_loopback(httpx.URL(own)), own
    for far in ("example.org", "8.8.8.8", "cafe", "10.1", "localhost.example.org", "10.0.0.1", "127.0.0.1.example.org"):
        assert not is_loopback(httpx.URL(f"http://{far}/")), far
    assert web_address("https://a.b/c?d=e") is not None
    assert web_address("http://:80") is None
