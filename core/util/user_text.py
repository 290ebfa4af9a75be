"""Grouping of warnings: each sentence with all objects that it concerns."""

import re
from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass

_NAMED = 3  # names in one sentence, since a panel is narrow
_NUMBER = re.compile(r"\d+([.,]\d+)*")
_VERBS = frozenset(("is", "has", "was", "does", "casts"))  # first words of sentences about one object


@dataclass(frozen=True)
class Sentence:
    """A sentence and the names of its subjects; no names if it is about the scene."""

    names: tuple[str, ...]
    text: str


def group_warnings(warnings: Iterable[tuple[str, str]]) -> list[Sentence]:
    """Warnings (subject, sentence), each sentence once, with the names of all its subjects.

    Sentences that differ only in numbers are merged.
    """
    subjects: dict[str, tuple[list[str], list[str]]] = {}
    for subject, text in warnings:
        sentence = strip_subject(text, subject)
        names, sentences = subjects.setdefault(_NUMBER.sub("0", sentence) if subject else sentence, ([], []))
        names.append(subject)
        sentences.append(sentence)
    return [write_sentence(names, _say_once(sentences, names)) for names, sentences in subjects.values()]


def write_sentence(subjects: Iterable[str], sentence: str) -> Sentence:
    """A sentence about any one of the subjects, rephrased for all of them."""
    names = tuple(dict.fromkeys(name for name in subjects if name))
    if not names:
        return Sentence((), sentence)
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    said = sentence if len(names) == 1 else _say_of_each(sentence)
    return Sentence(names, f"{', '.join(names[:_NAMED])}{more}: {said}")


def begin_line(text: str, names: Iterable[str] = ()) -> str:
    """The text with a capital letter, unless it begins with one of the names, which stays as the user wrote it."""
    return text if text.startswith(tuple(names)) else text[:1].upper() + text[1:]


def split_error(error: str, is_known: Callable[[str], bool]) -> Sentence:
    """An error with its subject: the longest known name before a colon, since names may contain colons."""
    parts = error.split(": ")
    subjects = [": ".join(parts[:count]) for count in range(len(parts) - 1, 0, -1)]
    return Sentence(tuple(subject for subject in subjects if is_known(subject))[:1], error)


def match_name(subject: str, known: Container[str]) -> str:
    """The known name that a subject means, "" if there is none; an instance is named "<object>.<what it shows>"."""
    name = subject
    while name not in known and "." in name:
        name = name.rpartition(".")[0]
    return name if name in known else ""


def strip_subject(text: str, subject: str) -> str:
    """A sentence without the name that it may begin with."""
    return text.removeprefix(f"{subject}: ") if subject else text


def _say_once(sentences: list[str], names: list[str]) -> str:
    """One sentence for several that differ at most in numbers."""
    return sentences[0] if len(set(sentences)) == 1 else f"{sentences[0].removesuffix('.')} (numbers of {names[0]})"


def _say_of_each(sentence: str) -> str:
    if sentence.partition(" ")[0] in _VERBS:
        return f"each {sentence}"
    return re.sub(r"\bits\b", "each one's", sentence, count=1)
