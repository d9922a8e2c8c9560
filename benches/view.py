#!/usr/bin/env python3
"""The page of `wm view` in a real browser, beside the main job: the time to its first picture, the age of its pictures when
they are drawn, and the cost of the viewer.

usage: benches/view.py [--runs N] [--domain D] [--wm PATH] [--browser NAME]

Prints a Markdown table: from opening the page to the first picture; from a frame's capture until it is drawn on the page's
canvas (p50/p95/p99; the screen itself adds up to a frame); CPU and memory of the viewer without and with a client. Needs
`cargo build --release`, Linux's /proc and chromium-headless-shell.
"""

import argparse
import contextlib
import datetime
import json
import os
import pathlib
import signal
import subprocess
import tempfile
import time

from machine import processor
from replay import children, free_port, usage

ROOT = pathlib.Path(__file__).resolve().parent.parent
# Seconds of the main job that are measured without a client, and then with one.
ALONE, WATCHED = 5, 15


class Browser:
    """A browser with one page, driven over the DevTools protocol by a pair of pipes."""

    def __init__(self, name, url, folder):
        commands, self.commands = os.pipe()
        self.answers, answers = os.pipe()

        def as_the_browser_expects():
            # One of them may be 3 or 4 already.
            first, second = os.dup(commands), os.dup(answers)
            os.dup2(first, 3)
            os.dup2(second, 4)

        flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]
        flags += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
        flags += ["--remote-debugging-pipe", f"--user-data-dir={folder}", "--window-size=1400,1000"]
        self.process = subprocess.Popen(
            [name, *flags], preexec_fn=as_the_browser_expects, close_fds=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        os.close(commands)
        os.close(answers)
        self.buffer, self.number, self.session = b"", 0, None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.call("Page.navigate", url=url)

    def call(self, method, **parameters):
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.commands, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self.buffer:
                part = os.read(self.answers, 1 << 16)
                if not part:
                    raise SystemExit("the browser has ended")
                self.buffer += part
            answer, self.buffer = self.buffer.split(b"\0", 1)
            answer = json.loads(answer)
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise SystemExit(f"{method}: {answer['error']}")
                return answer["result"]

    def evaluate(self, expression):
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def close(self):
        with contextlib.suppress(OSError):
            os.close(self.commands)
        self.process.terminate()
        self.process.wait(timeout=10)
        os.close(self.answers)


def run(wm, browser_name, env, folder):
    port = free_port()
    job = subprocess.Popen(
        [wm, "launch", "launch-configs/replay.launch.yaml", f"output:={folder / 'out'}", "loop:=true", "view:=true", f"view_port:={port}"],
        cwd=ROOT,
        env=env,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        time.sleep(6)  # loading the weights, and the first rollouts
        viewer = {name: pid for name, pid in children(job.pid).items() if name == "view"}
        alone = usage(viewer, ALONE)["view"]
        browser = Browser(browser_name, f"http://127.0.0.1:{port}/", folder / "profile")
        try:
            time.sleep(3)  # starting the browser is no work of the viewer's
            browser.evaluate("window.wmView.page.latencies.length = 0")
            watched = usage(viewer, WATCHED)["view"]
            latencies = browser.evaluate("window.wmView.page.latencies")
            first = browser.evaluate("window.wmView.page.firstPicture")
        finally:
            browser.close()
    finally:
        job.send_signal(signal.SIGINT)
        job.wait(timeout=20)
    return first, latencies, alone, watched


def quantile(values, q):
    return sorted(values)[min(len(values) - 1, int(q * len(values)))]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--domain", type=int, default=98)
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    parser.add_argument("--browser", default="chromium-headless-shell")
    arguments = parser.parse_args()
    env = dict(os.environ, ROS_DOMAIN_ID=str(arguments.domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    firsts, latencies, alone, watched = [], [], [], []
    for _ in range(arguments.runs):
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            found = run(arguments.wm, arguments.browser, env, pathlib.Path(folder))
        firsts.append(found[0])
        latencies += found[1]
        alone.append(found[2])
        watched.append(found[3])
    print(f"{processor()}, {os.cpu_count()} cores, {datetime.date.today()}, {arguments.runs} runs of {ALONE} s alone and {WATCHED} s watched\n")
    print("| | n | |")
    print("|---|---|---|")
    print(f"| opening the page to its first picture | {len(firsts)} | at most {max(firsts):.0f} ms |")
    milliseconds = [f"{quantile(latencies, q):.1f} ms" for q in (0.5, 0.95, 0.99)]
    print(f"| capture to canvas | {len(latencies)} | p50 {milliseconds[0]}, p95 {milliseconds[1]}, p99 {milliseconds[2]} |")
    for name, usages in (("without a client", alone), ("with one client", watched)):
        cpu, memory = max(cpu for cpu, _ in usages), max(memory for _, memory in usages)
        print(f"| the viewer {name} | {len(usages)} | at most {cpu:.1f} % of a core, {memory:.0f} MiB |")


if __name__ == "__main__":
    main()
