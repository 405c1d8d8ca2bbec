"""Best of several samples: score the clips of a folder, print them from best to worst.

    python examples/best_of.py [FOLDER [JOBS]]

FOLDER holds clips of one camera, such as eight samples of a world model for one first frame; its camera.json is used if
there is one. Without FOLDER: the example videos.
"""

import sys
import time
from pathlib import Path

from kinebench_drake import Scorer, read_video

HERE = Path(__file__).parent
PERIOD_S = 0.2
"""Task time between two frames: that of the benchmark."""


def main(folder: Path, jobs: int) -> None:
    paths = sorted(folder.glob("*.mp4"))
    camera = folder / "camera.json"
    with Scorer(jobs=jobs) as scorer:
        clips = [read_video(path).frames for path in paths]
        scorer.batch(clips[:jobs], camera=camera if camera.exists() else None, period_s=PERIOD_S)  # loads the models
        start = time.perf_counter()
        scores = scorer.batch(clips, camera=camera if camera.exists() else None, period_s=PERIOD_S)
        minutes = (time.perf_counter() - start) / 60
    for score, path in sorted(zip(scores, paths, strict=True), key=lambda pair: -pair[0].reward):
        verdict = {True: "executable", False: "not executable", None: "undecided"}[score.executable]
        print(f"{score.reward:.3f}  {path.stem}: {verdict}", f"({'; '.join(score.reasons)})" if score.reasons else "")
    print(f"{len(clips) / minutes:.1f} clips a minute in {jobs} process{'es' if jobs > 1 else ''}")


if __name__ == "__main__":  # the processes import this file, too
    main(Path(sys.argv[1]) if sys.argv[1:] else HERE / "videos", int(sys.argv[2]) if sys.argv[2:] else 1)
