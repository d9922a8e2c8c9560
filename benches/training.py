#!/usr/bin/env python3
"""Training steps of `wm train` against PyTorch on the same machine: same networks, same batches, same optimiser.

usage: benches/training.py [--rounds N] [--seconds S] [--no-compile] [CASE ...]

Builds wm-training, makes a few simulated bags, and for each case trains for some steps with `wm train` and with PyTorch
(eager, and with torch.compile) in turns, round by round, on all threads of each. It prints the medians and p95 of all
steps, and of the rounds' ratios of ours to the faster PyTorch the median and the range (below 1: ours is faster). A step
of ours is the time between two entries of the training's TensorBoard file. So it contains all work of a step: drawing
clips and noise, loss, gradient, clipping, AdamW, the moving average. PyTorch's draws its noise, but repeats one batch of
latents or pictures.

PyTorch's networks, except DiT-S, take all weights of the bundled model by name. The losses of the transition models are
also compared with that of learning/training/fixtures/steps.py, the reference of the Rust tests. Needs cargo, a C++
compiler, and the packages of world-model/zoo/fixtures/requirements.txt.

Cases: transition, autoencoder, autoencoder-whole (its last steps, on whole pictures): the bundled default's recipes.
dit-s: the paper's objective and DiT-S, 256 tokens a frame, ten frames, batch 4.
"""

import argparse
import datetime
import math
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import nn

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "benches"), str(ROOT / "world-model/zoo/fixtures"), str(ROOT / "learning/training/fixtures")]

import steps as fixtures  # noqa: E402
from events import step_times  # noqa: E402
from machine import processor  # noqa: E402

BINARY = ROOT / "target/release/wm-training"
BUNDLED = ROOT / "world-model/model/weights/tiny"
# Of the recipes: noise of the history, noise levels that are too small to learn from, and where weights stop rising.
HISTORY_NOISE, SMALLEST_TAU, SOFTENING = 0.15, 0.01, 0.4
# Skipped steps of ours: the first ones fill caches.
WARM = 4


class SubBlock(nn.Module):
    """Attention within frames or over time, then SwiGLU, both modulated by the frame's condition."""

    def __init__(self, d, heads):
        super().__init__()
        self.heads = heads
        self.adaLN_modulation = nn.Sequential(nn.SiLU(), nn.Linear(d, 6 * d))
        hidden = 8 * d // 3
        self.attn = nn.ModuleDict(dict(qkv_proj=nn.Linear(d, 3 * d, bias=False), out_proj=nn.Linear(d, d)))
        self.ffwd = nn.ModuleDict(dict(w12=nn.Linear(d, 2 * hidden), w3=nn.Linear(hidden, d)))

    def turned(self, x, turn):
        x = F.rms_norm(x, (x.shape[-1],), eps=fixtures.F32_EPSILON)
        a, b = x[..., 0::2], x[..., 1::2]
        cos, sin = turn
        return torch.stack((a * cos - b * sin, a * sin + b * cos), -1).flatten(-2)

    def forward(self, x, condition, turn, mask, over_time):
        """x (B, T, N, d), condition (B, T, d)."""
        shift1, scale1, gate1, shift2, scale2, gate2 = self.adaLN_modulation(condition)[:, :, None].chunk(6, -1)
        y = F.rms_norm(x, x.shape[-1:], eps=1e-6) * (1 + scale1) + shift1
        y = self.attn.qkv_proj(y.transpose(1, 2) if over_time else y)
        q, k, v = y.unflatten(-1, (3, self.heads, -1)).permute(3, 0, 1, 4, 2, 5).unbind(0)
        y = F.scaled_dot_product_attention(self.turned(q, turn), self.turned(k, turn), v, attn_mask=mask)
        y = y.transpose(2, 3).flatten(3)
        x = x + gate1 * self.attn.out_proj(y.transpose(1, 2) if over_time else y)
        y = F.rms_norm(x, x.shape[-1:], eps=1e-6) * (1 + scale2) + shift2
        first, second = self.ffwd.w12(y).chunk(2, -1)
        return x + gate2 * self.ffwd.w3(F.silu(first) * second)


class Head(nn.Module):
    def __init__(self, d, out):
        super().__init__()
        self.adaLN_modulation = nn.Sequential(nn.SiLU(), nn.Linear(d, 2 * d))
        self.linear = nn.Linear(d, out)

    def forward(self, x, condition):
        shift, scale = self.adaLN_modulation(condition)[:, :, None].chunk(2, -1)
        return self.linear(F.rms_norm(x, x.shape[-1:], eps=1e-6) * (1 + scale) + shift)


class Dit(nn.Module):
    """The transition model for frames at any times; `mask` (T, T) permits their attention."""

    def __init__(self, c, times, mask):
        super().__init__()
        d, self.patch = c["hidden"], c["patch"]
        self.x_proj = nn.Conv2d(c["channels"], d, self.patch, self.patch)
        self.timestep_mlp = nn.Sequential(nn.Linear(256, d), nn.SiLU(), nn.Linear(d, d))
        self.action_embedder = nn.Linear(c["action_dim"], d)
        block = lambda: nn.ModuleDict(dict(s_block=SubBlock(d, c["heads"]), t_block=SubBlock(d, c["heads"])))
        self.blocks = nn.ModuleList(block() for _ in range(c["depth"]))
        self.final_layer = Head(d, self.patch**2 * c["channels"])
        rows, columns = c["latent_height"] // self.patch, c["latent_width"] // self.patch
        size = d // c["heads"]
        row = fixtures.angles([place // columns for place in range(rows * columns)], size // 2)
        column = fixtures.angles([place % columns for place in range(rows * columns)], size // 2)
        tables = dict(space=torch.cat([row, column], -1), time=fixtures.angles(times, size))
        for name, angle in tables.items():
            self.register_buffer(f"{name}_cos", angle.cos(), persistent=False)
            self.register_buffer(f"{name}_sin", angle.sin(), persistent=False)
        self.register_buffer("frequencies", torch.exp(-math.log(10000) * torch.arange(128).double() / 128), persistent=False)
        self.register_buffer("mask", mask, persistent=False)

    def forward(self, x, tau, action):
        b, t, h, w, channels = x.shape
        p = self.patch
        tokens = self.x_proj(x.flatten(0, 1).permute(0, 3, 1, 2)).flatten(2).transpose(1, 2).unflatten(0, (b, t))
        waves = 1000 * tau[..., None] * self.frequencies
        condition = self.timestep_mlp(torch.cat([waves.cos(), waves.sin()], -1)) + self.action_embedder(action)
        for block in self.blocks:
            tokens = block.s_block(tokens, condition, (self.space_cos, self.space_sin), None, False)
            tokens = block.t_block(tokens, condition, (self.time_cos, self.time_sin), self.mask, True)
        out = self.final_layer(tokens, condition).unflatten(2, (h // p, w // p)).unflatten(-1, (p, p, channels))
        return out.transpose(3, 4).reshape(x.shape)


def teacher_layout(frames, past):
    """Times and mask of all frames except the last, then those after `past` once more, noisy."""
    clean, later = frames - 1, frames - past
    times = [*range(clean), *range(past, frames)]
    mask = torch.zeros(clean + later, clean + later, dtype=torch.bool)
    mask[:clean, :clean] = torch.ones(clean, clean).tril().bool()
    for i in range(later):
        mask[clean + i, : past + i] = True
        mask[clean + i, clean + i] = True
    return times, mask


class Transition(nn.Module):
    """The loss of a batch of clips."""

    def __init__(self, c, is_teacher, past=2):
        super().__init__()
        frames, self.past, self.is_teacher = c["max_frames"], past, is_teacher
        times, mask = teacher_layout(frames, past) if is_teacher else (range(frames), torch.ones(frames, frames).tril().bool())
        self.config, self.net = c, Dit(c, times, mask)

    def draw(self, latents):
        b, n = latents.shape[:2]
        clean = n - 1 if self.is_teacher else self.past
        later = n - self.past
        u = torch.rand(b, later)
        shift = self.config["sampler"]["shift"]
        tau = (shift * u / (1 + (shift - 1) * u)).clamp(min=SMALLEST_TAU)
        return (
            HISTORY_NOISE * torch.randn(b, clean), torch.randn(b, clean, *latents.shape[2:]),
            torch.randn(b, later, *latents.shape[2:]), tau,
        )  # fmt: skip

    def forward(self, latents, actions, levels, history_noise, noise, tau):
        past, clean = self.past, levels.shape[1]
        s, wide = levels[..., None, None, None], tau[..., None, None, None]
        history = (latents[:, :clean] + s * history_noise) / torch.sqrt(1 + s**2)
        target = latents[:, past:]
        x = torch.cat([history, (1 - wide) * target + wide * noise], 1)
        fed = actions
        if self.config["action_alignment"] == "with_result":
            fed = torch.cat([torch.zeros_like(actions[:, :1]), actions[:, :-1]], 1)
        if self.is_teacher:
            fed = torch.cat([fed[:, :-1], fed[:, past:]], 1)
        found = self.net(x, torch.cat([torch.zeros_like(levels), tau], 1), fed)[:, clean:]
        if self.config["parametrisation"] == "velocity":
            return (found - (noise - target)).pow(2).mean()
        error = history[:, past - 1 :] + found - target
        return ((1 / (tau**2 + SOFTENING**2))[..., None, None, None] * error.pow(2)).mean()

    def check(self):
        """The loss is the one that the Rust side is tested against, up to rounding."""
        small = dict(self.config, hidden=16, depth=2, heads=2, latent_height=4, latent_width=4, channels=3, max_frames=5)
        peer, p = Transition(small, self.is_teacher).double(), fixtures.Parameters()
        torch.manual_seed(3)
        latents, actions = torch.randn(2, 5, 4, 4, 3).double(), torch.randn(2, 5, small["action_dim"]).double()
        levels, history_noise, noise, tau = (x.double() for x in peer.draw(latents))
        objective = dict(history=2, forcing="teacher" if self.is_teacher else "diffusion")
        expected = fixtures.dit_loss(
            p, small | dict(wide_head=None), objective, latents, actions, levels, history_noise, noise, tau, False
        )
        peer.net.load_state_dict({name: value.detach() for name, value in p.items()})
        found = peer(latents, actions, levels, history_noise, noise, tau)
        assert torch.isclose(found, expected, rtol=1e-9), (found, expected)


class Residual(nn.Module):
    def __init__(self, width):
        super().__init__()
        same = lambda: nn.Conv2d(width, width, 3, padding=1)
        self.conv = nn.Sequential(same(), nn.ReLU(), same(), nn.ReLU(), same())

    def forward(self, x):
        return F.relu(self.conv(x) + x)


class Autoencoder(nn.Module):
    """The loss of a batch of crops."""

    def __init__(self):
        super().__init__()
        down = lambda a, b: nn.Conv2d(a, b, 3, 2, 1, bias=False)
        same = lambda a, b, bias=True: nn.Conv2d(a, b, 3, padding=1, bias=bias)
        up = lambda: nn.Upsample(scale_factor=2)
        self.encoder = nn.Sequential(
            same(3, 16), down(16, 32), Residual(32), down(32, 64), Residual(64), Residual(64),
            down(64, 96), Residual(96), Residual(96), same(96, 12),
        )  # fmt: skip
        self.decoder = nn.Sequential(
            nn.Identity(), same(12, 96), nn.ReLU(), Residual(96), Residual(96),
            up(), same(96, 64, False), Residual(64), Residual(64),
            up(), same(64, 32, False), Residual(32), Residual(32),
            up(), same(32, 16, False), Residual(16), same(16, 3),
        )  # fmt: skip

    def draw(self, pictures, _):
        return (torch.randn(len(pictures), 12, pictures.shape[2] // 8, pictures.shape[3] // 8),)

    def forward(self, pictures, weights, noise):
        latents = self.encoder(pictures)
        found = self.decoder(3 * torch.tanh((latents + 0.05 * noise) / 3))
        error = found - pictures
        return (weights * (error.abs() + 2 * error.square())).mean() + 3e-4 * latents.square().mean()


class Peer:
    """PyTorch's training of a network."""

    def __init__(self, module, batch, optimisation, compiles):
        self.module, self.batch, self.optimisation = module, batch, optimisation
        self.loss = torch.compile(module) if compiles else module
        self.parameters = list(module.parameters())
        self.average = [p.detach().clone() for p in self.parameters]
        self.optimiser = torch.optim.AdamW(
            self.parameters, optimisation["rate"], optimisation["betas"], 1e-8, optimisation["decay"], fused=True
        )

    def step(self):
        self.optimiser.zero_grad()
        loss = self.loss(*self.batch, *self.draw())
        loss.backward()
        nn.utils.clip_grad_norm_(self.parameters, 1.0, foreach=True)
        self.optimiser.step()
        with torch.no_grad():
            torch._foreach_lerp_(self.average, self.parameters, 1 - self.optimisation["ema"])
        return loss.item()

    def draw(self):
        return self.module.draw(*self.batch[: 2 if isinstance(self.module, Autoencoder) else 1])


def bundled(name):
    return load_file(BUNDLED / f"{name}.safetensors")


class Case:
    """A training: arguments of `wm train`, and the same in PyTorch."""

    optimisation = dict(rate=1.5e-3, betas=(0.9, 0.99), decay=2e-3, ema=0.998)


class TransitionCase(Case):
    name, arguments = "transition", ["transition", "--encoder", "tiny"]
    clips, latent = 8, (16, 16, 12)
    config = dict(
        hidden=128, depth=5, heads=4, patch=2, latent_height=16, latent_width=16, channels=12, action_dim=7,
        max_frames=10, parametrisation="residual", action_alignment="with_result", sampler=dict(shift=16.0),
    )  # fmt: skip
    is_teacher = True

    def module(self):
        torch.manual_seed(1)
        module = Transition(self.config, self.is_teacher)
        module.check()
        self.load(module)
        # The tables are f64 until here.
        return module.float()

    def load(self, module):
        module.net.load_state_dict({name: value.float() for name, value in bundled("transition").items()})

    def batch(self):
        frames = self.config["max_frames"]
        return torch.randn(self.clips, frames, *self.latent), torch.randn(self.clips, frames, self.config["action_dim"])


class DitS(TransitionCase):
    name, clips, is_teacher = "dit-s", 4, False
    config = TransitionCase.config | dict(
        hidden=384, depth=12, heads=6, patch=1, action_dim=10, parametrisation="velocity", action_alignment="with_frame",
        sampler=dict(shift=1.0),
    )  # fmt: skip
    arguments = [
        "transition", "--encoder", "tiny", "--recipe", "paper", "--set", "batch=4", "--set", "micro_batch=1",
        "--set", "model.preset=dit-s", "--set", "model.patch=1",
    ]  # fmt: skip

    def load(self, module):
        pass


class AutoencoderCase(Case):
    name, count, side = "autoencoder", 16, 64
    arguments = ["autoencoder", "--set", "whole_picture_share=0"]

    def module(self):
        torch.manual_seed(1)
        module = Autoencoder()
        weights = bundled("autoencoder")
        module.load_state_dict({name: value.float() for name, value in weights.items() if not name.startswith("latent_")})
        return module.to(memory_format=torch.channels_last)

    def batch(self):
        pictures = torch.rand(self.count, 3, self.side, self.side).contiguous(memory_format=torch.channels_last)
        return pictures, torch.rand(self.count, 1, self.side, self.side) + 0.5


class WholePictures(AutoencoderCase):
    name, count, side = "autoencoder-whole", 4, 128
    arguments = ["autoencoder", "--set", "whole_picture_share=1"]


CASES = {case.name: case for case in (TransitionCase, AutoencoderCase, WholePictures, DitS)}


def ours(case, bags, count):
    """Milliseconds of `count` steps of `wm train`."""
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder, "bench")
        # One more step, which ends with a validation and is skipped.
        command = [
            BINARY, "train", *case.arguments, "--data", bags, "--out", out, "--cache", bags.parent / "cache",
            "--validation", "0", "--steps", str(WARM + count + 1), "--set", "validate_every=100000",
        ]  # fmt: skip
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        (events,) = out.rglob("events.out.tfevents.*")
        return step_times(events)[WARM - 1 :][:count]


def timed(step, count):
    times = []
    for _ in range(count):
        start = time.perf_counter()
        step()
        times.append((time.perf_counter() - start) * 1e3)
    return times


def compare(case, bags, arguments):
    module, batch = case.module(), case.batch()
    peers = dict(eager=Peer(module, batch, case.optimisation, False))
    if not arguments.no_compile:
        peers["compile"] = Peer(case.module(), batch, case.optimisation, True)
    for peer in peers.values():
        timed(peer.step, 2)
    slowest = max(timed(peer.step, 1)[0] for peer in peers.values()) / 1e3
    count = max(3, min(50, int(arguments.seconds / slowest)))
    times, ratios = {name: [] for name in ("ours", "eager", "compile")}, []
    for _ in range(arguments.rounds):
        a = ours(case, bags, count)
        b = {name: timed(peer.step, count) for name, peer in peers.items()}
        for name, found in [("ours", a), *b.items()]:
            times[name] += found
        ratios.append(statistics.median(a) / min(map(statistics.median, b.values())))
    cell = lambda t: f"{statistics.median(t):.0f} ({statistics.quantiles(t, n=20)[-1]:.0f})" if t else "-"
    ratio = f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
    cells = [case.name, *map(cell, times.values()), ratio, f"{arguments.rounds} x {count}"]
    print("| " + " | ".join(cells) + " |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", default=list(CASES))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20, help="how long one peer's steps of a round may take, about")
    parser.add_argument("--no-compile", action="store_true", help="leave torch.compile out")
    arguments = parser.parse_args()
    if unknown := set(arguments.cases) - {*CASES}:
        parser.error(f"no such case: {', '.join(sorted(unknown))}; there are: {', '.join(CASES)}")
    subprocess.run(["cargo", "build", "--release", "-p", "wm_training"], cwd=ROOT, check=True)
    cores = len(os.sched_getaffinity(0))
    torch.set_num_threads(cores)
    print(f"{processor()}, {cores} cores, {datetime.date.today()}, torch {torch.__version__}; ms, p50 (p95)\n")
    print("| training step | ours | eager | compile | ratio to the faster | steps |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        bags = pathlib.Path(folder, "bags")
        make = [BINARY, "sim", "--episodes", "8", "--seed", "0", "--frames", "50", "--masks", "--out", bags]
        subprocess.run(make, check=True, stdout=subprocess.DEVNULL)
        for name in arguments.cases:
            compare(CASES[name](), bags, arguments)


if __name__ == "__main__":
    main()
