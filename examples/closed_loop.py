r"""Run your own world model in closed loop: one task, one episode, one round.

    python examples/closed_loop.py [OUT]

The same from the command line, in the folder of my_world_model.py:

    kinebench-drake suite run --suite 0 --tasks PullCube-v1 --episodes 1 --rounds 1 \
        --world-model my_world_model:MyWorldModel --out closed-loop
"""

import sys
from pathlib import Path

from kinebench_drake import run_suite


def main(out: Path) -> None:
    summary = run_suite(
        0,
        world_model="my_world_model:MyWorldModel",
        tasks=["PullCube-v1"],
        episodes=1,
        rounds=1,
        out=out,
    )
    for row in summary.rows:
        if row.reason is not None:
            print(f"{row.id}: {row.status.value}, {row.reason}")
            continue
        print(f"{row.id}: {'success' if row.success else 'failure'}, progress {row.progress:.2f}")
        if row.cause is not None:
            print(f"  {row.verdict}: {row.cause.text}")
        print(f"  generated and executed side by side: {out / 'rollouts' / f'{row.id}.mp4'}")
    print(f"report: {summary.report}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path("closed-loop"))
