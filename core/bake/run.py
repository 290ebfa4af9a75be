"""The running bake: its folder, its listener, and the time of its stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..util import ablation
from ..util.job import Job
from ..util.messages import Message, Status, Warning_
from ..util.progress import ProgressReporter, Watch
from .deadline import Deadline


@dataclass
class Run:
    """Context of every stage of a bake.

    folder        has the snapshot, the job, and all files of the bake except the images
    job           the request, without mechanisms that are switched off
    tell          receives every message
    should_stop   returns whether the user wants to stop with the best light so far
    seconds       time of each stage
    deadline      deadline by the time limit
    cpu_began_s   CPU seconds of this process before the bake
    warnings      (subject, sentence) of what was replaced or left out; repeated when the same bake is reused
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
        """Announce the stage and measure its time; one stage may have several parts."""
        self.tell(said)
        begin = time.perf_counter()
        yield
        self.seconds[said.stage] = self.seconds.get(said.stage, 0.0) + time.perf_counter() - begin

    def watch(self) -> Watch:
        """A progress reporter for the next stage; it raises Interrupted if the user stops or time is up."""
        return ProgressReporter(self.tell, lambda: self.should_stop() or self.deadline.is_lost()).say

    def warn(self, warnings: Iterable[tuple[str, str]]) -> None:
        """Report (subject, sentence) of what was replaced or left out."""
        for subject, text in warnings:
            self.warnings.append((subject, text))
            self.tell(Warning_(subject, text))
