"""A worker: a process of its own, which runs the tasks that its standard input brings.

    python -m beltscape.workers.worker_process TASKS ENDS

TASKS and ENDS are the blocks of memory in both directions. The first object says where modules are found and holds
the function with what all tasks share; a task follows each time, and its end is sent on what was standard output.
What the function prints goes to the standard error. The process ends with its standard input, hence with the program
that began it, and with nothing else: an interrupt from the keyboard is that program's.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys

from beltscape.core.system_calls import count_usable_cores, open_shared_file
from beltscape.workers.call import call
from beltscape.workers.transport import Block, receive, send


def main() -> None:
    """Run tasks until standard input ends."""
    tasks, ends = (Block(open_shared_file(name)) for name in sys.argv[1:3])
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a print would be read as an object
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        sys.path[:], start = receive(sys.stdin.buffer, tasks, copied=True)
        function, shared = pickle.loads(start)
        _limit_threads()
        while True:
            number, task = receive(sys.stdin.buffer, tasks, copied=False)
            send(output, ends, call(function, shared, number, task))
    except (EOFError, BrokenPipeError):
        os._exit(0)  # nothing waits for what this process still holds


def _limit_threads() -> None:
    """Let OpenCV take no more threads than the kernels."""
    import cv2

    cv2.setNumThreads(count_usable_cores())


if __name__ == "__main__":
    main()
