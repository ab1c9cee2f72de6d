"""Ready-made scenes with parameters, one file each."""

from jaxsph.scenes.beam import cantilever, turek_hron_beam
from jaxsph.scenes.cavity import lid_driven_cavity
from jaxsph.scenes.channel import couette, poiseuille
from jaxsph.scenes.elastic_gate import elastic_gate
from jaxsph.scenes.falling import falling_column_on_beam, falling_rigid_spheres, falling_spheres
from jaxsph.scenes.free_flow import oscillating_drop, rings, rotating_square
from jaxsph.scenes.moving import dam_break_gate, falling_column, moving_wall, standing_wave
from jaxsph.scenes.plates import dam_break_gate_plate, dam_break_plate, water_column_on_plate
from jaxsph.scenes.tank_flow import column_in_tank, dam_break, still_water
from jaxsph.scenes.taylor_green import taylor_green

__all__ = [
    "cantilever",
    "column_in_tank",
    "couette",
    "dam_break",
    "dam_break_gate",
    "dam_break_gate_plate",
    "dam_break_plate",
    "elastic_gate",
    "falling_column",
    "falling_column_on_beam",
    "falling_rigid_spheres",
    "falling_spheres",
    "lid_driven_cavity",
    "moving_wall",
    "oscillating_drop",
    "poiseuille",
    "rings",
    "rotating_square",
    "standing_wave",
    "still_water",
    "taylor_green",
    "turek_hron_beam",
    "water_column_on_plate",
]
