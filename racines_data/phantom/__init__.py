"""A simulated cardiac block: anatomy, contact, acoustics, and the oracle that knows the truth."""

from racines_data.phantom.config import PHANTOM_VERSION, PhantomConfig
from racines_data.phantom.model import Phantom, shared_phantom
from racines_data.world import Truth, Workspace

__all__ = ["PHANTOM_VERSION", "Phantom", "PhantomConfig", "Truth", "Workspace", "shared_phantom"]
