from .regressor import PoseAugmentation as PoseAugmentation
from .regressor import PoseConfig as PoseConfig
from .regressor import PoseNetwork as PoseNetwork
from .regressor import PoseRegressor as PoseRegressor
from .regressor import PoseTraining as PoseTraining

__all__ = ["PoseAugmentation", "PoseConfig", "PoseNetwork", "PoseRegressor", "PoseTraining"]
