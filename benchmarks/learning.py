"""Does a preset learn: three CPU-minutes on procedural shapes, scored on others.

The shapes' occupancy is a formula, so no dataset is needed. One thread; the result depends on the
machine only through the number of steps that fit the time; `--steps` fixes it.
"""

import argparse
import json
import time
from dataclasses import asdict

import torch

from doughnet.config import preset
from doughnet.gate import GATE_TRAINING, train_and_score
from doughnet.optimisers import OptimiserConfig
from doughnet.train import Budget, TrainConfig


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one line of JSON")
    parser.add_argument("--preset", default="micro", help="of the model, e.g. micro-classic")
    parser.add_argument("--cpu-minutes", type=float, default=3.0, help="CPU time of the training")
    parser.add_argument("--steps", type=int, help="train for this number of steps instead")
    parser.add_argument("--adamw", action="store_true", help="AdamW for all weights, no Muon")
    parser.add_argument("--learning-rate", type=float, help="of both optimisers")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rate = options.learning_rate or GATE_TRAINING.optimiser.learning_rate
    optimiser = OptimiserConfig(muon=not options.adamw, learning_rate=rate)
    if options.steps is not None:
        budget = Budget(steps=options.steps)
    else:
        budget = Budget(seconds=60 * options.cpu_minutes, clock=time.process_time)
    config = TrainConfig(optimiser=optimiser, seed=options.seed)
    result = asdict(train_and_score(budget, model_config=preset(options.preset), config=config))
    print(json.dumps(result) if options.json else json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
