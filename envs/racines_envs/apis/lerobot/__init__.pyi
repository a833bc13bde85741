from .env import LeRobotEnv as LeRobotEnv
from .env import make_env as make_env
from .envhub import write_envhub as write_envhub
from .formats import features_of as features_of

__all__ = ["LeRobotEnv", "features_of", "make_env", "write_envhub"]
