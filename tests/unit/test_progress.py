import pytest
from leaflight.core.util.messages import Status
from leaflight.core.util.progress import Interrupted, ProgressReporter, stretch, unwatched

SAID = Status("charts", "Unwrapping")


def test_a_word_a_second_says_the_share_that_is_done_and_at_what(clock):
    told = []
    speaker = ProgressReporter(told.append)
    for second, share, about in ((0.9, 0.1, ""), (1.1, 0.25, ""), (2.0, 0.3, ""), (2.2, 0.5, "Floor"), (9.0, 0.996, "")):
        clock[0] = 1000.0 + second
        speaker.say(SAID, share, about)
    assert told == [
        Status("charts", "Unwrapping, 25%", 0.25),
        Status("charts", "Unwrapping, 50%: Floor", 0.5),
        Status("charts", "Unwrapping, 100%", 0.996),
    ]


def test_after_half_a_second_the_impatient_are_heard_whenever_anything_is_said(clock):
    told, stop = [], []
    speaker = ProgressReporter(told.append, lambda: bool(stop))
    clock[0] += 1.1
    speaker.say(SAID, 0.5)
    stop.append(True)
    clock[0] += 0.01
    with pytest.raises(Interrupted):
        speaker.say(SAID, 0.6)
    assert len(told) == 1
    speaker = ProgressReporter(pytest.fail, lambda: True)
    clock[0] += 0.45
    speaker.say(SAID, 0.5)
    clock[0] += 0.1
    with pytest.raises(Interrupted):
        speaker.say(SAID, 0.5)


def test_shares_of_a_part_of_a_stage_are_told_as_shares_of_the_stage():
    told = []
    say = stretch(lambda *word: told.append(word), SAID, 0.25, 0.75)
    for share in (0.0, 0.5, 1.0):
        say(share)
    assert told == [(SAID, 0.25, ""), (SAID, 0.5, ""), (SAID, 0.75, "")]
    stretch(unwatched, SAID)(0.5)
