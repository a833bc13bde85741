from .gym_env import GymScanEnv as GymScanEnv
from .gym_env import VectorScanEnv as VectorScanEnv
from .torchrl_env import ScanEnv as ScanEnv

__all__ = ["GymScanEnv", "ScanEnv", "VectorScanEnv"]
