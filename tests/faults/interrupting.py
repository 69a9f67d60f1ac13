"""`python -m tests.faults.interrupting SIGNAL MOMENT DELAY FOLDER WORD…`: a command that gets a signal while it works.

SIGNAL: its number, or 0 for none. MOMENT: after which of the operations of the command in or below FOLDER, counted from
1, or 0 for its begin. DELAY: seconds from there. As Ctrl-C on a terminal, SIGINT goes to all processes of the group. A
line on stdout says when the signal is sent; the last one says how many operations there were.
"""

import os
import signal
import sys
import threading

from nte.cli import main

OPERATIONS = ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.scandir")
SENT = "the signal is sent"


def run(number: int, moment: int, delay: float, folder: str, words: list[str]) -> int:
    """Run the command, and return its exit status."""
    done = 0

    def send() -> None:
        os.write(1, f"{SENT}\n".encode())
        if number == signal.SIGINT:
            os.killpg(0, number)
        else:
            os.kill(os.getpid(), number)

    def begin() -> None:
        timer = threading.Timer(delay, send)
        timer.daemon = True  # a command that ends earlier waits for nobody
        timer.start()

    def audit(event: str, details: tuple[object, ...]) -> None:
        nonlocal done
        if event in OPERATIONS and isinstance(details[0], str | bytes | os.PathLike):
            done += (here := os.fsdecode(details[0]).startswith(folder))
            if number and here and done == moment:
                begin()

    sys.addaudithook(audit)
    if number and not moment:
        begin()
    sys.argv[1:] = words
    status = main()
    print("operations", done)
    return status


if __name__ == "__main__":
    sys.exit(run(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4], sys.argv[5:]))
