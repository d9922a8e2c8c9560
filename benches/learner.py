#!/usr/bin/env python3
"""The learner beside the live nodes, on a recorded robot: how long until its models beat the last frame, and what the
training costs the predictions.

usage: benches/learner.py BAG... [--minutes 30] [--alone 3] [--camera T] [--action T] [--action-space FILE]
                          [--domain D] [--wm PATH] --out OUT

Plays the bags one after the other, with the stamps of now, again from the first one after the last: the robot. Beside it
runs launch-configs/live.launch.yaml, first with `learn:=true` for `--minutes`, then for `--alone` minutes with the last
model and without the learner. Prints Markdown:

- the calibrated error ratio one step ahead by minute: the sum of the squared errors over that of the last frame, repeated;
- the minutes until it is below .9 and .7 for good;
- each round of the learner;
- the time from capture to received prediction, with and without the learner.

OUT gets both runs, figures.json and learner.svg. Needs `cargo build --release -p wm_training` and `cargo build --release`,
and of PyPI mcap-ros2-support and matplotlib.
"""

import argparse
import datetime
import itertools
import json
import os
import pathlib
import signal
import subprocess
import threading

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
RECORDED = ["/wm/prediction_error", "/wm/learner/status"]


def end(process):
    """Ends a process as Ctrl-C does."""
    process.send_signal(signal.SIGINT)
    process.wait(timeout=120)


def play(arguments, env, stop):
    """Plays the bags until `stop` is set."""
    for bag in itertools.cycle(arguments.bags):
        command = [arguments.wm, "bag", "play", bag, "--ros-args", "-p", "restamp:=true"]
        player = subprocess.Popen(command, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while player.poll() is None:
            if stop.wait(0.2):
                end(player)
                return


def run(arguments, env, out, minutes, settings):
    """The report of the live nodes after so many minutes."""
    out.mkdir(parents=True)
    launch = [arguments.wm, "launch", str(ROOT / "launch-configs/live.launch.yaml"), f"output:={out / 'live'}"]
    launch += [f"camera:={arguments.camera}", f"action:={arguments.action}", *settings]
    with open(out / "launch.log", "w", encoding="utf-8") as log:
        nodes = subprocess.Popen(launch, env=env, stdout=log, stderr=subprocess.STDOUT)
        recorder = subprocess.Popen(
            [arguments.wm, "bag", "record", "-o", str(out / "recorded"), *RECORDED], env=env, stdout=log, stderr=subprocess.STDOUT
        )
        stop = threading.Event()
        player = threading.Thread(target=play, args=(arguments, env, stop))
        player.start()
        try:
            nodes.wait(timeout=60 * minutes)
            raise SystemExit(f"the nodes ended with {nodes.returncode}: see {out / 'launch.log'}")
        except subprocess.TimeoutExpired:
            pass
        finally:
            stop.set()
            player.join()
            end(recorder)
            if nodes.poll() is None:
                end(nodes)
    return json.loads((out / "live/report.json").read_text())


def messages(folder, topic):
    """The messages of a topic with their log times [s]."""
    from mcap_ros2.reader import read_ros2_messages

    for file in sorted(folder.glob("*.mcap")):
        for read in read_ros2_messages(str(file), topics=[topic]):
            yield read.log_time_ns / 1e9, read.ros_msg


def by_minute(errors):
    """(minute, ratio, n) of the errors one step ahead."""
    rows = {}
    for time, mse, persistence in errors:
        row = rows.setdefault(int((time - errors[0][0]) // 60), [0.0, 0.0, 0])
        row[0], row[1], row[2] = row[0] + mse, row[1] + persistence, row[2] + 1
    return [(minute, mse / persistence, n) for minute, (mse, persistence, n) in sorted(rows.items()) if persistence > 0]


def below(ratios, bound):
    """The first minute from which on all ratios are below `bound`."""
    since = None
    for minute, ratio, _ in ratios:
        since = None if ratio >= bound else minute if since is None else since
    return since


def draw(path, ratios, rounds, start):
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 3), layout="constrained")
    axes.plot([minute + 0.5 for minute, *_ in ratios], [ratio for _, ratio, _ in ratios], label="live, calibrated")
    for accepted, mark, label in ((True, "o", "a round's model, accepted"), (False, "x", "not accepted")):
        of_kind = [r for r in rounds if r["accepted"] == accepted]
        axes.plot([(r["time"] - start) / 60 for r in of_kind], [r["ratio"] for r in of_kind], mark, label=label)
    axes.axhline(1, color="grey", linewidth=0.8)
    axes.set(xlabel="minutes", ylabel="squared error one step ahead\n/ that of the last frame", ylim=(0, 1.3))
    axes.legend(frameon=False)
    figure.savefig(path, metadata={"Date": None})


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="+")
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--alone", type=float, default=3)
    parser.add_argument("--camera", default="/camera/image_raw")
    parser.add_argument("--action", default="/wm/action")
    parser.add_argument("--action-space")
    parser.add_argument("--domain", type=int, default=98)
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    env = dict(os.environ, ROS_DOMAIN_ID=str(arguments.domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")

    print(f"{processor()}, {os.cpu_count()} cores, {datetime.date.today()}, {len(arguments.bags)} bags\n", flush=True)
    settings = ["learn:=true"]
    if arguments.action_space:
        settings.append(f"action_space:={arguments.action_space}")
    reports = {"learning": run(arguments, env, arguments.out / "learning", arguments.minutes, settings)}
    recorded = arguments.out / "learning/recorded"
    *_, (_, status) = messages(recorded, "/wm/learner/status")
    settings = [f"model:={status.model}"]
    reports["alone"] = run(arguments, env, arguments.out / "alone", arguments.alone, settings)

    errors = [(time, e.mse, e.persistence_mse) for time, e in messages(recorded, "/wm/prediction_error") if e.step == 1]
    ratios = by_minute(errors)
    print("| minute | error ratio one step ahead | n |\n|---|---|---|")
    for minute, ratio, n in ratios:
        print(f"| {minute} | {ratio:.3f} | {n} |")
    print()
    for bound in (0.9, 0.7):
        print(f"below {bound} for good since minute: {below(ratios, bound)}")

    rounds = [
        {
            "round": r.round,
            "time": r.stamp.sec + r.stamp.nanosec / 1e9,
            "trained_on": r.trained_on,
            "ratio": r.ratio,
            "ratio_before": r.ratio_before,
            "p": r.p_value,
            "accepted": r.accepted,
        }
        for r in status.rounds
    ]
    print("\n| round | ended, minute | trained on [s] | ratio | before | p | accepted |\n|---|---|---|---|---|---|---|")
    for r in rounds:
        minute = (r["time"] - errors[0][0]) / 60
        print(
            f"| {r['round']} | {minute:.1f} | {r['trained_on']:.0f} | {r['ratio']:.3f} | {r['ratio_before']:.3f} "
            f"| {r['p']:.3f} | {r['accepted']} |"
        )

    print("\n| step k | run | n | capture to received: p50 ms | p95 ms | p99 ms |\n|---|---|---|---|---|---|")
    for k in (0, 3, 7):
        for name, report in reports.items():
            latency = report["steps"][k]["received_latency"]
            print(f"| {k + 1} | {name} | {latency['n']} | {latency['p50_ms']:.1f} | {latency['p95_ms']:.1f} | {latency['p99_ms']:.1f} |")

    figures = {"ratios": ratios, "rounds": rounds, "reports": reports}
    (arguments.out / "figures.json").write_text(json.dumps(figures, indent=1))
    draw(arguments.out / "learner.svg", ratios, rounds, errors[0][0])


if __name__ == "__main__":
    main()
