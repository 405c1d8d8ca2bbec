import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.driver import section, simulate_run


@settings(max_examples=30, deadline=None)
@given(workers=st.integers(1, 300), driver_ms=st.floats(0.0, 100.0))
def test_a_simulated_run_is_as_fast_as_its_workers_and_its_driver_allow(workers, driver_ms):
    samples, sample_s, driver_s = 600, 2.0, 1e-3 * driver_ms
    run = simulate_run(workers, samples, sample_s, driver_s)
    seconds = 3600.0 * run.hours
    assert seconds >= samples * driver_s
    assert seconds >= 0.9 * samples * sample_s / workers
    assert run.efficiency <= 1.0 + 1e-9
    assert run.driver_load <= 1.0 + 1e-9
    # No longer than all work one after the other, or both limits and one sample after the other.
    assert seconds <= samples * (driver_s + 1.1 * sample_s / workers) + 3.0 * sample_s


def test_the_driver_becomes_the_limit_where_its_time_times_the_workers_is_that_of_a_sample():
    few, many = (simulate_run(workers, 20_000, 2.0, 0.01) for workers in (50, 800))
    assert few.efficiency > 0.97
    assert many.driver_load > 0.98
    assert many.efficiency == pytest.approx(2.0 / 0.01 / 800, rel=0.03)
    assert "from about 200 workers on" in section(0.01, [few, many], 2.0)
