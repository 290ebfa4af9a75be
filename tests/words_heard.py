"""Whether a piece of work that tells how far it is can be stopped at each of its words."""

from collections.abc import Callable

import pytest
from leaflight.core.util.progress import Interrupted, Watch


def check_every_word_is_heard(work: Callable[[Watch], object]) -> None:
    """Of work that is done anew for each word; whoever raises at one hears none after it."""
    words: list[tuple[object, ...]] = []
    work(lambda *word: words.append(word))
    assert words
    for patience in range(len(words)):
        told: list[tuple[object, ...]] = []

        def stop(*word: object, told: list[tuple[object, ...]] = told, patience: int = patience) -> None:
            told.append(word)
            if len(told) > patience:
                raise Interrupted

        with pytest.raises(Interrupted):
            work(stop)
        assert len(told) == patience + 1
