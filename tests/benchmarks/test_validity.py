"""Validity study: responses to planted faults with known answers, its report, and a small measurement."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import executions, validity
from benchmarks.__main__ import main
from benchmarks.executions import ClipTrack, ExecutionWorker, Extractor
from benchmarks.faults.fault import GRADES, FaultGrade
from benchmarks.validity import TRIAL, ValidityTrial, study_grades, study_specs
from benchmarks.validity_report import FIGURE, RESPONSES, write_report
from benchmarks.validity_response import NUMBERS, Grade, Study, Verdict
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.suites.composition import Pool
from kinebench_drake.suites.families.registry import TASKS

EPISODES = 24


def trial(episode: int, kind: AnomalyKind | None, size: float, success: bool, **numbers: float | None) -> ValidityTrial:
    return ValidityTrial(
        id=f"{episode}_{kind}_{size}",
        episode=str(episode),
        task="PullCube-v1",
        kind=kind,
        size=size,
        success=success,
        reason="",
        numbers={**dict.fromkeys(NUMBERS, 0.5), **numbers},
        anomalies=() if kind is None else (kind.value,),
    )


@pytest.fixture(scope="module")
def trials() -> list[ValidityTrial]:
    """Vanish: sparc falls with the size, ldlj rises, manipulability_mean becomes null; freeze: no response."""
    rng = np.random.default_rng(0)
    result = []
    for i in range(EPISODES):
        sparc = float(rng.normal(-3.0, 0.1))
        noise = rng.normal(size=3).tolist()
        result.append(trial(i, None, 0.0, True, sparc=sparc, ldlj=-5.0, table_distance_min_m=noise[0]))
        for size in (1.0, 10.0):
            numbers = {"sparc": sparc - 0.1 * size, "ldlj": -5.0 + size, "table_distance_min_m": noise[1]}
            result.append(trial(i, AnomalyKind.VANISH, size, size < 5, **numbers, manipulability_mean=None))
        result.append(trial(i, AnomalyKind.FREEZE, 5.0, True, sparc=sparc, ldlj=-5.0, table_distance_min_m=noise[2]))
    return result


def test_verdicts_separate_improve_or_are_silent_per_kind_of_fault(trials: list[ValidityTrial]) -> None:
    study = Study(trials)
    assert study.kinds == [AnomalyKind.VANISH, AnomalyKind.FREEZE]
    verdict = {name: study.verdict(name, AnomalyKind.VANISH) for name in NUMBERS}
    assert verdict["sparc"] is Verdict.SEPARATES
    assert verdict["ldlj"] is Verdict.IMPROVES
    assert verdict["manipulability_mean"] is Verdict.SEPARATES  # a null is the worst value
    assert verdict["table_distance_min_m"] is verdict["feasible"] is Verdict.SILENT
    assert all(study.verdict(name, AnomalyKind.FREEZE) is Verdict.SILENT for name in NUMBERS)


def test_responses_count_worse_better_and_null_videos_per_grade(trials: list[ValidityTrial]) -> None:
    study = Study(trials)
    least, greatest = study.grades(AnomalyKind.VANISH)
    assert (least.label, greatest.label) == ("1 frame", "10 frames")
    response = study.responses["sparc", greatest]
    assert response.change is not None
    assert response.change.value == pytest.approx(-1.0)
    assert (response.worse, response.better, response.nulls) == (EPISODES, 0, 0)
    assert response.area.value == response.area.high == 1.0
    same = study.responses["sparc", Grade(kind=AnomalyKind.FREEZE, size=5.0)]
    assert same.area.value == 0.5
    assert same.p_value == 1.0
    gone = study.responses["manipulability_mean", least]
    assert gone.change is None
    assert gone.nulls == gone.worse == EPISODES


def test_exchanging_clean_and_faulty_videos_reflects_the_area_under_roc(trials: list[ValidityTrial]) -> None:
    """Exchanging clean and faulty videos reflects the area at 0.5 and exchanges worse and better."""
    swapped = []
    for t in trials:
        if t.kind is AnomalyKind.FREEZE:
            continue
        if t.size != 1.0:
            kind, size = (AnomalyKind.VANISH, 10.0) if t.kind is None else (None, 0.0)
            swapped.append(trial(int(t.episode), kind, size, t.success, **t.numbers))  # type: ignore[arg-type]
    grade = Grade(kind=AnomalyKind.VANISH, size=10.0)
    before = Study(trials)
    after = Study(swapped)
    for name in ("sparc", "ldlj", "manipulability_mean", "table_distance_min_m"):
        a = before.responses[name, grade]
        b = after.responses[name, grade]
        assert a.area.value == pytest.approx(1.0 - b.area.value)
        assert (a.worse, a.better) == (b.better, b.worse)


def test_the_report_has_tables_of_faults_verdicts_responses_and_success(
    trials: list[ValidityTrial], tmp_path: Path
) -> None:
    sections = write_report(trials, {"revision": "r", "weights": "w"}, tmp_path)
    assert (tmp_path / FIGURE).stat().st_size > 10_000
    faults, verdicts, responses = sections
    assert "| none |  | 100%" in faults
    assert f"{EPISODES} to {EPISODES} a size" in faults
    assert f"| `ldlj` | `vanish` | 1 frame | {EPISODES} of {EPISODES} videos | +1 |" in verdicts
    assert "`sparc`" in verdicts
    assert "| `freeze` |  |" in verdicts
    assert RESPONSES in responses
    table = (tmp_path / RESPONSES).read_text().splitlines()
    assert len(table) == 1 + 3 * len(NUMBERS)
    assert f"vanish,1 frame,manipulability_mean,,,,{EPISODES},0,{EPISODES},1" in table


def test_three_episodes_give_no_verdicts(trials: list[ValidityTrial], tmp_path: Path) -> None:
    few = [t for t in trials if int(t.episode) < 3]
    verdicts = write_report(few, {"revision": "r", "weights": "w"}, tmp_path)[1]
    assert "3 episodes cannot show" in verdicts
    assert "`sparc`" not in verdicts
    assert "No number improves" not in verdicts


def test_the_report_command_replaces_the_sections_of_the_page(trials: list[ValidityTrial], tmp_path: Path) -> None:
    work = tmp_path / "work"
    page = tmp_path / "page.md"
    work.mkdir()
    page.write_text("# Title\n\nIntroduction.\n\n## Dose and response\n\nformer text\n")
    missing = CliRunner().invoke(main, ["validity", "report", str(work)])
    assert missing.exit_code == 2
    assert "no finished study" in missing.output
    (work / "trials.jsonl").write_text("".join(json.dumps(TRIAL.dump_python(t, mode="json")) + "\n" for t in trials))
    (work / "study.json").write_text('{"revision": "r", "weights": "w"}')
    for _ in range(2):  # the second time replaces the sections
        result = CliRunner().invoke(main, ["validity", "report", str(work), "--out", str(page)])
        assert result.exit_code == 0, result.output
    text = page.read_text()
    assert text.count("## Dose and response") == text.count("## Episodes and faults") == 1
    assert "former text" not in text
    assert FIGURE in text


def test_the_study_covers_all_kinds_on_unseen_single_clip_episodes() -> None:
    grades = study_grades(3)
    assert {grade.kind for grade in grades} == set(AnomalyKind)
    for kind, possible in GRADES.items():
        sizes = [grade.size for grade in grades if grade.kind is kind]
        assert sizes == sorted(sizes)
        assert {possible.gate, max(possible.sizes)} <= set(sizes) <= set(possible.sizes)
    assert set(study_grades(2)) < set(grades)
    specs = list(study_specs())
    assert {spec.pool for spec in specs} == {Pool.UNSEEN}
    assert len({spec.id for spec in specs}) == len(specs) > 40
    assert all(TASKS[spec.task].card.clips == 1 for spec in specs)


@pytest.mark.sapien
def test_executing_a_track_without_a_base_frame_fails(tmp_path: Path) -> None:
    nowhere = np.full((5, 4, 4), np.nan)
    np.savez(tmp_path / "a.npz", t_s=0.2 * np.arange(5), base_from_tcp=nowhere, finger_width_m=np.full(5, 0.04))
    worker = ExecutionWorker(None)
    clip = ClipTrack(id="a", spec=next(study_specs()), extractor=Extractor.TRUTH, source=tmp_path / "a.npz")
    try:
        done = worker(clip)
    finally:
        worker.close()
    assert not done.success
    assert "nothing to execute" in done.reason


@pytest.mark.sapien
@pytest.mark.slow
def test_a_second_measurement_of_validity_renders_and_executes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    freeze = FaultGrade(kind=AnomalyKind.FREEZE, size=5, form=None)
    monkeypatch.setattr(validity, "study_grades", lambda sizes: (freeze,))
    arguments = ["validity", "measure", "--work", str(tmp_path), "--episodes", "1"]
    first = CliRunner().invoke(main, arguments)
    assert first.exit_code == 0, first.output
    rows, _ = validity.read_study(tmp_path)
    clean, frozen = rows
    assert clean.kind is None
    assert clean.success
    assert clean.numbers["tracked_fraction"] > 0.9  # type: ignore[operator]
    assert frozen.kind is AnomalyKind.FREEZE
    assert set(NUMBERS) <= set(frozen.numbers)
    (line,) = (tmp_path / "videos" / "planted.jsonl").read_text().splitlines()
    assert len(json.loads(line)["videos"]) == 2
    monkeypatch.setattr(validity, "make_planter", None)  # what is finished is not made again
    monkeypatch.setattr(executions, "execute", None)
    again = CliRunner().invoke(main, arguments)
    assert again.exit_code == 0, again.output
    assert validity.read_study(tmp_path)[0] == rows
