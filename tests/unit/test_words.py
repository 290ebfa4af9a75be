import pytest
from leaflight.core import words
from leaflight.core.messages import Status
from leaflight.core.words import Interrupted, Words

SAID = Status("charts", "Unwrapping")


@pytest.fixture
def clock(monkeypatch):
    """Stands still until it is set."""
    now = [100.0]
    monkeypatch.setattr(words.time, "monotonic", lambda: now[0])
    return now


def test_a_word_a_second_says_the_share_that_is_done_and_at_what(clock):
    told = []
    speaker = Words(told.append)
    for second, share, about in ((0.9, 0.1, ""), (1.1, 0.25, ""), (2.0, 0.3, ""), (2.2, 0.5, "Floor"), (9.0, 0.996, "")):
        clock[0] = 100.0 + second
        speaker.say(SAID, share, about)
    assert told == [
        Status("charts", "Unwrapping, 25%", 0.25),
        Status("charts", "Unwrapping, 50%: Floor", 0.5),
        Status("charts", "Unwrapping, 100%", 0.996),
    ]


def test_the_same_word_is_not_said_again(clock):
    told = []
    speaker = Words(told.append)
    for second, share in ((2, 0.0), (4, 0.0), (6, 0.01)):
        clock[0] = 100.0 + second
        speaker.say(SAID, share, "Terrain")
    assert [message.text for message in told] == ["Unwrapping, 0%: Terrain", "Unwrapping, 1%: Terrain"]


def test_whoever_has_lost_patience_is_heard_when_there_may_be_a_word(clock):
    asked = []
    speaker = Words(pytest.fail, lambda: asked.append(True) or True)
    speaker.say(SAID, 0.5)
    assert not asked
    clock[0] += 1.1
    with pytest.raises(Interrupted):
        speaker.say(SAID, 0.5)
