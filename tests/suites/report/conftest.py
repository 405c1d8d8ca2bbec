import pytest

from kinebench_drake.results.row import Status
from tests.suites.report.synthetic import EVIL, failed, outcome, write_run


@pytest.fixture
def runs(tmp_path):
    """Runs of three models with fixed success on two parts, and of a small scaling study."""
    root = tmp_path / "runs"

    def mixed(hits, n, sparc, cost):
        names = ("grounding", "generation", "execution", "task")
        return [
            outcome(k < hits, progress=1.0 if k < hits else 0.25, verdict=None if k < hits else names[k % 4],
                    sparc=sparc - 0.05 * k, cost=cost + 0.4 * k, rounds=1 + (k >= hits) * 2)
            for k in range(n)
        ]  # fmt: skip

    tasks = ("CloseBox-v1", "StackCube-v1", "StoreCube-v2")
    folders = []
    for number, model in enumerate(("good", "fair", "poor")):
        for suite, split in ((0, "test"), (2, "unseen")):
            episodes = {
                task: mixed(max(9 - 3 * number - 2 * k - suite, 0), 10, -2.0 - number - 0.2 * k, 6.0 + 2 * number + k)
                for k, task in enumerate(tasks)
            }
            episodes[tasks[0]][9] = failed()
            episodes[tasks[1]][9] = failed(Status.UNMEASURABLE, EVIL)
            folders.append(write_run(root / f"{model}{suite}", episodes, model=model, suite=suite, split=split))
    for data in (10, 100):
        for steps in (1500, 15000):
            hits = {task: 9 - 2 * k - (data == 10) * k - (steps == 1500) * 2 for k, task in enumerate(tasks)}
            episodes = {task: mixed(n, 10, -2.5, 7.0) for task, n in hits.items()}
            tags = {"data": str(data), "steps": str(steps)}
            folders.append(write_run(root / f"scale{data}_{steps}", episodes, model="small", suite=3, tags=tags))
    (root / "good0" / "rollouts").mkdir()
    (root / "good0" / "rollouts" / f"{tasks[0]}_s0000.mp4").write_bytes(b"video")
    (root / "good0" / "report.html").write_text("page")
    return folders
