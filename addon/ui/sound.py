"""A short tone at the end of a bake, for those who do something else meanwhile."""

from __future__ import annotations

from functools import partial
from typing import Any

import bpy

_HZ, _SECONDS, _VOLUME = (659.3, 880.0), 0.18, 0.3


def play_tones() -> bool:
    """Two tones, one after the other; gives whether the machine could play them."""
    try:
        import aud
    except ImportError:  # a Blender that was built without sound
        return False
    try:
        first, second = (aud.Sound.sine(hz).limit(0.0, _SECONDS).fadein(0.0, 0.02).fadeout(_SECONDS - 0.05, 0.05) for hz in _HZ)
        device = aud.Device()
        handle = device.play(first.join(second).volume(_VOLUME))
    except aud.error:  # no device
        return False
    bpy.app.timers.register(partial(_let_go, device, handle), first_interval=1.0)  # a device that nobody holds falls silent
    return True


def _let_go(*_: Any) -> None:
    """Ends the timer, and with it what it holds."""
