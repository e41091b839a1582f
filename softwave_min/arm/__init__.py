"""The arm: kinematics, dynamics and hydrodynamics, one definition each."""

from softwave_min.arm.mechanics import LOAD_TERMS, Mechanics, Section, Structure, Values, mechanics
from softwave_min.arm.model import Arm, pack_flow

__all__ = [
    "LOAD_TERMS",
    "Arm",
    "Mechanics",
    "Section",
    "Structure",
    "Values",
    "mechanics",
    "pack_flow",
]
