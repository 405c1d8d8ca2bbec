"""Web addresses: which are this machine's, which belong together."""

import ipaddress
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

import httpx


def web_address(text: str) -> httpx.URL | None:
    """The address if it is one of http or https with a host and without a name and password, else None."""
    try:
        url = httpx.URL(text)
        url.host.encode("idna")  # as whoever looks it up will
    except (httpx.InvalidURL, ValueError):
        return None
    return url if url.scheme in ("http", "https") and url.host and not url.userinfo else None


def is_loopback(url: httpx.URL) -> bool:
    """Whether the host is this machine by any of its own names."""
    host = url.host.rstrip(".").lower()
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def origin(url: httpx.URL) -> tuple[str, str, int | None]:
    """Scheme, host and port: what a key is meant for."""
    port = url.port if url.port is not None else {"http": 80, "https": 443}.get(url.scheme)
    return url.scheme, url.host.lower(), port


def retry_after(header: str) -> float | None:
    """Seconds that a `Retry-After` header asks to wait; None if it asks for nothing (RFC 9110, section 10.2.3)."""
    text = header.strip()
    if text.isascii() and text.isdecimal():
        return float(text)
    try:
        moment = parsedate_to_datetime(text)
    except ValueError:
        return None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return max((moment - datetime.now(UTC)).total_seconds(), 0.0)
