"""Trajectories and restart states in one HDF5 file that ParaView opens as it is.

The file holds two groups. `/VTKHDF` is a temporal PolyData with one vertex cell per particle; `/jaxsph` says
what the numbers are (units, versions, parameters of the scene) and keeps the last state bit for bit.
"""

from jaxsph.files.check import FORMAT_VERSION
from jaxsph.files.reader import read_trajectory
from jaxsph.files.restart import fingerprint, read_state
from jaxsph.files.run import RunWriter
from jaxsph.files.units import UNITS, parameters
from jaxsph.files.writer import TrajectoryWriter

__all__ = [
    "FORMAT_VERSION",
    "UNITS",
    "RunWriter",
    "TrajectoryWriter",
    "fingerprint",
    "parameters",
    "read_state",
    "read_trajectory",
]
