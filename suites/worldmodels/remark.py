"""What another program said, made fit for an error message."""

import os
import re

from pydantic import SecretStr

from kinebench_drake.errors import SetupError

_LONGEST = 200
_SECRET = re.compile(r"KEY|TOKEN|SECRET|PASSWORD|CREDENTIAL")
_LEAST_SECRET = 6
"""Shorter values of such variables are no secrets; blotting them out would only spoil words."""


def remark(text: str) -> str:
    """`text` in one line without control signs, not too long, without what the environment holds as secret.

    Args:
        text: an error message, perhaps of many lines; services like to repeat the key they did not accept.
    """
    values = (v.strip() for name, v in os.environ.items() if _SECRET.search(name.upper()))
    for value in sorted((v for v in values if len(v) >= _LEAST_SECRET), key=len, reverse=True):
        text = text.replace(value, "***")
    line = " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
    return line if len(line) <= _LONGEST else line[: _LONGEST - 3] + "..."


def key_from(variable: str) -> SecretStr:
    """The key that an environment variable holds; nothing but the request's header ever sees it.

    Raises:
        SetupError: the variable is not set, or holds what no header can carry.
    """
    key = os.environ.get(variable, "").strip()
    if not key:
        raise SetupError(f"{variable} is not set: set this environment variable to the service's key")
    if not (key.isascii() and key.isprintable()):
        raise SetupError(f"{variable} holds signs that no key has: set it to the service's key alone")
    return SecretStr(key)
