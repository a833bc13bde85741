from .document import check_file as check_file
from .document import check_measured as check_measured
from .document import find_submission as find_submission
from .document import read_document as read_document
from .document import read_submission as read_submission

__all__ = ["check_file", "check_measured", "find_submission", "read_document", "read_submission"]
