"""A slow and lossy link between two network namespaces: link.py NAMESPACE NAMESPACE DELAY_MS LOSS SEED [MBIT_S]

Does in user space what `tc netem delay DELAY loss LOSS rate RATE` does in the kernel, which many kernels come without:
each namespace gets a device wm0 (10.99.0.1 and 10.99.0.2), and each packet arrives after the delay, or never. With a
rate, packets wait for those before them in their direction, at most half a second. Prints "ready".
A number of seconds on a line of its standard input is an outage: nothing that comes within them arrives. At its end it
prints how many packets came and how many of them were dropped.
"""

import ctypes
import fcntl
import heapq
import os
import random
import select
import struct
import subprocess
import sys
import time

TUNSETIFF = 0x400454CA
IFF_TUN, IFF_NO_PI = 0x0001, 0x1000
# The most packets in transit: a link of 1 Gbit/s and 50 ms would also drop more.
MOST_WAITING = 4096
# A packet that would wait longer for those before it is dropped.
LONGEST_QUEUE_S = 0.5


def tun(namespace, address):
    # A tun device belongs to the namespace of the thread that opened it; os.setns came with Python 3.12 only.
    with open(f"/run/netns/{namespace}") as file:
        if ctypes.CDLL(None, use_errno=True).setns(file.fileno(), 0) != 0:
            raise OSError(ctypes.get_errno(), f"setns {namespace}")
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH22x", b"wm0", IFF_TUN | IFF_NO_PI))
    for command in (
        ["link", "set", "lo", "up"],
        ["addr", "add", f"{address}/30", "dev", "wm0"],
        ["link", "set", "wm0", "mtu", "1500", "up"],
    ):
        subprocess.run(["ip", *command], check=True)
    return device


def main():
    one, other, delay_ms, loss, seed, *rate = sys.argv[1:]
    delay_s, loss, chance = float(delay_ms) / 1000, float(loss), random.Random(int(seed))
    seconds_per_byte = 8e-6 / float(rate[0]) if rate else 0.0
    free_at = [0.0, 0.0]
    devices = [tun(one, "10.99.0.1"), tun(other, "10.99.0.2")]
    waiting, count, dropped = [], 0, 0
    back_at = 0.0
    print("ready", flush=True)
    while True:
        timeout = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        readable, _, _ = select.select([*devices, sys.stdin], [], [], timeout)
        now = time.monotonic()
        while waiting and waiting[0][0] <= now:
            _, _, to, packet = heapq.heappop(waiting)
            try:
                os.write(to, packet)
            except BlockingIOError:
                dropped += 1
        if sys.stdin in readable:
            outage_s = sys.stdin.readline()
            if not outage_s:
                break
            back_at = now + float(outage_s)
        for device in devices:
            if device not in readable:
                continue
            packet = os.read(device, 65536)
            count += 1
            index = devices.index(device)
            queue_s = max(0.0, free_at[index] - now)
            is_lost = chance.random() < loss or now < back_at
            if is_lost or len(waiting) >= MOST_WAITING or queue_s > LONGEST_QUEUE_S:
                dropped += 1
            else:
                free_at[index] = now + queue_s + len(packet) * seconds_per_byte
                heapq.heappush(waiting, (free_at[index] + delay_s, count, devices[1 - index], packet))
    print(f"{count} {dropped}", flush=True)


main()
