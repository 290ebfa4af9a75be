"""Numbers as people write them."""

import pytest
from leaflight.addon.app.quantities import read_count, read_duration, read_number, write_count, write_duration


@pytest.mark.parametrize(
    ("count", "text"), [(64_000_000, "64 M"), (1_500_000, "1.5 M"), (1000, "1 k"), (10**12, "1000 G"), (1_234_567, "1,234,567")]
)
def test_counts_are_written_short_and_read_again(count, text):
    assert write_count(count) == text
    assert read_count(text) == count


@pytest.mark.parametrize(("text", "count"), [("64m", 64_000_000), ("2e6", 2_000_000), ("1,000", 1000), (" 3.5 M photons ", 3_500_000)])
def test_counts_may_be_written_in_many_ways(text, count):
    assert read_count(text) == count


@pytest.mark.parametrize("text", ["", "many", "-5", "64 Q", "1e999", "0x10", "5 M M"])
def test_what_is_no_count_is_none(text):
    assert read_count(text) is None


@pytest.mark.parametrize(("seconds", "text"), [(90.0, "1.5 min"), (45.0, "45 s"), (3600.0, "1 h"), (61.0, "61 s")])
def test_durations_are_written_and_read_again(seconds, text):
    assert write_duration(seconds) == text
    assert read_duration(text) == seconds


@pytest.mark.parametrize(("text", "seconds"), [("90", 90.0), ("5min", 300.0), ("2:30", 150.0), ("1:00:05", 3605.0), ("1.5 H", 5400.0)])
def test_durations_may_be_written_in_many_ways(text, seconds):
    assert read_duration(text) == seconds


@pytest.mark.parametrize("text", ["", "soon", "-5", "5 weeks", "1:2:3:4"])
def test_what_is_no_duration_is_none(text):
    assert read_duration(text) is None


def test_plain_numbers():
    assert (read_number("12.5"), read_number(" 1e3 "), read_number("twelve")) == (12.5, 1000.0, None)
