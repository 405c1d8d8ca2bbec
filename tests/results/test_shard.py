import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.results.metadata import Shard


@pytest.mark.parametrize("count", [1, 2, 3, 7, 9])
def test_shards_partition_the_samples_evenly(count):
    items = list(range(7))
    parts = [Shard.parse(f"{k}/{count}").take(items) for k in range(1, count + 1)]
    assert sorted(item for part in parts for item in part) == items
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
    assert len({str(Shard.parse(f"{k}/{count}")) for k in range(1, count + 1)}) == count


@pytest.mark.parametrize("text", ["", "1", "0/3", "4/3", "1/0", "-1/3", "a/b", "1/3/5", "1/" + "9" * 5000])
def test_malformed_shards_are_usage_errors(text):
    with pytest.raises(UsageError, match="expected I/N with I from 1 to N"):
        Shard.parse(text)
