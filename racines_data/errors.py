"""One error type for input that is refused."""


class RacinesError(Exception):
    """A refused input: the message names the file or field and the remedy.

    The command line prints it on stderr and exits with 1, without a traceback.
    """
