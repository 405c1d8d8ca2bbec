"""Pages in a browser: no error, nothing that overflows a phone, tables that sort, filter and unfold."""

import numpy as np
import pytest

from kinebench_drake.geometry import make_pose
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.report.page import write_report
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.track import GripperTrack
from tests.report.pages import BROWSER, EVIL, probe, row

# 1 x 1 pixel, white.
PICTURE = bytes.fromhex(
    "ffd8ffe000104a46494600010100000100010000ffdb004300"
    + "01" * 64
    + "ffc0000b080001000101011100ffc4001400010000000000"
    "000000000000000000000009ffc40014100100000000000000000000000000000000ffda0008010100003f0054dfffd9"
)
PROBE = """
<script>
addEventListener("load", () => {
  const table = document.getElementById("samples");
  const ids = () => [...table.tBodies].filter(b => !b.hidden).map(b => b.dataset.id);
  const state = {errors: window.troubles, ids: ids()};
  document.querySelector("[data-more=samples]").click();
  state.all = ids().length;
  const heads = [...table.tHead.querySelectorAll("button")];
  heads.find(head => head.textContent === "SPARC").click();
  state.sorted = ids();
  document.querySelector("[data-pick=good]").click();
  state.picked = ids().length;
  document.querySelector(".open").click();
  for (const body of table.tBodies) if (!body.hidden) body.querySelector(".open").click();
  state.figures = table.querySelectorAll(".plots svg").length;
  const parts = [...document.querySelectorAll("main > *, .inner > *")];
  state.wide = parts.filter(part => part.getBoundingClientRect().right > document.documentElement.clientWidth).length;
  state.overflow = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  state.width = innerWidth;
  document.documentElement.setAttribute("data-state", JSON.stringify(state));
});
</script>
"""


@pytest.fixture
def folder(tmp_path):
    n = 9
    X = make_pose(np.broadcast_to(np.eye(3), (n, 3, 3)), np.linspace(0, 1, 3 * n).reshape(n, 3))
    on = np.ones(n, dtype=bool)
    track = GripperTrack(
        t_s=np.arange(n) * 0.2, X_CH=X, X_BG=X, tracked=on, confidence=on * 0.9, finger_width_m=np.full(n, 0.04)
    )
    speed = {"kind": "velocity", "frame_start": 2, "frame_end": 3, "joint": EVIL, "value": 3.0, "limit": None}
    with ResultStore(tmp_path) as store:
        for k in range(130):
            id = f"sample_with_a_rather_long_name_{k:03d}"
            metrics = {"sparc": -1.5 - 0.01 * (k * 37 % 130)}
            task = "good" if k % 65 == 3 else f"Task{k % 9}"
            store.append(row(id, feasible=k > 0, metrics=metrics, violations=(speed,) * (k == 0), task=task), 0.1)
            write_track(tmp_path / "tracks" / f"{id}.npz", track, None, {})
            write_atomically(tmp_path / "thumbnails" / f"{id}.jpg", PICTURE)
        store.append(row(EVIL.replace("/", "|"), Status.ERROR, reason=EVIL, task=EVIL, model=EVIL, video=EVIL), 0.1)
        store.finish({"kind": "score", "config": {"source": EVIL}})
    return tmp_path


@pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")
def test_the_page_works_in_a_browser_on_a_phone(folder):
    state = probe(write_report(folder), PROBE, folder / "profile")
    assert state["width"] <= 500  # as narrow as the browser's windows get
    assert (state["overflow"], state["wide"]) == (0, 0)
    assert len(state["ids"]) == 100
    assert state["all"] == 131
    sparc = [int(id[-3:]) * 37 % 130 for id in state["sorted"] if id[-3:].isdigit()]
    assert sparc == sorted(sparc)
    assert state["picked"] == 2
    assert state["figures"] > 0
