from .session import Child as Child
from .session import ConfinedSession as ConfinedSession
from .session import Limits as Limits
from .session import rehearse as rehearse

__all__ = ["Child", "ConfinedSession", "Limits", "rehearse"]
