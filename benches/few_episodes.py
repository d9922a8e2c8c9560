#!/usr/bin/env python3
"""How many episodes a robot needs: trains transition models on few of its episodes, from several models, and measures them on
its held-out ones.

usage: benches/few_episodes.py BAGS --held-out BAG... [--from NAME=MODEL,ENCODER]... [--episodes 2 5 10 20 40] [--steps 400]
                               [--action-space FILE] [--jobs N] [--wm PATH] --out OUT

BAGS is a folder of bags, one for each episode. For each number, the episodes are the first ones of one shuffled order. A start
is a model to fine-tune and the encoder whose latents it predicts: tiny, or a model's folder. An empty model is random weights:
--from scratch=,tiny. All trainings take the same steps, of two clips. Prints Markdown: the squared latent error over that of
the last frame, repeated, on all windows of the held-out episodes. OUT gets the models and figures.json; the same command
continues there. Needs `cargo build --release -p wm_training` and `cargo build --release`.
"""

import argparse
import concurrent.futures
import datetime
import json
import os
import pathlib
import random
import subprocess

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
STEPS_AHEAD = (1, 4, 8)


def train(arguments, start, bags):
    """The error ratios of the model that `start` becomes by these bags, by name."""
    name, models = start.split("=", 1)
    model, encoder = models.split(",", 1)
    out = arguments.out / f"{name}-{len(bags)}-{arguments.steps}"
    result = out / "transition.journal.jsonl"
    if not (out / "MODEL.md").exists():
        command = [arguments.wm, "train", "transition"]
        command += [f"--data={bag}" for bag in bags] + [f"--held-out={bag}" for bag in arguments.held_out]
        command += ["--encoder", encoder, "--out", str(out), "--cache", str(arguments.out / "cache")]
        command += ["--steps", str(arguments.steps), "--set", "batch=2", "--set", "optimisation.learning_rate=1e-3"]
        command += ["--from", model, "--old-rate", "1"] if model else ["--set", f"model.frame_skip={arguments.frame_skip}"]
        command += ["--threads", "1"]
        if arguments.action_space:
            command += ["--action-space", arguments.action_space]
        with open(arguments.out / f"{out.name}.log", "w", encoding="utf-8") as log:
            subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=True)
    lines = [json.loads(line) for line in result.read_text().splitlines()]
    return lines[-1]["validation"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", type=pathlib.Path)
    parser.add_argument("--held-out", nargs="+", required=True)
    parser.add_argument("--from", dest="starts", action="append", help="NAME=MODEL,ENCODER")
    parser.add_argument("--episodes", type=int, nargs="+", default=[2, 5, 10, 20, 40])
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--frame-skip", type=int, default=2)
    parser.add_argument("--action-space")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    starts = arguments.starts or ["tiny=tiny,tiny", "scratch=,tiny"]
    held_out = {pathlib.Path(bag).resolve() for bag in arguments.held_out}
    bags = [bag for bag in sorted(arguments.bags.iterdir()) if (bag / "metadata.yaml").exists() and bag.resolve() not in held_out]
    random.Random(0).shuffle(bags)
    if len(bags) < max(arguments.episodes):
        parser.error(f"{arguments.bags} has {len(bags)} episodes to train on, --episodes asks for {max(arguments.episodes)}")
    arguments.out.mkdir(parents=True, exist_ok=True)

    print(f"{processor()}, {datetime.date.today()}, {arguments.steps} steps, {len(held_out)} held-out episodes\n", flush=True)
    cells = [(start, n) for n in sorted(arguments.episodes, reverse=True) for start in starts]
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        ratios = dict(zip(cells, pool.map(lambda cell: train(arguments, cell[0], bags[: cell[1]]), cells)))

    names = [start.split("=", 1)[0] for start in starts]
    print("| episodes | " + " | ".join(f"{name}, k = {k}" for name in names for k in STEPS_AHEAD) + " |")
    print("|---|" + "---|" * (len(names) * len(STEPS_AHEAD)))
    for n in arguments.episodes:
        row = [f"{ratios[start, n][f'ratio_k{k}']:.3f}" for start in starts for k in STEPS_AHEAD]
        print(f"| {n} | " + " | ".join(row) + " |")
    figures = {f"{start.split('=', 1)[0]}-{n}": ratio for (start, n), ratio in ratios.items()}
    (arguments.out / "figures.json").write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
