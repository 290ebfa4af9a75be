"""What the pages of documentation name is there: files, headings, targets of make, command line options with their defaults."""

import dataclasses
import re
from pathlib import Path

import pytest
from leaflight.addon.app.arguments import parse_arguments
from leaflight.core.util.settings import Settings

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "sample_blends/*.md")
    for path in ROOT.glob(pattern)
    if not any(part.startswith(".") for part in path.relative_to(ROOT).parts)
)

LONGEST_ENTRY = 320  # characters

_LINK = re.compile(r"\]\(([^)\s]+)\)")
_CODE = re.compile(r"`([^`\n]+)`")
_FLAG = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
_SOURCE = re.compile(r"^(?:core|addon|tests|tools|sample_blends|docs)/[\w/.*]+$")


def list_anchors(page: Path) -> set[str]:
    """What links to the page's headings say after #."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def find_missing(page: Path, text: str) -> list[str]:
    """Links and paths in code font, from `page`, that lead nowhere."""
    missing = []
    for link in _LINK.findall(text):
        if link.startswith(("http:", "https:")):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if not target.exists() or (anchor and anchor not in list_anchors(target)):
            missing.append(link)
    return missing + [code for code in _CODE.findall(text) if _SOURCE.match(code) and not any(ROOT.glob(code.rstrip("/")))]


def list_options(capsys) -> tuple[set[str], set[str]]:
    """Flags of the command line, and those of them that only say the default."""
    with pytest.raises(SystemExit):
        parse_arguments(["bake", "--help"], "leaflight", with_scene=True)
    text = capsys.readouterr().out
    return set(_FLAG.findall(text)) - {"--help"}, set(re.findall(r"the opposite of\s+(--[a-z-]+)", text))


def read_options() -> str:
    """The README's part that tells the options."""
    return (ROOT / "README.md").read_text(encoding="utf-8").partition("## The command line")[2].partition("\n### ")[0]


@pytest.mark.parametrize("page", PAGES, ids=[path.relative_to(ROOT).as_posix() for path in PAGES])
def test_links_and_files_are_there(page):
    assert find_missing(page, page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "text", ["[a](nowhere.md)", "[a](README.md#nowhere)", "![](docs/nowhere.png)", "`core/nowhere.py`", "`tests/no_*.py`"]
)
def test_a_lost_one_is_seen(text):
    assert len(find_missing(ROOT / "CONTRIBUTING.md", f"## Seams\n{text} [b](README.md#licence) `core/bake/solve.py`")) == 1


def test_every_picture_is_shown_somewhere():
    links = [(page, link) for page in PAGES for link in _LINK.findall(page.read_text(encoding="utf-8"))]
    shown = {(page.parent / link).resolve() for page, link in links if link.endswith(".png")}
    assert sorted(path.relative_to(ROOT).as_posix() for path in set(ROOT.glob("docs/**/*.png")) - shown) == []


def test_the_readme_tells_every_option_and_no_other(capsys):
    options, defaults = list_options(capsys)
    told = set(_FLAG.findall(read_options()))
    assert told - options == {"--command"}  # Blender's own
    assert options - told <= defaults


def test_defaults_in_the_readme_are_those_of_the_settings():
    knobs = {knob.metadata["flag"] or "--" + knob.name.replace("_", "-"): knob.default for knob in dataclasses.fields(Settings)}
    checked = set()
    for row in re.findall(r"^\| (`--.*) \|$", read_options(), re.MULTILINE):
        flags, _, defaults = row.replace("\\|", "/").split(" | ")
        for flag, told in zip(_FLAG.findall(flags), defaults.split(", "), strict=False):
            if flag in knobs and re.fullmatch(r"[\d.]+|`[\w.{}]+`", told):  # others are told in words
                default = knobs[flag]
                assert told.strip("`") == (" ".join(default) if isinstance(default, tuple) else str(default)), flag
                checked.add(flag)
    assert {"--size", "--error", "--seed", "--padding", "--margin", "--finest-texels", "--basis", "--pass"} <= checked


def test_targets_of_make_are_those_of_its_help():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    phony = set(re.search(r"^\.PHONY: (.*)$", makefile, re.MULTILINE)[1].split())
    assert set(re.findall(r'echo "make ([\w-]+)', makefile)) == phony - {"help"}
    pages = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert set(re.findall(r"(?:`|^    )make ([a-z-]+)", pages, re.MULTILINE)) <= phony


def find_long_entries(changelog: str) -> list[str]:
    """Entries that are more than one thing that a user notices: figures and reasons belong into the docs and the commits."""
    entries = [" ".join(entry.split()) for entry in re.findall(r"^- .*\n(?:  .*\n)*", changelog, re.MULTILINE)]
    return [entry for entry in entries if len(entry) > LONGEST_ENTRY]


def test_the_changelog_is_no_diary():
    assert find_long_entries((ROOT / "CHANGELOG.md").read_text(encoding="utf-8")) == []
    planted = f"- {'much ' * 40}\n  {'more ' * 40}\n"
    assert len(find_long_entries(f"### Added\n\n- One thing.\n{planted}- Another.\n")) == 1
