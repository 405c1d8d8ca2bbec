"""Workers in processes of their own, interrupted and ended amid what they do."""

import signal

import pytest

from kinebench_drake.engines import Done, local
from kinebench_drake.engines.local import LocalEngine


def make_doubling():
    return lambda item: 2 * item


def test_every_item_is_worked_on():
    outcomes = list(LocalEngine(jobs=2).run(make_doubling, [1, 2, 3]))
    assert {o.item: o.result for o in outcomes if isinstance(o, Done)} == {1: 2, 2: 4, 3: 6}


@pytest.mark.parametrize("started", [1, 2])
def test_an_interrupt_while_a_worker_starts_leaves_it_without_an_item(monkeypatch, started):
    """It is held back till the process is there, and delivered at once then."""
    engine, unblocked = LocalEngine(jobs=2), []

    def mask(how, signals, before=signal.pthread_sigmask):
        blocked = before(how, signals)
        if how == signal.SIG_SETMASK:
            unblocked.append(how)
            if len(unblocked) == started:
                engine.drain()
        return blocked

    monkeypatch.setattr(local.signal, "pthread_sigmask", mask)
    outcomes = list(engine.run(make_doubling, [1, 2, 3]))
    assert [(o.item, o.result) for o in outcomes] == [(1, 2)][: started - 1]
