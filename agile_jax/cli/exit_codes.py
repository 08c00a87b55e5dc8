"""What the `agile` command returns."""

DONE = 0
FAILED = 1  # finished, with failures that are named
BAD_INPUT = 2  # nothing was done
INTERRUPTED = 130  # by SIGINT
TERMINATED = 143  # by SIGTERM
