from .agents import AgentOrRun as AgentOrRun
from .agents import Name as Name
from .agents import Params as Params
from .agents import Profile as Profile
from .agents import evaluate_agent as evaluate_agent
from .agents import register as register
from .agents import train_agent as train_agent

__all__ = ["AgentOrRun", "Name", "Params", "Profile", "evaluate_agent", "register", "train_agent"]
