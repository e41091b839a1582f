"""The arm: kinematics, dynamics and hydrodynamics, one definition each."""

from softwave_min.arm.mechanics import LOAD_TERMS, Mechanics, Structure, Values, mechanics
from softwave_min.arm.model import Arm, pack_flow

__all__ = ["LOAD_TERMS", "Arm", "Mechanics", "Structure", "Values", "mechanics", "pack_flow"]
