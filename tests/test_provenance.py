import shutil
from pathlib import Path

import kinebench_drake
from kinebench_drake.results import provenance


def fingerprint(folder, monkeypatch):
    monkeypatch.setattr(kinebench_drake, "__file__", str(folder / "__init__.py"))
    return provenance.code_hash.__wrapped__()


def test_the_code_is_known_by_its_sources(tmp_path, monkeypatch):
    real = Path(kinebench_drake.__file__).parent
    names = ("measure.py", "kinematics/ik.py", "grounding/registration/fit.py", "cli/score.py", "report/page.py")
    for name in names:
        (tmp_path / "package" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(real / name, tmp_path / "package" / name)
    (tmp_path / "package" / "grounding").rename(tmp_path / "grounding")
    (tmp_path / "package" / "grounding").symlink_to(tmp_path / "grounding")  # as in the repository
    first = fingerprint(tmp_path / "package", monkeypatch)
    assert fingerprint(tmp_path / "package", monkeypatch) == first
    for name in names:
        file = tmp_path / "package" / name
        text = file.read_text()
        file.write_text(text + "# changed\n")
        counts = not name.startswith(("cli/", "report/"))
        assert (fingerprint(tmp_path / "package", monkeypatch) != first) is counts, name
        file.write_text(text)
    assert fingerprint(tmp_path / "package", monkeypatch) == first
    (tmp_path / "package" / "__pycache__").mkdir()
    (tmp_path / "package" / "__pycache__" / "x.pyc").touch()
    assert fingerprint(tmp_path / "package", monkeypatch) == first
