import logging

import pydrake.common  # noqa: F401  (sets the logger up)
import pytest

from kinebench_drake.models.drake_log import silent_drake


def test_silent_drake_restores_the_log_level_even_after_an_exception() -> None:
    logger = logging.getLogger("drake")
    before = logger.level
    with silent_drake():
        assert not logger.isEnabledFor(logging.ERROR)
    assert logger.level == before
    with pytest.raises(ValueError, match="inside"), silent_drake():
        raise ValueError("inside")
    assert logger.level == before
