"""What the Ray engine does about lost workers, with a stand-in for Ray that loses them on cue."""

import signal
import sys
from types import SimpleNamespace

import pytest

from kinebench_drake.errors import SetupError
from kinebench_drake.executors.base import ExecutorKind, ItemResult, WorkerCrash, create_executor
from kinebench_drake.executors.local import THREAD_VARIABLES
from kinebench_drake.executors.ray import RayExecutor, gpu_share


class RayError(Exception):
    """As Ray's: all that can become of a call besides its answer, once Ray has tried it again."""


class Lost(BaseException):
    """Raised in a worker, it takes the worker along."""


class Call(SimpleNamespace):
    """Reference to an answer."""

    def __init__(self, actor, name, arguments):
        super().__init__(actor=actor, name=name, arguments=arguments)

    __hash__ = object.__hash__


class StandIn(SimpleNamespace):
    """Ray in this process: calls are made when they are waited for, the oldest first, one at a time."""

    def __init__(self):
        self.alive = []
        self.started = 0
        self.on = False
        self.cpus = 2.0
        self.__spec__ = "known to find_spec"
        self.exceptions = SimpleNamespace(RayError=RayError)

    def is_initialized(self):
        return self.on

    def init(self, **options):
        self.on = True
        self.options = options
        signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def shutdown(self):
        self.on = False

    def cluster_resources(self):
        return {"CPU": self.cpus, "GPU": 1.0}

    def remote(self, **options):
        def make(kind):
            return SimpleNamespace(remote=lambda *arguments: self._actor(lambda: kind(*arguments)))

        self.asked = options
        return make

    def _actor(self, make):
        def method(name):
            return SimpleNamespace(remote=lambda *arguments: Call(actor, name, arguments))

        actor = SimpleNamespace(make=make, servant=None, check=method("check"), work=method("work"))
        self.alive.append(actor)
        self.started += 1
        return actor

    def wait(self, calls, timeout):
        return calls[:1], calls[1:]

    def get(self, call):
        actor = call.actor
        if actor not in self.alive:
            raise RayError("the actor is gone")
        try:
            actor.servant = actor.servant or actor.make()
            return getattr(actor.servant, call.name)(*call.arguments)
        except (Lost, Exception) as error:
            raise RayError(*error.args) from None

    def kill(self, actor):
        if actor in self.alive:
            self.alive.remove(actor)


@pytest.fixture
def ray(monkeypatch):
    stand_in = StandIn()
    monkeypatch.setitem(sys.modules, "ray", stand_in)
    return stand_in


def doubling(losses=(), equips=()):
    """A maker of workers that double numbers; the numbers in `losses` and the starts in `equips` are lost."""
    losses = list(losses)
    equips = list(equips)

    def make():
        if equips:
            raise equips.pop()

        def work(item):
            if item in losses:
                losses.remove(item)
                raise Lost("out of memory" if item == 13 else "a connection broke")
            return 2 * item

        return work

    return make


def run(make, items, jobs=2):
    return list(RayExecutor(jobs=jobs).run(make, items))


def test_every_item_has_a_result_and_workers_are_reused(ray):
    handler = signal.getsignal(signal.SIGTERM)
    outcomes = run(doubling(), [1, 2, 3, 4, 5])
    assert sorted((o.item, o.result) for o in outcomes) == [(k, 2 * k) for k in (1, 2, 3, 4, 5)]
    assert ray.started == 2
    assert (ray.alive, ray.on) == ([], False)
    assert signal.getsignal(signal.SIGTERM) is handler
    assert (ray.asked["num_cpus"], ray.asked["num_gpus"], ray.asked["max_task_retries"]) == (1, 0.5, 1)
    assert set(ray.asked["runtime_env"]["env_vars"]) == set(THREAD_VARIABLES)


@pytest.mark.parametrize(("item", "told"), [(2, "lost twice"), (13, "ran out of memory: use fewer jobs")])
def test_an_item_that_ray_gives_up_is_a_worker_crash(ray, item, told):
    outcomes = run(doubling(losses=[item]), [1, item, 3])
    (crashed,) = [o for o in outcomes if isinstance(o, WorkerCrash)]
    assert crashed.item == item
    assert told in crashed.reason
    assert {o.item for o in outcomes if isinstance(o, ItemResult)} == {1, 3}


def test_workers_that_fail_to_start_end_the_run_with_a_setup_error(ray):
    for error, told in (
        (Lost(), "die before they start"), (ImportError("no module"), "no module"), (SetupError("no weights"), "^no"),
    ):  # fmt: skip
        with pytest.raises(SetupError, match=told):
            run(doubling(equips=[error]), [1, 2], jobs=1)
    assert ray.started == 3
    assert (ray.alive, ray.on) == ([], False)


def test_a_node_with_other_code_or_without_the_folder_is_a_setup_error(ray, monkeypatch):
    codes = iter("ab")
    with monkeypatch.context() as patch:
        patch.setattr("kinebench_drake.executors.ray.code_hash", lambda *_: next(codes))
        with pytest.raises(SetupError, match="has another version"):
            run(doubling(), [1], jobs=1)
    monkeypatch.setattr("os.getcwd", lambda: "/nowhere/at/all")
    with pytest.raises(SetupError, match="has no access to the folder /nowhere/at/all"):
        run(doubling(), [1], jobs=1)


def test_a_closed_run_leaves_no_worker_and_no_ray_connection(ray):
    outcomes = RayExecutor(jobs=2).run(doubling(), [1, 2, 3])
    next(outcomes)
    outcomes.close()
    assert (ray.alive, ray.on) == ([], False)


def test_an_unreachable_cluster_or_one_without_cpus_is_a_setup_error(ray, monkeypatch):
    ray.cpus = 0.0
    with pytest.raises(SetupError, match="no CPU"):
        run(doubling(), [1])

    def fail(**_):
        raise ConnectionError("nobody\nanswers")

    monkeypatch.setattr(ray, "init", fail)
    with pytest.raises(SetupError, match=r"at host:1 \(nobody answers\)"):
        list(create_executor(ExecutorKind.RAY, 2, "host:1").run(doubling(), [1]))


def test_a_ray_connection_of_the_caller_stays_open(ray):
    ray.on = True
    assert len(run(doubling(), [1, 2])) == 2
    assert ray.on


def test_gpu_shares_let_all_workers_fit_on_the_gpus():
    assert gpu_share(0, 8) == 0.0
    for gpus, workers in ((1, 1), (4, 4), (8, 3), (2, 3), (4, 16), (3, 7)):
        share = gpu_share(gpus, workers)
        assert gpus * int(1.0 / share + 1e-9) >= workers
        assert share <= 1.0
