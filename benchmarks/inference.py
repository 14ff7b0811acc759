"""Predicted frames a second at 1 mm: one dynamics step, folded decoding coarse to fine, genus.

The model is first trained for a moment on procedural shapes, so that what is decoded has surfaces;
`--weights` takes a trained one. `folded_max_error` compares the folded decoder with the plain one,
both in single precision: the largest difference of mask probabilities, or of logits in units of
the largest logit, whichever is larger. Rounding of single precision grows with the logits, so the
absolute difference stands beside it, once in single and once in double precision.
"""

# the variable counts only before torch starts its threads
import argparse
import copy
import json
import os
import time

# Threads that spin while they wait take the cores from each other where other work runs, too.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import torch
from torch import Tensor

from doughnet.autoencoder import Decoder
from doughnet.config import preset
from doughnet.folded import fold
from doughnet.lattice import workspace_lattice
from doughnet.model import DoughNet
from doughnet.optimisers import OptimiserConfig
from doughnet.procedural import stream
from doughnet.runs import find_weights
from doughnet.stages import AutoencoderStage
from doughnet.train import Budget, TrainConfig, fit
from doughnet.weights import load_weights


def trained(name: str, steps: int) -> DoughNet:
    """A preset after some steps on procedural shapes."""
    torch.manual_seed(0)
    model = DoughNet(preset(name))
    config = TrainConfig(optimiser=OptimiserConfig())
    fit(AutoencoderStage(model), lambda s: stream(0, batch_size=4, step=s), Budget(steps=steps),
        config=config)  # fmt: skip
    return model.eval()


def folding_errors(decoder: Decoder, latents: Tensor, points: Tensor) -> dict[str, float]:
    """Differences between the folded decoder and the plain one."""
    plain, _ = decoder(latents, points)
    folded = fold(decoder, latents)(points)
    largest = float(plain.abs().max())
    difference = float((folded - plain).abs().max())
    odds = float((folded.softmax(dim=-1) - plain.softmax(dim=-1)).abs().max())
    exact = copy.deepcopy(decoder).double()
    latents, points = latents.double(), points.double()
    in_double = (fold(exact, latents)(points) - exact(latents, points)[0]).abs().max()
    return {
        "folded_max_error": max(odds, difference / max(largest, 1.0)),
        "folded_max_logit_error": difference,
        "folded_max_logit_error_in_double": float(in_double),
        "largest_logit": round(largest, 2),
    }


@torch.inference_mode()
def measure(model: DoughNet, *, frames: int) -> dict[str, float]:
    """Frames a second of a rollout with every frame decoded, and the folding error."""
    batch = next(stream(2**20, batch_size=4))
    latents = model.encode(batch["points"], batch["point_labels"])
    errors = folding_errors(model.autoencoder.decoder, latents, batch["queries"])
    lattice = workspace_lattice()
    z_TD = latents[:1]
    tool = torch.rand(1, 2 * 128, 3) * 0.1
    before = model.dynamics.embed_tool(tool)
    times, occupied = [], 0
    for _ in range(frames):
        started, cpu = time.perf_counter(), time.process_time()
        after = model.dynamics.embed_tool(tool)
        z_TD = model.dynamics(z_TD, before, after)
        shape = model.decode(z_TD[0], lattice)
        times.append((time.perf_counter() - started, time.process_time() - cpu))
        occupied = int((shape.labels < model.config.components).sum())
    seconds = sorted(times)[len(times) // 2]  # the median: other work holds the cores at times
    return {
        "fps": round(1 / seconds[0], 1),
        "cpu_seconds_a_frame": round(sorted(t for _, t in times)[len(times) // 2], 4),
        "occupied_nodes": occupied,
        **errors,
    }


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one line of JSON")
    parser.add_argument("--preset", default="micro")
    parser.add_argument("--weights", help="folder of trained weights, instead of a preset")
    parser.add_argument("--steps", type=int, default=200, help="of training beforehand")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--frames", type=int, default=15)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    if options.weights:
        loaded = load_weights(find_weights(options.weights))
        model, name = loaded.model, loaded.provenance.get("preset", options.weights)
    else:
        model, name = trained(options.preset, options.steps), options.preset
    result = {"preset": name, **measure(model, frames=options.frames)}
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
