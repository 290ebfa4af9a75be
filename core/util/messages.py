"""Messages of the core to the calling process: one JSON object per line. All kinds are defined here."""

import json
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias, get_args


@dataclass(frozen=True)
class Status:
    """The begin or the progress of a stage; `stage` is one of the names in the report's seconds.

    share   finished share of the stage, which the text contains too; 0 at the begin
    """

    stage: str
    text: str
    share: float = 0.0


@dataclass(frozen=True)
class Progress:
    """The state after a round."""

    fraction: float
    photons: int
    photons_per_s: float
    estimated_error: float  # relative; nan until it can be estimated
    seconds_left: float  # nan until it can be estimated
    leaves: int


@dataclass(frozen=True)
class Preview:
    """A page of the current stable light was written to `path` (.npy, (height, width, 4) float16, row 0 at the bottom)."""

    page: int
    path: str


@dataclass(frozen=True)
class Warning_:
    """Something was replaced or left out; `subject` names the object, material or light, "" for the scene."""

    subject: str
    text: str


@dataclass(frozen=True)
class Error:
    """The scene cannot be baked; `text` names the object and says what to do."""

    text: str


@dataclass(frozen=True)
class Done:
    """The last message; `result` is the path of the result file, `interrupted` is true for a cancelled bake.

    `result` is empty if the bake was cancelled before there was any light.
    """

    result: str
    interrupted: bool


Message: TypeAlias = Status | Progress | Preview | Warning_ | Error | Done

_KINDS: dict[str, type[Message]] = {one.__name__.rstrip("_").upper(): one for one in get_args(Message)}


def encode_message(message: Message) -> str:
    """One line of JSON without a line end."""
    kind = next(name for name, cls in _KINDS.items() if cls is type(message))
    return json.dumps({"kind": kind, **asdict(message)})


def decode_message(line: str) -> Message:
    """The message of one line.

    Raises ValueError if the line is not a message.
    """
    try:
        fields: dict[str, Any] = json.loads(line)
        return _KINDS[fields.pop("kind")](**fields)
    except (KeyError, TypeError, AttributeError, ValueError) as reason:
        raise ValueError(f"not a Leaflight message: {line[:200]!r}") from reason
