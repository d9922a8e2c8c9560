"""Presses keys in the terminal of a program that plays a bag, and queries the effects by its services; prints JSON.

usage: keys.py --seconds LIMIT NODE PROGRAM [ARGUMENT ...]

The answer: whether the playback was paused, and its rate, before and after each key; how the program ended after
Ctrl-C; and whether the terminal is then as it was.
"""

import argparse
import contextlib
import json
import os
import pty
import re
import subprocess
import sys
import termios
import threading
import time

import rclpy
from rosbag2_interfaces.srv import GetRate, IsPaused

KEYS = {"": b"", "space": b" ", "up": b"\x1b[A", "down": b"\x1b[B", "x": b"x", "space again": b" "}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("node")
    parser.add_argument("program", nargs=argparse.REMAINDER)
    arguments = parser.parse_args()

    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    # a shell owns the terminal: the kernel resets a terminal whose owner ends, which would hide a fault
    shell = ["sh", "-c", 'trap : INT; "$@"; echo "ended with $?"; read _', "sh", *arguments.program]
    owner = subprocess.Popen(shell, preexec_fn=lambda: os.login_tty(os.dup(theirs)))
    shown = bytearray()

    def read():
        with contextlib.suppress(OSError):  # the terminal is gone
            while True:
                shown.extend(os.read(ours, 4096))

    # the output has to be read, or the writer blocks
    threading.Thread(target=read, daemon=True).start()

    rclpy.init()
    node = rclpy.create_node("keys")

    def call(name, service):
        client = node.create_client(service, f"{arguments.node}/{name}")
        if not client.wait_for_service(arguments.seconds):
            sys.exit(f"no service {client.srv_name} within {arguments.seconds} s")
        future = client.call_async(service.Request())
        rclpy.spin_until_future_complete(node, future, timeout_sec=arguments.seconds)
        node.destroy_client(client)
        return future.result()

    call("is_paused", IsPaused)
    time.sleep(1.0)  # the keyboard is listened to shortly after the services are there
    states = []
    state = None
    for key, code in KEYS.items():
        os.write(ours, code)
        before_key, end = state, time.monotonic() + (0.5 if key == "x" else 10.0)
        while state == before_key and time.monotonic() < end:
            time.sleep(0.05)
            state = [call("is_paused", IsPaused).paused, call("get_rate", GetRate).rate]
        states.append([key, *state])
    changed = termios.tcgetattr(theirs) != before
    os.write(ours, b"\x03")
    end = time.monotonic() + arguments.seconds
    while (code := re.search(rb"ended with (\d+)", shown)) is None:
        if time.monotonic() > end:
            sys.exit(f"the program did not end; it said {shown.decode()}")
        time.sleep(0.05)
    restored = termios.tcgetattr(theirs) == before
    os.write(ours, b"\n")
    owner.wait(arguments.seconds)
    json.dump({"states": states, "changed": changed, "code": int(code[1]), "restored": restored}, sys.stdout)
    print(flush=True)
    node.destroy_node()
    rclpy.shutdown()


main()
