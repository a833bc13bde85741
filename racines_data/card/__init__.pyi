from .markdown import write_card as write_card
from .rewrite import rewrite_card as rewrite_card

__all__ = ["rewrite_card", "write_card"]
