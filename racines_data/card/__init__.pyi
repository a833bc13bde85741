from .markdown import LICENSES as LICENSES
from .markdown import TAGS as TAGS
from .markdown import write_card as write_card
from .rewrite import rewrite_card as rewrite_card

__all__ = ["LICENSES", "TAGS", "rewrite_card", "write_card"]
