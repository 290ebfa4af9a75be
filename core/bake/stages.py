"""A bake under way: its folder, who hears of it, and how long its stages take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..util import ablation
from ..util.job import Job
from ..util.messages import Message, Status, Warning_
from ..util.words import Watch, Words
from .deadline import Deadline


@dataclass
class Run:
    """What every stage of a bake is given.

    folder        with the snapshot and the job; all that is made goes there but the images
    job           what is asked for, without mechanisms that are switched off
    tell          hears every message
    should_stop   whether the best so far is asked for
    seconds       of each stage
    deadline      of the time limit
    cpu_began_s   CPU seconds that this process had used before
    warnings      (subject, sentence) of all that was replaced or left out; those who bake the same again hear of it too
    """

    folder: Path
    job: Job
    tell: Callable[[Message], None]
    should_stop: Callable[[], bool]
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[tuple[str, str]] = field(default_factory=list)
    deadline: Deadline = field(default_factory=Deadline)
    cpu_began_s: float = field(default_factory=time.process_time)

    def __post_init__(self) -> None:
        self.job = replace(self.job, settings=ablation.trim_settings(self.job.settings))
        switched_off = ablation.describe_without()
        self.warn([("", switched_off)] if switched_off else [])

    @contextmanager
    def stage(self, said: Status) -> Iterator[None]:
        """The stage that is `said`, told as it begins; one may come in several parts."""
        self.tell(said)
        begin = time.perf_counter()
        yield
        self.seconds[said.stage] = self.seconds.get(said.stage, 0.0) + time.perf_counter() - begin

    def watch(self) -> Watch:
        """For a stage that now begins: hears how far it is, and ends it by an Interrupted where nobody wants the rest."""
        return Words(self.tell, lambda: self.should_stop() or self.deadline.is_lost()).say

    def warn(self, warnings: Iterable[tuple[str, str]]) -> None:
        """Of what was replaced or left out: subject and sentence of each."""
        for subject, text in warnings:
            self.warnings.append((subject, text))
            self.tell(Warning_(subject, text))
