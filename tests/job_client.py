#!/usr/bin/env -S python3 -I -S
"""Stands in for `stylerf`: the server at $JOB_SERVER runs the command (tests/job_server.py)."""

import json
import os
import signal
import socket
import sys


def _pass_on(child: int) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: os.kill(child, received))


with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as server:
    server.connect(os.environ["JOB_SERVER"])
    order = {"argv": sys.argv[1:], "folder": os.getcwd()}
    socket.send_fds(server, [json.dumps(order).encode()], [0, 1, 2])
    _pass_on(int(server.recv(100)))
    code = int(server.recv(100))
if code < 0:
    signal.signal(-code, signal.SIG_DFL) if -code not in (signal.SIGKILL, signal.SIGSTOP) else None
    os.kill(os.getpid(), -code)
sys.exit(code)
