#!/usr/bin/env python3
"""How many episodes a robot needs: trains transition models on few of its episodes, from several models, and measures them on
its held-out ones.

usage: benches/few_episodes.py BAGS --held-out BAG... [--encoder tiny] [--from NAME=MODEL]... [--episodes 2 5 10 20 40]
                               [--steps 400] [--fit crop] [--size 128x128] [--frame-skip 2] [--action TOPIC]
                               [--action-space FILE] [--jobs N] [--wm PATH] --out OUT

BAGS is a folder of bags, one for each episode. For each number, the episodes are the first ones of one shuffled order. A start
is a model to fine-tune, tiny or a model's folder; an empty model is random weights (--from scratch=). All predict the latents
of the encoder, whose fit and size of pictures are --fit and --size, and take the same steps, of two clips. Prints Markdown:
the squared latent error over that of the last frame, repeated, on all windows of the held-out episodes. OUT gets the data,
the models and figures.json; the same command continues there. Needs `cargo build --release -p wm_training` and
`cargo build --release`.
"""

import argparse
import concurrent.futures
import datetime
import json
import os
import pathlib
import random
import shutil
import subprocess

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
STEPS_AHEAD = (1, 4, 8)


def prepare(arguments, bag):
    """The folder with the data of a bag. Each bag has its own, so that all selections share their latents."""
    out = arguments.out / "data" / bag.name
    if not out.exists():
        partial = out.with_suffix(".partial")
        shutil.rmtree(partial, ignore_errors=True)
        command = [arguments.wm, "dataset", str(bag), "-o", str(partial), "--validation", "0"]
        command += ["--fit", arguments.fit, "--size", arguments.size]
        command += ["--action", arguments.action] if arguments.action else []
        command += ["--action-space", arguments.action_space] if arguments.action_space else []
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
        partial.rename(out)
    return out


def train(arguments, start, data, held_out):
    """The error ratios of the model that `start` becomes by these data, by name."""
    name, model = start.split("=", 1)
    out = arguments.out / f"{name}-{len(data)}-{arguments.steps}"
    result = out / "transition.journal.jsonl"
    if not (out / "MODEL.md").exists():
        command = [arguments.wm, "train", "transition"]
        command += [f"--data={folder}" for folder in data] + [f"--held-out={folder}" for folder in held_out]
        command += ["--encoder", arguments.encoder, "--out", str(out), "--cache", str(arguments.out / "cache")]
        command += ["--steps", str(arguments.steps), "--set", "batch=2", "--set", "micro_batch=1"]
        command += ["--set", "optimisation.learning_rate=1e-3", "--set", f"model.frame_skip={arguments.frame_skip}"]
        command += ["--from", model, "--old-rate", "1"] if model else []
        command += ["--action-space", arguments.action_space] if arguments.action_space else []
        command += ["--threads", "1"]
        with open(arguments.out / f"{out.name}.log", "w", encoding="utf-8") as log:
            subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=True)
    lines = [json.loads(line) for line in result.read_text().splitlines()]
    return lines[-1]["validation"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", type=pathlib.Path)
    parser.add_argument("--held-out", nargs="+", required=True)
    parser.add_argument("--encoder", default="tiny")
    parser.add_argument("--from", dest="starts", action="append", help="NAME=MODEL")
    parser.add_argument("--episodes", type=int, nargs="+", default=[2, 5, 10, 20, 40])
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--frame-skip", type=int, default=2)
    parser.add_argument("--fit", default="crop")
    parser.add_argument("--size", default="128x128")
    parser.add_argument("--action")
    parser.add_argument("--action-space")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    starts = arguments.starts or ["tiny=tiny", "scratch="]
    held_out = [pathlib.Path(bag).resolve() for bag in arguments.held_out]
    bags = [bag.resolve() for bag in sorted(arguments.bags.iterdir()) if (bag / "metadata.yaml").exists()]
    bags = [bag for bag in bags if bag not in held_out]
    random.Random(0).shuffle(bags)
    if len(bags) < max(arguments.episodes):
        parser.error(f"{arguments.bags} has {len(bags)} episodes to train on, --episodes asks for {max(arguments.episodes)}")
    (arguments.out / "data").mkdir(parents=True, exist_ok=True)

    print(f"{processor()}, {datetime.date.today()}, {arguments.steps} steps, {len(held_out)} held-out episodes\n", flush=True)
    cells = [(start, n) for n in sorted(arguments.episodes, reverse=True) for start in starts]
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        data = list(pool.map(lambda bag: prepare(arguments, bag), bags[: max(arguments.episodes)]))
        tests = list(pool.map(lambda bag: prepare(arguments, bag), held_out))
        ratios = dict(zip(cells, pool.map(lambda cell: train(arguments, cell[0], data[: cell[1]], tests), cells)))

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
