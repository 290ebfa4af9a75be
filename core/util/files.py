"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


def save_whole(file: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write an .npz that takes the place of another only when it is whole.

    Raises OSError where that cannot be written.
    """
    unfinished = file.with_name(f"{file.name}.part")
    try:
        with open(unfinished, "wb") as out:
            np.savez(out, **arrays)
        os.replace(unfinished, file)
    finally:
        unfinished.unlink(missing_ok=True)
