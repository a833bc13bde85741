from .draws import draw_in_secret as draw_in_secret
from .flags import flags_of as flags_of
from .rounds import Secret as Secret
from .rounds import commit as commit
from .rounds import read_secret as read_secret
from .rounds import reveal as reveal

__all__ = ["Secret", "commit", "draw_in_secret", "flags_of", "read_secret", "reveal"]
