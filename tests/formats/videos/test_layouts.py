"""Folders of other benchmarks, and of the Hugging Face cache: whose videos they are."""

from kinebench_drake.formats.videos.find import find_samples
from tests.formats.videos.conftest import touch


def test_symbolic_links_of_the_hugging_face_cache_are_followed(tmp_path):
    touch(tmp_path, "blobs/1234")
    (tmp_path / "snapshot").mkdir()
    (tmp_path / "snapshot" / "a.mp4").symlink_to(tmp_path / "blobs" / "1234")
    (sample,) = find_samples(tmp_path / "snapshot").samples
    assert (sample.id, sample.problem) == ("a", None)


def test_a_submission_to_track_1_of_worldarena_names_its_model(tmp_path):
    touch(tmp_path, "videos/episode_000001.mp4", "videos/episode_000002.mp4")
    (tmp_path / "model_readme.md").write_text("---\nmodel_name: mine \nversion: v1.2\n---\n# mine\n")
    samples = find_samples(tmp_path).samples
    assert [(s.id, s.model) for s in samples] == [("episode_000001", "mine v1.2"), ("episode_000002", "mine v1.2")]
