"""Sentences for people, and the objects that each is about."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass

_NAMED = 3  # names in one sentence: a panel is narrow


@dataclass(frozen=True)
class Told:
    """One sentence and the names of what it is about; none where that is the scene."""

    names: tuple[str, ...]
    text: str


def group_warnings(warnings: Iterable[tuple[str, str]]) -> list[Told]:
    """Warnings (subject, sentence), each sentence once, with the names of all that it is about."""
    subjects: dict[str, list[str]] = {}
    for subject, text in warnings:
        subjects.setdefault(_strip_subject(text, subject), []).append(subject)
    return [_tell(names, sentence) for sentence, names in subjects.items()]


def split_error(error: str, is_known: Callable[[str], bool]) -> Told:
    """An error with its subject, which stands before a colon: the longest that is known, for names may hold colons too."""
    parts = error.split(": ")
    subjects = [": ".join(parts[:count]) for count in range(len(parts) - 1, 0, -1)]
    return Told(tuple(subject for subject in subjects if is_known(subject))[:1], error)


def match_name(subject: str, known: Container[str]) -> str:
    """The known name that is meant, "" where there is none; an instance is named "<object>.<what it shows>"."""
    name = subject
    while name not in known and "." in name:
        name = name.rpartition(".")[0]
    return name if name in known else ""


def _strip_subject(text: str, subject: str) -> str:
    return text.removeprefix(f"{subject}: ") if subject else text


def _tell(subjects: list[str], sentence: str) -> Told:
    names = tuple(dict.fromkeys(name for name in subjects if name))
    if not names:
        return Told((), sentence)
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return Told(names, f"{', '.join(names[:_NAMED])}{more}: {sentence}")
