"""What a child might do that has been taken over; each would be `done` by a process left free."""

FILES = {
    "reopen after close": "os.close(2); os.open(victim, os.O_RDONLY)",
    "read /etc": "open('/etc/passwd').read()",
    "read the repository": "open(repository + '/pyproject.toml').read()",
    "read its own code": "open(child.__file__).read()",
    "write outside": "os.open(folder + '/owned', os.O_CREAT | os.O_WRONLY)",
    "overwrite": "os.open(victim, os.O_WRONLY)",
    "truncate": "os.truncate(victim, 0)",
    "unlink": "os.unlink(victim)",
    "rename": "os.rename(victim, folder + '/moved')",
    "hard link": "os.link(victim, folder + '/link')",
    "symbolic link": "os.symlink('/etc/passwd', folder + '/link')",
    "read through a link": "open(folder + '/to-etc').read()",
    "chmod": "os.chmod(victim, 0o777)",
    "chdir": "os.chdir(folder)",
    "mkdir": "os.mkdir(folder + '/new')",
    "rmdir": "os.rmdir(folder + '/empty')",
    "fifo": "os.mkfifo(folder + '/fifo')",
    "date of a file": "os.utime(victim)",
    "list a folder": "os.listdir(folder)",
    "size of a file": "os.stat(victim)",
    "openat2": "call(437, -100, victim.encode(), ctypes.create_string_buffer(24), 24)",
}
"""`folder` is anybody's to write to, `victim` a file there, `to-etc` a link."""

PROC = {
    "its wire again": "os.open('/proc/self/fd/0', os.O_RDONLY)",
    "its own memory": "os.open('/proc/self/mem', os.O_RDWR)",
    "its own program": "os.readlink('/proc/self/exe')",
    "its command line": "open('/proc/self/cmdline').read()",
    "the root through /proc": "open('/proc/self/root/etc/passwd').read()",
    "the parent's environment": "open(f'/proc/{parent}/environ').read()",
    "the parent's descriptors": "os.listdir(f'/proc/{parent}/fd')",
}

PROCESSES = {
    "fork": "os.fork() or os._exit(0)",
    "vfork and exec": "os.posix_spawn('/bin/true', ['true'], {})",
    "exec": "os.execv('/bin/echo', ['echo', '-n', 'done'])",
    "execveat": "call((322, 281), -100, b'/bin/echo', "
    "(ctypes.c_char_p * 4)(b'echo', b'-n', b'done', None), (ctypes.c_char_p * 1)(None), 0)",
    "thread": "threading.Thread(target=int).start()",
    "signal the parent": "os.kill(parent, 0)",
    "signal a group": "os.killpg(group, 0)",
    "signal everyone": "os.kill(-1, 0) if doors else None",
    "signal a thread of the parent": "call((234, 131), parent, parent, 0)",
    "pidfd of the parent": "call(434, parent, 0)",
    "limits of the parent": "resource.prlimit(parent, resource.RLIMIT_NOFILE)",
    "own processors": "os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])",
}

SOCKETS = {
    "TCP": "socket.socket(socket.AF_INET, socket.SOCK_STREAM)",
    "UDP": "socket.socket(socket.AF_INET, socket.SOCK_DGRAM)",
    "UNIX socket": "socket.socket(socket.AF_UNIX)",
    "netlink": "socket.socket(socket.AF_NETLINK, socket.SOCK_RAW)",
    "pair of sockets": "socket.socketpair()",
}

DESCRIPTORS = {
    "pipe": "os.pipe()",
    "copy of a descriptor": "os.dup(1)",
    "copy onto a descriptor": "os.dup2(1, 2)",
    "size of its pipe": "fcntl.fcntl(1, 1031, 4096)",
    "ioctl of its pipe": "fcntl.ioctl(1, 0x541B, bytearray(4))",
    "file in memory": "os.memfd_create('x')",
    "eventfd": "os.eventfd(0)",
    "epoll": "select.epoll()",
    "inotify": "done(libc.inotify_init())",
}

MEMORY = {
    "System V shared memory": "shm = done(libc.shmget(0, 4096, 0o1600)); libc.shmctl(shm, 0, None)",
    "System V queue": "queue = done(libc.msgget(0, 0o1600)); libc.msgctl(queue, 0, None)",
    "executable memory": "mmap.mmap(-1, 4096, prot=7)",
    "memory made executable": "page = mmap.mmap(-1, 4096); done(libc.mprotect("
    "ctypes.c_void_p(ctypes.addressof(ctypes.c_char.from_buffer(page))), 4096, 5))",
}

UNDOING = {
    "filter that lets all through": "done(libc.prctl(38, ctypes.c_ulong(1), 0, 0, 0)); "
    "steps = ctypes.create_string_buffer(struct.pack('<HBBI', 6, 0, 0, 0x7fff0000), 8); "
    "call((317, 277), 1, 0, struct.pack('@HP', 1, ctypes.addressof(steps)))",
    "outlive the parent": "done(libc.prctl(1, ctypes.c_ulong(0), 0, 0, 0))",
    "be looked into": "done(libc.prctl(4, ctypes.c_ulong(1), 0, 0, 0))",
    "more of the CPU": "soft, hard = resource.getrlimit(resource.RLIMIT_CPU); "
    "resource.setrlimit(resource.RLIMIT_CPU, (hard, hard))",
    "not heed the limit": "signal.signal(signal.SIGXCPU, signal.SIG_IGN)",
    "hold the signal back": "signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGXCPU])",
    "other user": "os.setuid(os.getuid() if not doors else 0)",
    "look around": "os.uname()",
}

PRIVILEGED = {
    "open_tree": "call(428, -100, b'/', 0)",
    "handle of a file": "call((303, 264), -100, victim.encode(), "
    "ctypes.create_string_buffer(struct.pack('Ii', 128, 0), 136), (ctypes.c_int * 1)(), 0)",
    "the parent's memory": "os.open(f'/proc/{parent}/mem', os.O_RDWR)",
    "clone3": "call(435, ctypes.create_string_buffer(struct.pack('QQQQQQQQ', 0, 0, 0, 0, "
    "signal.SIGCHLD, 0, 0, 0), 64), 64) or os._exit(0)",
    "memory of a process": "here = ctypes.create_string_buffer(8); "
    "part = struct.pack('PL', ctypes.addressof(here), 8); "
    "call((310, 270), os.getpid(), part, 1, part, 1, 0)",
    "other personality": "done(libc.personality(0x0400000))",
    "a terminal": "os.open('/dev/tty', os.O_RDWR)",
    "ptrace the parent": "done(libc.ptrace(0x4206, parent, None, None))",
    "be traced": "done(libc.ptrace(0, 0, None, None))",
    "new namespaces": "done(libc.unshare(0x10000000 | 0x20000))",
    "namespace of the parent": "call((308, 268), 2, 0x20000)",
    "mount": "done(libc.mount(b'none', folder.encode(), b'nosuchfs', 0, None))",
    "new mount interface": "call(430, b'tmpfs', 0)",
    "chroot": "os.chroot(folder)",
    "device": "os.mknod(folder + '/null', 0o20666, os.makedev(1, 3))",
    "raw socket": "socket.socket(socket.AF_PACKET, socket.SOCK_RAW)",
    "more memory": "resource.setrlimit(resource.RLIMIT_AS, (-1, -1))",
    "more files": "resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))",
    "capabilities": "call((126, 91), struct.pack('<Ii', 0x20080522, 0), bytes([255] * 24))",
    "io_uring": "call(425, 1, ctypes.create_string_buffer(120))",
    "asynchronous io": "call((206, 0), 1, (ctypes.c_long * 1)())",
    "BPF": "call((321, 280), 0, ctypes.create_string_buffer(128), 128)",
    "performance events": "call((298, 241), ctypes.create_string_buffer(128), 0, -1, -1, 0)",
    "userfaultfd": "call((323, 282), 0)",
    "keyring": "call((248, 217), b'user', b'x', b'y', 1, -2)",
    "compare processes": "call((312, 272), parent, parent, 0, 0, 0)",
    "secret memory": "call(447, 0)",
    "another ruleset": "call(444, None, 0, 1)",
}
"""What a machine or a container may forbid a free process as well."""

FREE = FILES | PROC | PROCESSES | SOCKETS | DESCRIPTORS | MEMORY | UNDOING
ALL = FREE | PRIVILEGED
