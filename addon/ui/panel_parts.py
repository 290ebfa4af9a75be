"""Sentences and estimates as Blender's panels draw them."""

from __future__ import annotations

import textwrap
from typing import Any

import bpy

from ...core.util.user_text import Sentence, begin_line
from ..app.estimate import Estimate
from ..show.bake_text import describe_seconds
from .select_operator import is_known

_CHARACTER_PIXELS = 7.0  # of a label's text at a scale of 1, on average
_BUTTON_CHARACTERS = 6


def draw_sentence(layout: Any, context: bpy.types.Context, text: str, icon: str) -> None:
    """A sentence that begins with no name."""
    _draw_wrapped(layout, context, begin_line(text), icon)


def _draw_wrapped(layout: Any, context: bpy.types.Context, text: str, icon: str, narrower: int = 0) -> None:
    """A text over as many lines as it needs; Blender's labels do not wrap."""
    width = context.region.width / (_CHARACTER_PIXELS * context.preferences.system.ui_scale) - 8 - narrower
    column = layout.column(align=True)
    for i, line in enumerate(textwrap.wrap(text.replace(" %", "\N{NO-BREAK SPACE}%"), max(int(width), 16))):
        column.label(text=line.replace("\N{NO-BREAK SPACE}", " "), icon=icon if i == 0 else "BLANK1")


def draw_subjects(layout: Any, context: bpy.types.Context, told: Sentence, icon: str) -> None:
    """A sentence with a button that selects what it is about."""
    selects = any(is_known(context, name) for name in told.names)
    row = layout.row()
    _draw_wrapped(row, context, begin_line(told.text, told.names), icon, _BUTTON_CHARACTERS if selects else 0)
    if selects:
        row.operator("leaflight.select", text="", icon="RESTRICT_SELECT_OFF").names = "\n".join(told.names)


def describe_estimate(estimate: Estimate) -> list[str]:
    """What will be baked, as short lines."""
    objects, pages = estimate.objects, estimate.pages
    least, most = (max(_round(seconds), 1.0) for seconds in estimate.seconds)
    span = f"usually {describe_seconds(least)} to {describe_seconds(most)}"
    return [
        f"{objects:,} object{'' if objects == 1 else 's'}, {_describe_number(estimate.area_m2)} m²",
        f"{_describe_texels(_round(estimate.texels))} texels, {_describe_number(estimate.density)} per metre",
        f"{'1 page' if pages == 1 else f'about {pages} pages'} of {estimate.page_size} x {estimate.page_size}",
        f"about {_describe_memory(estimate.memory_mb)} of memory",
        f"about {describe_seconds(most)}, as last time" if least == most else span,
    ]


def describe_takers(estimate: Estimate) -> list[str]:
    """Who takes much of the page, a sentence each."""
    return [f"{name} takes {share:.0%} of the texels".replace("%", " %") for name, share in estimate.takers]


def describe_evened(estimate: Estimate) -> list[str]:
    """What Even Out does, in a line; none where that is nothing."""
    count = len(estimate.evened)
    return [f"Even Out: {count:,} object{'' if count == 1 else 's'} finer"] if count else []


def describe_plan(context: bpy.types.Context, count: int = 0) -> tuple[str, ...]:
    """Lines about a bake that begins: those of the estimate, or where the scene has changed since, the number of objects, if known."""
    meter = context.window_manager.leaflight_meter
    if meter.estimate is not None and not meter.stale:
        return tuple(describe_estimate(meter.estimate))
    return (f"{count:,} object{'' if count == 1 else 's'}" if count else "", "", "")


def prepare(layout: Any) -> Any:
    """Labels left and fields right, without dots for keyframes."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout


def _round(value: float) -> float:
    """An estimate claims two digits at most."""
    return float(f"{value:.2g}")


def _describe_number(value: float) -> str:
    """With three digits at least."""
    return f"{value:.3g}" if value < 1000.0 else f"{float(f'{value:.3g}'):,.0f}"


def _describe_texels(count: float) -> str:
    return f"{count:,.0f}" if count < 1e6 else f"{count / 1e6:g} M"


def _describe_memory(memory_mb: float) -> str:
    return f"{memory_mb / 1000:.1f} GB" if memory_mb >= 1000 else f"{_round(memory_mb):.0f} MB"
