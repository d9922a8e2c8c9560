#!/usr/bin/env python3
"""Loss, latency and memory of a stream between two processes, over DDS and over Zenoh by turns.

    cargo build --release -p wm_ros --features zenoh --example stream
    cargo build --release -p wm_cli --features zenoh
    benches/middlewares.py [--rounds 3]

Needs root: each run is in a network namespace of its own, with loopback only, or in two that a shaped link connects,
with a router in each. Prints a table in Markdown, and the machine.
"""

import argparse
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STREAM = ROOT / "target/release/examples/stream"
WM = ROOT / "target/release/wm"
DOMAIN = "33"
MIDDLEWARES = {"DDS": "rmw_fastrtps_cpp", "Zenoh": "rmw_zenoh_cpp"}
SHARED_MEMORY = {"ZENOH_CONFIG_OVERRIDE": "transport/shared_memory/enabled=true"}
# two namespaces of one kernel would share memory too
NO_SHARED_MEMORY = {"ZENOH_CONFIG_OVERRIDE": "transport/shared_memory/enabled=false"}

# name, bytes, Hz, samples, QoS
STREAMS = [
    ("latent 48 KiB", 48 << 10, 5, 50, "best_effort"),
    ("latent 48 KiB", 48 << 10, 40, 400, "best_effort"),
    ("latent 512 KiB", 512 << 10, 5, 50, "best_effort"),
    ("latent 512 KiB", 512 << 10, 40, 400, "best_effort"),
    ("latent 512 KiB", 512 << 10, 40, 400, "reliable"),
    ("raw VGA 900 KiB", 640 * 480 * 3, 30, 300, "best_effort"),
]

# links between two hosts: delay in ms, part of lost packets, Mbit/s
SLOW = (20, 0.0, 8)
LOSSY = (5, 0.01, 40)
FAST = (1, 0.0, 100)
LINK = ROOT / "nodes/bridge/tests/processes/link.py"

# name, link, bytes, Hz, samples, QoS
BETWEEN_HOSTS = [
    ("48 KiB over 8 Mbit/s", SLOW, 48 << 10, 5, 50, "best_effort"),
    ("48 KiB over 8 Mbit/s", SLOW, 48 << 10, 5, 50, "reliable"),
    ("48 KiB, one packet of 100 lost", LOSSY, 48 << 10, 10, 100, "best_effort"),
    ("48 KiB, one packet of 100 lost", LOSSY, 48 << 10, 10, 100, "reliable"),
    ("512 KiB over 100 Mbit/s", FAST, 512 << 10, 10, 100, "best_effort"),
    ("512 KiB over 100 Mbit/s", FAST, 512 << 10, 10, 100, "reliable"),
]


def run(*words):
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


class Host:
    """A network namespace, with a router where the middleware is Zenoh."""

    def __init__(self, name, middleware, extra=None):
        self.name, self.processes = name, []
        run("ip", "netns", "add", name)
        run("ip", "-n", name, "link", "set", "lo", "up")
        own = {"RMW_IMPLEMENTATION": MIDDLEWARES[middleware], "ROS_DOMAIN_ID": DOMAIN}
        self.environment = {**os.environ, **own, **NO_SHARED_MEMORY, **(extra or {})}
        self.router = None
        self.middleware = middleware

    def start_router(self, *words, keys=None):
        self.router = self.start(str(WM), "zenoh-router", *words, keys=keys)
        time.sleep(1)

    def start(self, *words, keys=None):
        """Starts a program, with this file of `wm keys`."""
        variable = "ZENOH_ROUTER_CONFIG_URI" if "zenoh-router" in words else "ZENOH_SESSION_CONFIG_URI"
        process = subprocess.Popen(
            ["ip", "netns", "exec", self.name, *words],
            env={**self.environment, **({variable: keys} if keys else {})},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.processes.append(process)
        return process

    def close(self):
        for process in self.processes:
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.kill()
        run("ip", "netns", "del", self.name)


def result(process):
    out, _ = process.communicate(timeout=120)
    lines = [line for line in out.splitlines() if line.startswith("{")]
    return json.loads(lines[-1]) if lines else None


def stream(middleware, size, rate, count, qos, extra=None, keys=None):
    """With a folder `keys`, every message passes the router, encrypted: the files of `wm keys`."""

    def of(name):
        return keys and f"{keys}/{name}.json5"

    host = Host(f"wmbench{os.getpid()}", middleware, extra)
    try:
        if middleware == "Zenoh":
            host.start_router(keys=of("router"))
        receiver = host.start(str(STREAM), "receive", "6", qos, keys=of("receive"))
        time.sleep(0.5)
        sender = host.start(str(STREAM), "send", str(size), str(rate), str(count), qos, "2", keys=of("send"))
        return result(sender), result(receiver)
    finally:
        host.close()


def stopped_reader(middleware):
    """Two readers, one of them stopped for the whole stream: what the other receives, and what the publisher needs."""
    host = Host(f"wmbench{os.getpid()}", middleware)
    try:
        if middleware == "Zenoh":
            host.start_router()
        receiver = host.start(str(STREAM), "receive", "6", "reliable")
        stopped = host.start(str(STREAM), "receive", "6", "reliable")
        time.sleep(1)
        sender = host.start(str(STREAM), "send", str(512 << 10), "40", "800", "reliable", "1")
        time.sleep(3)
        stopped.send_signal(signal.SIGSTOP)
        return result(sender), result(receiver)
    finally:
        host.close()


def killed_router():
    """The router is killed a second after the start of a stream of ten."""
    host = Host(f"wmbench{os.getpid()}", "Zenoh")
    try:
        host.start_router()
        receiver = host.start(str(STREAM), "receive", "6", "reliable")
        time.sleep(0.5)
        sender = host.start(str(STREAM), "send", str(48 << 10), "40", "400", "reliable", "1")
        time.sleep(3)
        host.router.kill()
        return result(sender), result(receiver)
    finally:
        host.close()


def across(middleware, link, sent, received, pause=0.0):
    """Two hosts with a link of these properties in each direction. The receiver starts `pause` after the sender,
    or just before it."""
    name = f"wmbench{os.getpid()}"
    here, there = (
        Host(name + end, middleware, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": peer})
        for end, peer in [("a", "10.99.0.2"), ("b", "10.99.0.1")]
    )
    delay_ms, loss, rate = link
    words = [sys.executable, LINK, here.name, there.name, delay_ms, loss, 7, rate]
    shaped = subprocess.Popen([str(word) for word in words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert shaped.stdout.readline() == "ready\n", "the link did not start"
        if middleware == "Zenoh":
            here.start_router("--listen", "tcp/0.0.0.0:7447")
            there.start_router("--connect", "tcp/10.99.0.1:7447")
        receiver = None if pause else there.start(str(STREAM), "receive", *received)
        sender = here.start(str(STREAM), "send", *sent)
        time.sleep(pause)
        receiver = receiver or there.start(str(STREAM), "receive", *received)
        return result(sender), result(receiver)
    finally:
        shaped.stdin.close()
        shaped.wait()
        here.close()
        there.close()


def late_joiner(middleware):
    """A latched sample of 48 KiB for a subscription that joins 3 s later."""
    sent = [str(48 << 10), "5", "1", "latched", "12"]
    return across(middleware, SLOW, sent, ["5", "latched"], pause=3)


def row(name, middleware, round_, outcome):
    sent, received = outcome
    if not sent or not received:
        print(f"| {name} | {middleware} | {round_} | no result | | | | | | |")
        return
    p50, p95, p99, _ = received["latency_ms"]
    call = sent["call_ms"]
    first = received["first_ms"]
    print(
        f"| {name} | {middleware} | {round_} | {received['received']} of {sent['sent']} | {p50} | {p95} | {p99} | "
        f"{call[2]} / {call[3]} | {sent['resident_kib'] >> 10} / {received['resident_kib'] >> 10} | {first} |",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", choices=["host", "hosts"], help="streams on one host, or between two")
    arguments = parser.parse_args()
    rounds, only = arguments.rounds, arguments.only
    for program in (STREAM, WM):
        if not program.exists():
            sys.exit(f"{program} is missing; see --help for how to build it")
    model = next((line.split(":", 1)[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), "?")
    print(f"{model}, {os.cpu_count()} cores, Linux {platform.release()}, {time.strftime('%Y-%m-%d')}\n")
    print("| stream | middleware | round | received | p50 ms | p95 ms | p99 ms | publish p99 / max ms | memory sender / receiver MiB | first sample ms |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for round_ in range(1, rounds + 1):
        if only != "hosts":
            on_one_host(round_)
        if only != "host":
            between_hosts(round_)


def on_one_host(round_):
    for name, size, rate, count, qos in STREAMS:
        label = f"{name}, {rate} Hz, {qos.replace('_', ' ')}"
        for middleware in MIDDLEWARES:
            row(label, middleware, round_, stream(middleware, size, rate, count, qos))
        with tempfile.TemporaryDirectory() as folder:
            keys = f"{folder}/keys"
            grants = ["--node", "/send=publish:/stream", "--node", "/receive=subscribe:/stream"]
            run(str(WM), "keys", keys, "--only", "encoder", "--domain", DOMAIN, *grants)
            row(label, "Zenoh, wm keys", round_, stream("Zenoh", size, rate, count, qos, keys=keys))
        if size > 500_000:
            row(label, "Zenoh, shared memory", round_, stream("Zenoh", size, rate, count, qos, SHARED_MEMORY))
    for middleware in MIDDLEWARES:
        row("512 KiB, 40 Hz, reliable, another reader stopped", middleware, round_, stopped_reader(middleware))
    row("48 KiB, 40 Hz, reliable, router killed", "Zenoh", round_, killed_router())


def between_hosts(round_):
    for name, link, size, rate, count, qos in BETWEEN_HOSTS:
        label = f"two hosts: {name}, {rate} Hz, {qos.replace('_', ' ')}"
        for middleware in MIDDLEWARES:
            sent = [str(size), str(rate), str(count), qos, "3"]
            row(label, middleware, round_, across(middleware, link, sent, ["6", qos]))
    for middleware in MIDDLEWARES:
        row("two hosts: latched 48 KiB, late joiner over 8 Mbit/s", middleware, round_, late_joiner(middleware))


if __name__ == "__main__":
    main()
