"""A bake's state in a folder, from which it can later continue to a smaller error.

The state is that after the last round, before the trees are refined, so a continued bake equals one that did not stop. It fits one scene
and one method only; both are compared before it is used.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..integrate.direct_field import DirectField
from ..integrate.gathered import GatheredField, count_rays
from ..parallel import shared_arrays
from ..radiosity.quadtree import Quadtree
from ..radiosity.tally import Tally
from ..transport.photon_log import ENERGY_NAMES
from ..util.files import read_json, write_text_whole
from ..util.job import SNAPSHOT_FILE
from ..util.settings import Settings
from .photon_shards import PhotonShard
from .solve import Solver

FORMAT = "leaflight-state"
FORMAT_VERSION = 22
INFO_FILE = "leaflight_state.json"  # marks a folder as ours
_STRUCT_FOLDER = "state"
# Groups of settings, and single settings, in which a continued bake may differ. If only the continued bake has a pass `direct`, the
# tolerance of its earlier shadow rays was relative to all light.
_FREE_GROUPS = ("Output", "Quality")
_FREE_KNOBS = ("workers", "margin")
_EARLIER = {"even_out": False, "max_pages": 1}  # values before these settings existed; they decide the layout


@dataclass(frozen=True)
class Checkpoint:
    """The state of a bake between two rounds.

    energy_w        (7, 3) float64: the ledger's sums, in the order of photon_log.ENERGY_NAMES
    cell            (k,) int64: cells of sides without a lightmap that photons fell on
    cell_flux       (2, 3, k) float64: their flux, as in cell_tally.CellTally
    gathered_of     photons whose light `gathered` is
    gather_rays     rays that gathered light, of which there may be more than `gathered` has
    late            fields of the last round's shards whose results were not added, as photon_shards.PhotonShard without folders
    """

    tree: Quadtree
    tally: Tally
    direct: DirectField
    gathered: GatheredField | None
    gathered_of: int
    energy_w: NDArray[np.float64]
    cell: NDArray[np.int64]
    cell_flux: NDArray[np.float64]
    photons: int
    rays: int
    deposits: int
    gather_rays: int
    round: int
    late: list[dict[str, Any]]

    @classmethod
    def of(cls, solver: Solver) -> Checkpoint:
        ledger = solver.ledger
        energy_w = np.array([ledger.energy_w[name] for name in ENERGY_NAMES])
        counts = ledger.photons, ledger.rays, ledger.deposits, ledger.gathered, solver.round
        parts = solver.tree, solver.tally, solver.direct, solver.gathered, solver._gathered_of
        cell = np.flatnonzero(solver.cell_tally.flux.any(axis=(0, 1)))
        late = [dataclasses.asdict(dataclasses.replace(shard, tracing="", view="")) for shard in solver.rounds.dropped]
        return cls(
            *parts,
            energy_w,
            cell,
            solver.cell_tally.flux[:, :, cell],
            *counts,
            late,
        )

    def give_to(self, solver: Solver) -> None:
        """Give the state to a new solver of the same scene and method."""
        solver.tree, solver.tally = self.tree, self.tally
        solver.direct, solver.gathered, solver.round = self.direct, self.gathered, self.round
        # A mean over passes of different size has needless noise: where a smaller error wants more rays in each, light is gathered anew.
        if self.gathered and self.gathered.rays_of_pass >= count_rays(solver.settings.error):
            solver._gathered_of = self.gathered_of
        solver.cell_tally.flux[:, :, self.cell], solver.cell_tally.photons[:] = self.cell_flux, self.tally.photons
        for field in (self.direct, self.gathered):
            if field:
                field.ask_for(solver.settings.error)
        ledger = solver.ledger
        ledger.energy_w = dict(zip(ENERGY_NAMES, self.energy_w, strict=True))
        ledger.photons, solver.photons_before = self.photons, self.photons
        ledger.rays, ledger.deposits, ledger.gathered = self.rays, self.deposits, self.gather_rays
        solver.send_again([PhotonShard(**fields) for fields in self.late])


@dataclass(frozen=True)
class Info:
    """Summary of a kept state, readable without loading it."""

    photons: int
    error: float  # stated, relative
    bytes: int
    identity: dict[str, str]
    digest: str  # of the files


def save_checkpoint(folder: Path, solver: Solver, error: float, most_bytes: int = 0) -> None:
    """Keep the state in `folder`, where it replaces an earlier one.

    most_bytes   greatest size; 0 for no limit
    Raises OSError if it cannot be written, ValueError if it is larger; each with a sentence.
    """
    struct = Checkpoint.of(solver)
    size = _count_bytes(struct)
    remove_checkpoint(folder)
    if most_bytes and size > most_bytes:
        raise ValueError(f"the bake's state takes {size / 1e6:,.0f} MB, more than the {most_bytes / 1e6:,.0f} MB allowed; it is not kept.")
    identity, place = _identify(solver.folder, solver.settings), folder / _STRUCT_FOLDER
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if place.is_symlink():  # it would lead into another folder
            place.unlink()
        shared_arrays.save_struct(place, struct)
        info = Info(solver.ledger.photons, error, size, identity, shared_arrays.hash_struct(place))
        text = json.dumps({"format": FORMAT, "version": FORMAT_VERSION, **dataclasses.asdict(info)})
        write_text_whole(folder / INFO_FILE, text)  # last, so that a state without it counts as incomplete
    except OSError as reason:
        shutil.rmtree(folder / _STRUCT_FOLDER, ignore_errors=True)
        raise OSError(f"{folder}: the bake's state cannot be kept there ({reason.strerror}); make room, or bake again.") from reason


def read_info(folder: Path) -> Info | None:
    """Summary of the state in `folder`; None if there is none that this version can continue."""
    try:
        fields: dict[str, Any] = read_json(folder / INFO_FILE)
        known = (fields.pop("format"), fields.pop("version")) == (FORMAT, FORMAT_VERSION)
        info = Info(**fields) if known else None
        return info if info is not None and _is_sound(info) else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # missing, or another program's
        return None


def _is_sound(info: Info) -> bool:
    """Whether each field has its type."""
    counts = all(isinstance(count, int) and 0 <= count < 1 << 63 for count in (info.photons, info.bytes))
    texts = [info.digest, *info.identity.keys(), *info.identity.values()]
    return counts and isinstance(info.error, int | float) and info.error >= 0.0 and all(isinstance(text, str) for text in texts)


def no_state_error(folder: Path) -> str:
    """The sentence for a folder without a readable summary."""
    return f"{folder}: holds no state of a bake that can be gone on with; bake again."


def find_differences(folder: Path, job_folder: Path, settings: Settings) -> list[str]:
    """Names of what differs between the bake of a state and a job: "scene", and settings of the method.

    Raises ValueError with a sentence if there is no state.
    """
    info = read_info(folder)
    if info is None:
        raise ValueError(no_state_error(folder))
    identity = _identify(job_folder, settings)
    known = [name for name in identity if name in info.identity or name not in _EARLIER]
    return [name for name in known if info.identity.get(name) != identity[name]]


def keep_layout(folder: Path, settings: Settings) -> Settings:
    """The settings for continuing from a state: layout settings that it lacks get the values from before they existed."""
    info = read_info(folder)
    if info is None:
        return settings
    missing: dict[str, Any] = {name: value for name, value in _EARLIER.items() if name not in info.identity}
    if settings.density > 0.0:
        missing.pop("max_pages", None)  # the density decides on the number of pages, then and now
    return dataclasses.replace(settings, **missing)


def describe_differences(folder: Path, differing: Sequence[str]) -> str:
    """The sentence for a state that does not fit."""
    return f"{folder}: is the state of a bake with another {', '.join(differing)}; bake again."


def load_checkpoint(folder: Path, job_folder: Path, settings: Settings) -> Checkpoint:
    """The state kept in `folder`, for the job in job_folder.

    Raises ValueError with a sentence if there is none, or if it does not fit the scene and the settings.
    """
    differing = find_differences(folder, job_folder, settings)
    if differing:
        raise ValueError(describe_differences(folder, differing))
    info, place = read_info(folder), folder / _STRUCT_FOLDER
    try:
        if info is None or shared_arrays.hash_struct(place) != info.digest:
            raise ValueError("its files are not those that were kept")
        kept: Checkpoint = _own_arrays(shared_arrays.load_struct(place, Checkpoint))
        return kept
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as reason:
        raise ValueError(f"{folder}: the state of the bake is damaged ({reason}); bake again.") from reason


def remove_checkpoint(folder: Path) -> None:
    """Delete what save_checkpoint wrote, and the folder if it is then empty; a folder without a state is left alone."""
    if not (folder / INFO_FILE).is_file():
        return
    (folder / INFO_FILE).unlink()
    shutil.rmtree(folder / _STRUCT_FOLDER, ignore_errors=True)
    if not any(folder.iterdir()):
        folder.rmdir()


def _identify(job_folder: Path, settings: Settings) -> dict[str, str]:
    """Identity of a state: checksums of the scene's arrays, and each setting of the method."""
    with zipfile.ZipFile(job_folder / SNAPSHOT_FILE) as stored:
        rows = sorted(f"{member.filename} {member.file_size} {member.CRC}" for member in stored.infolist())
    knobs = [knob for knob in dataclasses.fields(settings) if knob.metadata["group"] not in _FREE_GROUPS and knob.name not in _FREE_KNOBS]
    scene = hashlib.sha256("\n".join(rows).encode()).hexdigest()
    return {"scene": scene} | {knob.name: repr(getattr(settings, knob.name)) for knob in knobs}


def _count_bytes(struct: Any) -> int:
    total = 0
    for field in dataclasses.fields(struct):
        value = getattr(struct, field.name)
        total += value.nbytes if isinstance(value, np.ndarray) else _count_bytes(value) if dataclasses.is_dataclass(value) else 0
    return total


def _own_arrays(struct: Any) -> Any:
    """The struct with its arrays copied from mapped files into memory: arrays grow, and the files may be replaced meanwhile."""
    values = {}
    for field in dataclasses.fields(struct):
        value = getattr(struct, field.name)
        if dataclasses.is_dataclass(value):
            values[field.name] = _own_arrays(value)
        else:
            values[field.name] = np.array(value) if isinstance(value, np.ndarray) else value
    return type(struct)(**values)
