"""A simulated cardiac block: anatomy, contact, acoustics, and the oracle that knows the truth."""

from racines_data.phantom.config import PHANTOM_VERSION, PhantomConfig
from racines_data.phantom.model import Phantom, Workspace, shared_phantom
from racines_data.phantom.truth import Truth

__all__ = [
    "PHANTOM_VERSION",
    "Phantom",
    "PhantomConfig",
    "Truth",
    "Workspace",
    "shared_phantom",
]
