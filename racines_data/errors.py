"""One error type for input that is refused, and what the system refuses told in the same way."""

import errno
import os


class RacinesError(Exception):
    """A refused input: the message names the file or field and the remedy.

    The command line prints it on stderr and exits with 1, without a traceback.
    """


_REMEDIES = {
    errno.EACCES: "permission denied: change who may read or write it, or name another place",
    errno.EPERM: "not permitted: change who may read or write it, or name another place",
    errno.EROFS: "a read-only file system: name another place",
    errno.ENOSPC: "no space left on the device: free some, or name another place",
    errno.EDQUOT: "the quota of the disk is used up: free some, or name another place",
    errno.EFBIG: "the file grows too large for this file system: name another place",
    errno.ENOENT: "no such file or folder: check the name",
    errno.EISDIR: "a folder: name a file",
    errno.ENOTDIR: "a file stands where a folder is needed: name another place",
    errno.EEXIST: "is there already: remove it, or name another place",
    errno.ENOTEMPTY: "a folder that is not empty: empty it, or name another place",
    errno.ELOOP: "links that lead in a circle: name the file itself",
    errno.ENAMETOOLONG: "the name is too long: give a shorter one",
    errno.EMFILE: "too many open files: raise the limit (ulimit -n)",
    errno.ENFILE: "too many open files on this machine: close some programs",
    errno.ENOMEM: "no memory left: close other programs, or take fewer --workers",
    errno.EBUSY: "in use: wait, or end what uses it",
    errno.ETXTBSY: "in use: wait, or end what uses it",
    errno.EIO: "the device failed to read or write: check the disk, or name another place",
    errno.ESTALE: "the network folder was lost: mount it again",
}


_KINDS = {
    FileNotFoundError: errno.ENOENT,
    FileExistsError: errno.EEXIST,
    IsADirectoryError: errno.EISDIR,
    NotADirectoryError: errno.ENOTDIR,
    PermissionError: errno.EACCES,
}
_MOST = 300
"""Characters of what a library says."""


def describe_os_error(error: OSError) -> str:
    """Return what the system refused as one line: the path, what is wrong, what to do about it."""
    number = error.errno or _KINDS.get(type(error), 0)
    named = [each for each in (error.filename, error.filename2) if isinstance(each, str | bytes)]
    path = " to ".join(map(os.fsdecode, named))
    remedy = _REMEDIES.get(number, "check the paths that were given, the disk and the connection")
    if number in (errno.ENOENT, errno.EEXIST) and named and os.path.islink(named[0]):
        remedy = "a link to nothing: make what it points to, or name the file itself"
    elif number == errno.EEXIST and named and os.path.isfile(named[0]):
        number = errno.ENOTDIR  # a folder was to be made there
        remedy = _REMEDIES[number]
    if path and number in _REMEDIES:
        return f"{path}: {remedy}"
    # Libraries tell the path in words, if at all.
    told = " ".join(str(error).split())[:_MOST] or type(error).__name__
    return f"{told}: {remedy}"
