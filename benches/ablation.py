#!/usr/bin/env python3
"""What a choice changes, beyond what the seed changes: trains a transition model for each variant and seed, and compares the
variants as families of models. A single variant shows what the seed changes.

usage: benches/ablation.py --data DATA --variant NAME=ENCODER[,key=value...]... [--seeds 0 1 2] [--steps 300] [--set KEY=VALUE]...
                           [--action-space FILE] [--settings FILE] [--jobs N] [--wm PATH] --out OUT

DATA is a folder of `wm dataset` with validation episodes. A variant is an encoder and settings of the recipe, such as
wide=tiny,model.hidden=192. All take the same steps, of the same clips for the same seed. OUT gets the models and a folder
`eval` with the report of `wm eval all` on the validation episodes, whose families.html compares the variants. Prints the hours of
processor time of each part, and for each figure the mean of each variant, its range over the seeds, and its difference from the
first with the 95 % interval over episodes or windows. The same command continues in OUT; one with other options is refused
there. Needs `cargo build --release` and `cargo build --release -p wm_training`.
"""

import argparse
import concurrent.futures
import datetime
import json
import os
import pathlib
import resource
import statistics
import subprocess

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
FIGURES = [f"control.ratio_k{k}{change}" for k in (1, 4, 8) for change in ("", "_negated")]
FIGURES += ["control.action_following", "fidelity.psnr", "fidelity.psnr_ceiling", "fidelity.psnr_persistence"]


def train(arguments, variant, seed):
    """The folder of the trained model."""
    name, text = variant.split("=", 1)
    encoder, *settings = text.split(",")
    out = arguments.out / f"{name}-{seed}"
    if not (out / "MODEL.md").exists():
        command = [arguments.wm, "train", "transition", "--data", str(arguments.data), "--encoder", encoder, "--out", str(out)]
        command += ["--cache", str(arguments.out / "cache"), "--steps", str(arguments.steps), "--threads", "1"]
        for setting in [f"seed={seed}", "batch=2", "micro_batch=1", *arguments.set, *settings]:
            command += ["--set", setting]
        command += ["--action-space", arguments.action_space] if arguments.action_space else []
        with open(out.with_suffix(".log"), "w", encoding="utf-8") as log:
            subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=True)
    return out


def evaluate(arguments, families):
    """Writes the report of all models. Returns the findings of the models, and the differences from the first family."""
    models = [str(model) for models in families.values() for model in models]
    out = arguments.out / "eval"
    command = [arguments.wm, "eval", "all", "--model", models[0], "--data", str(arguments.data)]
    command += ["--cache", str(arguments.out / "cache"), "--report", str(out)]
    command += ["--skip", "latents", "policy", "robustness", "cost"]
    command += ["--settings", arguments.settings] if arguments.settings else []
    command += ["--action-space", arguments.action_space] if arguments.action_space else []
    command += ["--compare", *models[1:]] if models[1:] else []
    several = len(families) > 1
    if several:
        command += ["--families"] + [f"{name}=" + ",".join(str(model) for model in models) for name, models in families.items()]
    if not (out / ("families.json" if several else "figures.json")).exists():
        with open(arguments.out / "eval.log", "w", encoding="utf-8") as log:
            subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=True)
    of_models = json.loads((out / "figures.json").read_text())["models"]
    comparisons = json.loads((out / "families.json").read_text())["comparisons"] if several else []
    return of_models, comparisons


def hours():
    """Processor time of the finished programs so far [h]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (used.ru_utime + used.ru_stime) / 3600


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--variant", action="append", required=True, help="NAME=ENCODER[,key=value...]")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--action-space")
    parser.add_argument("--settings")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    chosen = {name: str(value) for name, value in vars(arguments).items() if name not in ("jobs", "out", "wm")}
    options = arguments.out / "options.json"
    if options.exists() and json.loads(options.read_text()) != chosen:
        parser.error(f"{options} has other options; give another --out")
    options.write_text(json.dumps(chosen, indent=1))

    print(f"{processor()}, {datetime.date.today()}, {arguments.steps} steps, seeds {arguments.seeds}", flush=True)
    # The first seed of each variant comes first: later ones find its latents.
    cells = [(variant, seed) for seed in arguments.seeds for variant in arguments.variant]
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        models = dict(zip(cells, pool.map(lambda cell: train(arguments, *cell), cells)))
    trained = hours()
    print(f"training: {trained:.2f} hours of processor time", flush=True)
    families = {variant.split("=", 1)[0]: [models[variant, seed] for seed in arguments.seeds] for variant in arguments.variant}
    of_models, comparisons = evaluate(arguments, families)
    print(f"evaluation: {hours() - trained:.2f} hours of processor time\n")

    print("| figure: mean (least to most over the seeds); difference from the first | " + " | ".join(families) + " |")
    print("|---|" + "---|" * len(families))
    members = iter(of_models)
    members = [[next(members)["metrics"] for _ in models] for models in families.values()]
    differences = [{}, *(found["metrics"] for found in comparisons)]
    for figure in FIGURES:
        row = []
        for seeds, difference in zip(members, differences):
            if not all(figure in seed for seed in seeds):
                row.append("–")
                continue
            values = [seed[figure]["value"] for seed in seeds]
            text = f"{statistics.mean(values):.3f} ({min(values):.3f} to {max(values):.3f})"
            if difference.get(figure, {}).get("interval"):
                least, most = difference[figure]["interval"]
                text += f"; {difference[figure]['difference']:+.3f} \\[{least:+.3f}, {most:+.3f}\\]"
            row.append(text)
        print(f"| {figure} | " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
