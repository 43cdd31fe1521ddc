"""`stylerf` on a machine that has another work folder than the first: the second process of two looks elsewhere."""

import os
import sys

from stylerf_cli.main import main

if __name__ == "__main__":
    argv = sys.argv[1:]
    if os.environ["RANK"] == "1":
        argv[1] = os.environ["STYLERF_TEST_ELSEWHERE"]
    sys.exit(main(argv))
