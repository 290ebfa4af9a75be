"""The bake that runs, or the last one, as operators drive it and the panel shows it; no bpy here."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

from ...core.util.messages import Done, Error, Message, Preview, Progress, Status, Warning_
from ..show.bake_pace import Pace
from ..show.bake_text import Worn, describe_count, describe_percent, describe_seconds, summarize
from .bake_bar import Bar

_ROUGH = 0.1  # an error whose decimals say nothing


class Process(Protocol):
    """What a bake's state needs of job.BakeProcess."""

    def messages(self) -> Iterator[Message]: ...
    def cancel(self) -> None: ...
    def kill(self) -> None: ...


def _do_nothing() -> None:
    pass


@dataclass
class BakeState:
    """One bake: begin, then drain or wait until it gives how the bake ended, then end.

    scene       session_uid of the scene that is baked, here and in `worn`
    plan        lines about what is baked
    worn        the last bake of each scene that came to a result: those that fail or are thrown away change nothing
    stopping    the best so far was asked for
    discarded   the child was killed at the user's wish: that is no error
    notice      what the user has to do before the result can be shown, "" nothing
    previews    the newest file of each page that has not been shown yet
    give_back   puts the scene back as it was, where it is being read
    result      the core's result file, once it is on the objects; `seconds` is then the whole bake's
    """

    scene: int = 0
    worn: dict[int, Worn] = field(default_factory=dict)
    stage: str = ""
    plan: tuple[str, ...] = ()
    progress: Progress | None = None
    bar: Bar = field(default_factory=Bar)
    stopping: bool = False
    discarded: bool = False
    notice: str = ""
    error: str = ""
    warnings: list[tuple[str, str]] = field(default_factory=list)
    result: dict[str, Any] | None = None
    seconds: float = 0.0
    target: float = 0.0
    previews: dict[int, str] = field(default_factory=dict)
    give_back: Callable[[], None] = _do_nothing
    _began: float = 0.0
    _process: Process | None = None
    _queue: queue.SimpleQueue[Message] = field(default_factory=queue.SimpleQueue)

    @property
    def running(self) -> bool:
        """Whether a bake is under way, from its start until its result is on the objects."""
        return self._process is not None

    @property
    def fraction(self) -> float:
        """Share of the bake that is done."""
        return self.bar.fraction

    @property
    def elapsed(self) -> float:
        """Seconds since the bake began."""
        return time.monotonic() - self._began

    def clear(self) -> None:
        """Forget all bakes; one that runs is killed."""
        self.worn = {}
        self.forget()

    def forget(self, scene: int = 0) -> None:
        """Forget the last bake, but for what scenes wear; one that runs is killed. The next one is of `scene`."""
        self.discard()
        self.__init__(scene, self.worn)  # type: ignore[misc]  # the panel and the operators hold this very object

    def prepare(self, process: Process, began: float, give_back: Callable[[], None], scene: int = 0) -> None:
        """The scene is read for a process that waits; `give_back` puts it back as it was, before something else happens to it."""
        self.forget(scene)
        self._began, self._process, self.give_back = began, process, give_back

    def begin(self, process: Process, began: float, warnings: list[tuple[str, str]], target: float = 0.0, scene: int = 0) -> None:
        """Listen to a process that has just been started; `began` is a time.monotonic(), `target` the error asked for."""
        bar = Bar()
        if process is self._process:  # it has waited for this
            self._process, bar = None, self.bar
        self.forget(scene)
        self.target, self.bar = target, bar
        self.stage, self._began, self._process = "Starting", began, process
        self.warnings = list(warnings)
        threading.Thread(target=_listen, args=(process, self._queue), daemon=True).start()

    def begin_kept(self, messages: list[Message], began: float, warnings: list[tuple[str, str]], scene: int = 0) -> Done | Error | None:
        """A bake that need not be done; gives its last message."""
        self.forget(scene)
        self._began, self.warnings = began, list(warnings)
        for message in messages:
            self._queue.put(message)
        return self.drain()

    def fail(self, error: str, scene: int = 0) -> None:
        """A bake that could not even begin."""
        self.forget(scene)
        self.error = error

    def drain(self) -> Done | Error | None:
        """Hear all messages that have come; gives the last one of the bake when it was among them."""
        while not self._queue.empty():
            ended = self.hear(self._queue.get())
            if ended:
                return ended
        return None

    def take_previews(self) -> dict[int, str]:
        """Files by page that came since the last time."""
        taken, self.previews = self.previews, {}
        return taken

    def wait(self) -> Done | Error:
        """Hear messages until the bake has ended."""
        while True:
            ended = self.hear(self._queue.get())
            if ended:
                return ended

    def cancel(self) -> None:
        """Ask for the best so far."""
        if self._process is not None and not self.stopping:
            self.stopping = True
            self._process.cancel()

    def discard(self) -> None:
        """End the bake at once, without a result."""
        if self._process is not None:
            self.discarded = True
            self._process.kill()

    def end(self, error: str = "", result: dict[str, Any] | None = None, earlier: Pace | None = None) -> None:
        """The bake is over; its folder is no longer needed. `earlier` as for Worn.of_result."""
        self.error, self.result, self.seconds = error, result, self.elapsed
        self.notice, self._process = "", None
        if result is not None:
            self.worn[self.scene] = Worn.of_result(result, self.seconds, self.stage, self.warnings, earlier)

    def hear(self, message: Message) -> Done | Error | None:
        """Take one message in; gives it when it is the last one of the bake."""
        match message:
            case Status():
                self.stage = message.text
                self.bar.hear_status(message)
            case Progress():
                self.progress = message
                self.bar.hear_progress(message)
            case Preview(page, path):
                self.previews[page] = path
            case Warning_(subject, text):
                self.warnings.append((subject, text))
            case Done() | Error():
                return message
        return None

    def describe(self) -> tuple[str, str]:
        """Text for the progress bar, and a line below it."""
        if self.notice:
            return "100 %", self.notice
        progress, stage = self.progress, "Finishing with the best so far" if self.stopping else self.stage
        bar, left = f"{100.0 * self.bar.fraction:.0f} %", self.bar.predict_seconds()
        if progress is None or self.stopping or self.bar.is_writing:
            return bar, stage
        if left >= 1.0:
            bar += f", {describe_seconds(left)} left"
        line, error = f"{stage}: {describe_count(progress.photons)}", progress.estimated_error
        if not math.isfinite(error):
            return bar, line
        return bar, f"{line}, error {describe_percent(error) if error < _ROUGH else f'{100.0 * error:.0f} %'}"

    def describe_goal(self) -> str:
        """A line about how far the light has to go; "" while no photon flies, as when a bake begins to go on."""
        if self.progress is None or self.notice or self.stopping or not self.progress.photons_per_s or not self.target:
            return ""
        return f"to an error of {describe_percent(self.target)}"

    def describe_worn(self, scene: int) -> tuple[str, ...]:
        """Lines about the bake that a scene wears; empty where nothing is known of it, as of a file that was opened."""
        return self.worn.get(scene, Worn()).lines

    def list_warnings(self, scene: int, has_bake: bool) -> list[tuple[str, str]]:
        """What is to be told beside a scene: of its bake that runs or has failed, else of the one that it wears."""
        if scene == self.scene and (self.running or (self.error and self.warnings)):
            return self.warnings
        return list(self.worn.get(scene, Worn()).warnings) if has_bake else []

    def summarize(self) -> list[str]:
        """Lines about the last result; empty without one."""
        return [] if self.result is None else summarize(self.result, self.seconds, self.stage)


def _listen(process: Process, heard: queue.SimpleQueue[Message]) -> None:
    try:
        for message in process.messages():
            heard.put(message)
    except (ValueError, OSError) as reason:  # a line that is no message, or a pipe that broke: nothing to wait for any more
        process.kill()
        heard.put(Error(f"The baking process cannot be understood ({reason}): this is a fault of Leaflight's, please report it."))
