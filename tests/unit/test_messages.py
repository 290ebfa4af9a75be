"""Each kind of message is one line there and the same object back."""

import math

import pytest
from leaflight.core.util.messages import Done, Error, Preview, Progress, Status, Warning_, decode_message, encode_message

MESSAGES = {
    "STATUS": Status("charts", "Unwrapping, 37%: Floor", 0.37),
    "PROGRESS": Progress(0.25, 65_536, 1e6, 0.071, 12.5, 300),
    "PREVIEW": Preview(2, "/a folder/page 2.npy"),
    "WARNING": Warning_("Lampe \u00e4\u4e2d", 'two lines\nand "quotes"'),
    "ERROR": Error("Table: has no faces; add some."),
    "DONE": Done("C:\\temp\\result.json", True),
}


@pytest.mark.parametrize(("kind", "message"), MESSAGES.items(), ids=MESSAGES)
def test_round_trip(kind, message):
    line = encode_message(message)
    assert "\n" not in line
    assert f'"kind": "{kind}"' in line
    assert decode_message(line + "\n") == message


def test_numbers_that_cannot_be_told_stay_nan():
    back = decode_message(encode_message(Progress(0.0, 0, 0.0, math.nan, math.nan, 0)))
    assert math.isnan(back.estimated_error)
    assert math.isnan(back.seconds_left)


@pytest.mark.parametrize(
    "line",
    [
        "",
        "Blender 5.0.1 (hash 1234)",
        "[]",
        "null",
        '{"text": "no kind"}',
        '{"kind": "WARN", "subject": "", "text": ""}',
        '{"kind": "ERROR"}',
        '{"kind": "ERROR", "text": "", "more": 1}',
        '{"kind": "DONE", "result": "x", ',
        '{"kind": ["ERROR"], "text": ""}',
    ],
)
def test_another_line_is_refused_and_named(line):
    with pytest.raises(ValueError, match="not a Leaflight message") as caught:
        decode_message(line)
    assert line[:20] in str(caught.value).encode().decode("unicode_escape")
