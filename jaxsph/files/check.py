"""Opening a file, and the sentences for one that is not what it should be."""

from __future__ import annotations

import os
import re
from pathlib import Path

import h5py

from jaxsph.files import hdf5

FORMAT_VERSION = 1
"""Version of the `/jaxsph` group; it changes when an older reader would misread the file."""


def open_for_reading(path: str | os.PathLike[str]) -> h5py.File:
    """Open a trajectory file, raising errors that say what was found and what to do.

    Raises:
        FileNotFoundError: nothing at `path`.
        ValueError: not an HDF5 file, cut short, without the groups of a trajectory, or of another format
            version.

    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; expected a trajectory written by jaxsph (*.vtkhdf)")
    size = path.stat().st_size
    if not h5py.is_hdf5(path):
        raise ValueError(
            f"{path}: not an HDF5 file ({size} bytes, no HDF5 signature); expected a trajectory written by "
            "jaxsph: give the path of the .vtkhdf file that simulate(..., out=...) wrote"
        )
    try:
        # without a lock a run that is still writing can be read too: its metadata never changes (see writer)
        file = h5py.File(path, "r", locking=False)
    except OSError as error:
        promised = re.search(r"stored_eof = (\d+)", str(error))
        if "truncated" in str(error) and promised:
            raise ValueError(
                f"{path}: the file is cut short, it has {size} bytes of the {promised[1]} that its header "
                "states; copy it again from where it was written, or run the simulation again"
            ) from error
        raise ValueError(f"{path}: HDF5 cannot open it ({error}); copy the file again or run again") from error
    try:
        _check_groups(path, file)
    except ValueError:
        file.close()
        raise
    return file


def _check_groups(path: Path, file: h5py.File) -> None:
    found = ", ".join(sorted(file)) or "no group at all"
    for group in ("jaxsph", "VTKHDF", "VTKHDF/Steps", "VTKHDF/PointData"):
        if group not in file:
            raise ValueError(
                f"{path}: group /{group} is missing (found at the top: {found}); expected a trajectory "
                "written by jaxsph: other VTKHDF files open in ParaView, not here"
            )
    version = int(hdf5.attribute(file, "jaxsph", "format_version"))
    if version != FORMAT_VERSION:
        by = file["jaxsph"].attrs.get("jaxsph_version", "an unknown version")
        raise ValueError(
            f"{path}: format version {version} (written by jaxsph {by}), this jaxsph reads format version "
            f"{FORMAT_VERSION}: use the jaxsph that wrote it, or write the file again with this one"
        )
