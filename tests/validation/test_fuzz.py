"""Fuzz: the same inputs from the same seed, and what fails is kept."""

import json

import pytest

# Fuzz


@pytest.mark.slow
def test_the_same_seed_gives_the_same_inputs_and_readers_stand_them(tmp_path):
    from kinebench_drake.validation.fuzz.campaign import Campaign, distinct

    one = Campaign(5)
    assert [one.draw(n) for n in range(40)] == [Campaign(5).draw(n) for n in range(40)]
    trials = list(one.run(range(40), tmp_path))
    assert not distinct(trials)
    assert {t.outcome.fate.value for t in trials} == {"read", "refused"}


def test_a_fuzzed_input_that_fails_is_kept(tmp_path, monkeypatch):
    from kinebench_drake.validation.fuzz import campaign
    from kinebench_drake.validation.fuzz.worker import Fate, Outcome

    class Broken:
        def __init__(self, home):
            pass

        def read(self, kind, folder):
            return Outcome(fate=Fate.TRACEBACK, told="boom\nValueError: no")

        def close(self):
            pass

    monkeypatch.setattr(campaign, "Worker", Broken)
    (trial,) = campaign.Campaign(0).run([3], tmp_path)
    kept = json.loads((tmp_path / "failures" / "000003" / "failure.json").read_text())
    assert (kept["seed"], kept["number"], kept["fate"]) == (0, 3, "traceback")
    assert list(campaign.distinct([trial])) == ["traceback: ValueError: no"]
