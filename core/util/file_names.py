"""Names of image files, from a pattern that the user may choose; they are valid on every system."""

import re
import unicodedata
from collections.abc import Iterable

DEFAULT_PATTERN = "{name}.{pass}"
MAX_NAME_BYTES = 180  # of an object's name within a file name: systems allow 255 in all, and Blender as many for the object
MAX_PATTERN_BYTES = 30  # of the pattern without its fields, for the same reason

_FIELDS = ("name", "pass", "page")
_FIELD = re.compile(r"\{([^{}]*)\}")
_FORBIDDEN = re.compile(r'[<>:"/\\|?*\x00-\x1f]')
_DEVICE = re.compile(r"(con|prn|aux|nul|(com|lpt)[0-9])(\.|$)", re.IGNORECASE)  # device names of Windows, with any suffix


def find_pattern_error(pattern: str) -> str:
    """The error of a pattern, "" if it is valid.

    Fields: {name}, the object, or atlas_page for shared pages; {pass}; {page}, a number.
    """
    fields, text = _FIELD.findall(pattern), _FIELD.sub("", pattern)
    unknown = [field for field in fields if field not in _FIELDS]
    if unknown or "{" in text or "}" in text:
        return f"expected no other fields than {', '.join(f'{{{field}}}' for field in _FIELDS)}, got {pattern!r}"
    if not {"name", "page"} & set(fields) or fields.count("name") > 1:
        return f"expected {{name}} once, or {{page}}, so that each page has a file of its own, got {pattern!r}"
    if _FORBIDDEN.search(text):
        return f'expected none of < > : " / \\ | ? *, which files cannot be called, got {pattern!r}; a folder is given by the output'
    if len(text.encode()) > MAX_PATTERN_BYTES:
        return f"expected at most {MAX_PATTERN_BYTES} letters besides the fields, got {pattern!r}"
    return ""


def has_pass(pattern: str) -> bool:
    """Whether files of two passes have different names."""
    return "pass" in _FIELD.findall(pattern)


def fill_pattern(pattern: str, name: str, pass_name: str, page: int) -> str:
    """The file's name without suffix; `name` is from make_unique."""
    values = {"name": name, "pass": pass_name, "page": str(page)}
    return _FIELD.sub(lambda match: values[match[1]], pattern)


def make_unique(names: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """The names, with underscores appended to those that occurred before or are taken.

    Comparison ignores case and Unicode composition, as some file systems do.
    """
    used = {_fold(name) for name in taken}
    out: list[str] = []
    for name in names:
        unique = name
        while _fold(unique) in used:
            unique += "_"
        used.add(_fold(unique))
        out.append(unique)
    return out


def _fold(name: str) -> str:
    return unicodedata.normalize("NFC", name).lower()


def clean_name(name: str) -> str:
    """A name that is valid for a file on every system: shortened, with underscores for forbidden characters."""
    short = name.encode()[:MAX_NAME_BYTES].decode(errors="ignore")
    clean = _FORBIDDEN.sub("_", short).strip(". ") or "_"
    return f"_{clean}" if _DEVICE.match(clean) else clean
